//! Captures to files of MegaSaM and back, from outside.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{Scratch, refused, succeed, train, write_capture};
use minute4d::Silent;
use minute4d::io::capture::{self, CaptureOptions, Split};
use minute4d::scene::Capture;
use std::fs;
use std::path::Path;

fn read(folder: &Path) -> Capture {
    capture::read(folder, Split::Train, &CaptureOptions::default(), &Silent).unwrap()
}

fn fixture(name: &str) -> String {
    format!("{}/../../fixtures/megasam/{name}", env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn a_capture_comes_back_through_every_layout() {
    let dir = Scratch::new();
    let given = dir.path("capture");
    write_capture(&given, true);
    let source = read(&given);
    // depths lie between 2.5 and 4; a capture stores them in 16-bit steps
    for (format, out, name, depth_within) in [
        ("megasam-reconstruction", "reconstructions/dog", "folder", 3e-4),
        ("megasam", "dog_droid.npz", "droid", 3e-4),
        ("megasam-cvd", "dog_sgd_cvd_hr.npz", "cvd", 1e-3),
    ] {
        let args = [
            "export",
            &dir.at("capture"),
            "--format",
            format,
            "-o",
            &dir.at(out),
            "--json",
        ];
        let report = succeed(&args).result();
        assert_eq!(
            (&report["format"], &report["path"]),
            (&format.into(), &dir.at(out).into())
        );
        assert!(report["bytes"].as_u64().unwrap() > 5000 && report["comparison"].is_null());
        assert!(
            report["losses"]["dropped"]
                .to_string()
                .contains("how long the clip lasts")
        );
        refused(
            &["export", &dir.at("capture"), "--format", format, "-o", &dir.at(out)],
            73,
            &["--force"],
        );

        let args = [
            "import",
            &dir.at(out),
            "-o",
            &dir.at(name),
            "--fps",
            "10",
            "--tau-motion",
            "0.5",
            "--json",
        ];
        let report = succeed(&args).result();
        assert_eq!((&report["frames"], &report["format"]), (&6.into(), &format.into()));
        // the archives find the map of motion in the folder of reconstructions beside them
        assert!(report["moving_share"].as_f64().unwrap() > 0.01);
        let back = read(&dir.path(name));
        assert_eq!((back.metric, back.time_frames), (false, 6));
        assert!((back.duration_s.unwrap() - 0.5).abs() < 1e-9);
        let (mut both, mut either) = (0, 0);
        for (a, b) in source.frames.iter().zip(&back.frames) {
            assert_eq!(a.rgb, b.rgb);
            let (ka, kb) = (a.camera.intrinsics, b.camera.intrinsics);
            assert!((ka.fx - kb.fx).abs() < 1e-4 && (ka.cx - kb.cx).abs() < 1e-4 && ka.width == kb.width);
            assert!((a.camera.c2w.matrix() - b.camera.c2w.matrix()).amax() < 1e-6);
            let (za, zb) = (a.depth.as_ref().unwrap(), b.depth.as_ref().unwrap());
            assert!(za.every(1).all(|z| z > 2.0));
            let most = za
                .every(1)
                .zip(zb.every(1))
                .fold(0.0, |most, (a, b)| f32::max(most, (a - b).abs() / a));
            assert!(most < depth_within, "{format}: {most}");
            let (ma, mb) = (a.mask.as_ref().unwrap(), b.mask.as_ref().unwrap());
            let common = ma.set_pixels().filter(|&(x, y)| mb.at(x, y)).count();
            both += common;
            either += ma.count() + mb.count() - common;
        }
        // a square of 17 pixels in blocks of 8
        let share = f64::from(both as u32) / f64::from(either as u32);
        assert!(share > 0.7, "{format}: {share:.3} of the masks");

        let record: serde_json::Value =
            serde_json::from_slice(&fs::read(dir.path(name).join("geometry.json")).unwrap()).unwrap();
        assert_eq!(
            (&record["status"], &record["settings"]["format"]),
            (&"finished".into(), &format.into())
        );
        let facts = succeed(&["inspect", &dir.at(name), "--json"]).result();
        assert_eq!((&facts["kind"], &facts["with_depth"]), (&"capture".into(), &6.into()));
        let trained = train(&dir.at(name), &dir.at(&format!("{name}-out")), "5", &[]);
        assert_eq!(trained.code, 0, "{}", trained.stderr);
    }
}

#[test]
fn files_of_numpy_become_captures() {
    let dir = Scratch::new();
    let out = dir.at("out");
    let ended = succeed(&["import", &fixture("outputs_cvd/dog_sgd_cvd_hr.npz"), "-o", &out]);
    assert!(
        ended.stderr.contains("30 were assumed") && ended.stderr.contains("3 frames of 24 x 16"),
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
fn wrong_requests_are_refused_with_advice() {
    let dir = Scratch::new();
    let given = dir.at("capture");
    write_capture(&dir.path("capture"), false);
    let (out, npz) = (dir.at("out"), dir.write("bad_droid.npz", b"no archive"));
    let ply = dir.write("a.ply", b"ply");
    let scene = dir.write("x.safetensors", b"no scene");
    fs::create_dir_all(dir.path("empty")).unwrap();
    let empty = dir.at("empty");
    let droid = fixture("outputs/dog_droid.npz");
    for (args, code, says) in [
        (
            vec!["export", &*given, "-o", &out],
            65,
            "is a capture, which 4dgs does not hold",
        ),
        (
            vec!["export", &given, "--format", "megasam", "--fps", "3"],
            2,
            "--fps has no meaning for megasam",
        ),
        (
            vec!["export", &given, "--format", "megasam", "--time", "3"],
            2,
            "--time has no meaning for megasam",
        ),
        (
            vec!["export", &empty, "--format", "megasam"],
            65,
            "transforms_train.json",
        ),
        (vec!["export", &scene, "--format", "megasam-cvd"], 65, "holds a capture"),
        (vec!["import", &npz, "-o", &out], 65, "no npz archive"),
        (vec!["import", &empty, "-o", &out], 65, "is a folder"),
        (
            vec!["import", &empty, "-o", &out, "--format", "megasam-reconstruction"],
            65,
            "no array `images`",
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
