//! Files of MegaSaM to captures, from outside.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{Scratch, refused, succeed, train, write_capture};
use minute4d::Silent;
use minute4d::core::Capture;
use minute4d::io::capture::{self, CaptureOptions, Split};
use std::fs;
use std::path::Path;

fn read(folder: &Path) -> Capture {
    capture::read(folder, Split::Train, &CaptureOptions::default(), &Silent).unwrap()
}

fn fixture(name: &str) -> String {
    format!("{}/../../fixtures/megasam/{name}", env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn every_layout_is_imported_and_trained() {
    let dir = Scratch::new();
    for (source, name) in [
        ("reconstructions/dog", "folder"),
        ("outputs/dog_droid.npz", "droid"),
        ("outputs_cvd/dog_sgd_cvd_hr.npz", "cvd"),
    ] {
        let source = fixture(source);
        let args = [
            "import",
            &source,
            "-o",
            &dir.at(name),
            "--fps",
            "10",
            "--tau-motion",
            "0.5",
            "--json",
        ];
        let report = succeed(&args).result();
        assert_eq!((&report["frames"], &report["format"]), (&3.into(), &"megasam".into()));
        // the archives find the map of motion in the folder of reconstructions beside them
        assert!(report["moving_share"].is_number(), "{report}");
        let back = read(&dir.path(name));
        assert_eq!((back.metric, back.time_frames), (false, 3));
        assert!((back.duration_s.unwrap() - 0.2).abs() < 1e-9);
        let record: serde_json::Value =
            serde_json::from_slice(&fs::read(dir.path(name).join("geometry.json")).unwrap()).unwrap();
        assert_eq!(
            (&record["status"], &record["settings"]["format"]),
            (&"finished".into(), &"megasam".into())
        );
        let facts = succeed(&["inspect", &dir.at(name), "--json"]).result();
        assert_eq!((&facts["kind"], &facts["with_depth"]), (&"capture".into(), &3.into()));
        let trained = train(&dir.at(name), &dir.at(&format!("{name}-out")), "5", &[]);
        assert_eq!(trained.code, 0, "{}", trained.stderr);
    }
}

#[test]
fn numpy_files_are_imported() {
    let dir = Scratch::new();
    let out = dir.at("out");
    let ended = succeed(&["import", &fixture("outputs_cvd/dog_sgd_cvd_hr.npz"), "-o", &out]);
    assert!(
        ended.stderr.contains("30 frames per second are assumed") && ended.stderr.contains("3 frames of 24 x 16"),
        "{}",
        ended.stderr
    );
    assert_eq!(ended.stdout.trim_end(), out);
    let again = ["import", &fixture("outputs/dog_droid.npz"), "-o", &out];
    refused(&again, 73, &["--force"]);
    succeed(&[&again[..], &["--force"]].concat());
    let capture = read(&dir.path("out"));
    assert!(capture.frames.iter().all(|f| f.mask.is_some() && f.depth.is_some()));
}

#[test]
fn invalid_requests_are_rejected_with_a_hint() {
    let dir = Scratch::new();
    let given = dir.at("capture");
    write_capture(&dir.path("capture"), false);
    let (out, npz) = (dir.at("out"), dir.write("bad_droid.npz", b"no archive"));
    let ply = dir.write("a.ply", b"ply");
    fs::create_dir_all(dir.path("empty")).unwrap();
    let empty = dir.at("empty");
    let droid = fixture("outputs/dog_droid.npz");
    for (args, code, says) in [
        (
            vec!["export", &*given, "-o", &out],
            65,
            "is a capture, which the format 4dgs cannot store",
        ),
        (vec!["export", &given, "--format", "megasam"], 2, "choose one of 4dgs"),
        (vec!["import", &npz, "-o", &out], 65, "not an npz archive"),
        (vec!["import", &empty, "-o", &out], 65, "is a folder"),
        (
            vec!["import", &empty, "-o", &out, "--format", "megasam"],
            65,
            "the array `images` is missing",
        ),
        (
            vec!["import", &ply, "-o", &out, "--fps", "3"],
            2,
            "--fps has no meaning for ply",
        ),
        (
            vec!["import", &droid, "-o", &out, "--motion-prob", "/nowhere/m.npy"],
            66,
            "/nowhere/m.npy",
        ),
    ] {
        refused(&args, code, &[says]);
    }
    assert!(!dir.path("out").exists(), "what cannot be used leaves nothing behind");
}
