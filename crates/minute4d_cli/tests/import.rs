//! Clips that other tools posed, from outside.

use crate::common::{Scratch, refused, succeed, train};
use minute4d::Silent;
use minute4d::io::capture::{self, CaptureOptions, Split};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

fn fixture(name: &str) -> String {
    format!("{}/../../fixtures/import/{name}", env!("CARGO_MANIFEST_DIR"))
}

/// Fixtures whose folder says what they are.
#[test]
fn source_formats_are_detected_and_imported() {
    let dir = Scratch::new();
    for (name, format, held_out) in [
        ("colmap_text", "colmap", 0),
        ("nerfstudio", "nerfstudio", 0),
        ("vipe", "vipe", 0),
        ("dycheck", "dycheck", 2),
        ("nvidia", "nvidia", 0),
        ("record3d/clip.r3d", "record3d", 0),
    ] {
        let (source, out) = (fixture(name), dir.at(format));
        let folder = fixture("clip/images");
        let more: &[&str] = if format == "colmap" {
            &["--images", &folder]
        } else {
            &[]
        };
        let report = succeed(&[&["import", &source, "-o", &out, "--json"], more].concat()).result();
        assert_eq!(report["format"], format, "{name}");
        assert!(report["frames"].as_u64().unwrap() > 2, "{name}: {report}");
        assert!(report["check"]["verdict"].is_string(), "{name}: {report}");
        let train = capture::read(&dir.path(format), Split::Train, &CaptureOptions::default(), &Silent).unwrap();
        assert_eq!(train.frames.len() as u64, report["frames"].as_u64().unwrap());
        assert!(report["held_out"].as_u64().unwrap() >= held_out, "{name}: {report}");
        let listed = dir.path(format).join(Split::Test.file_name()).is_file();
        assert_eq!(listed, report["held_out"] != 0, "{name}");
    }
    // held-out views of an earlier import do not stay behind
    assert!(dir.path("dycheck").join(Split::Test.file_name()).is_file());
    succeed(&[
        "import",
        &fixture("record3d/clip.r3d"),
        "-o",
        &dir.at("dycheck"),
        "--force",
        "--no-check",
    ]);
    assert!(!dir.path("dycheck").join(Split::Test.file_name()).exists());
    let trained = train(&dir.at("colmap"), &dir.at("out"), "5", &[]);
    assert!(
        trained.code == 0 || trained.stderr.contains("depth"),
        "{}",
        trained.stderr
    );
}

#[test]
fn invalid_requests_are_rejected_with_a_hint() {
    let dir = Scratch::new();
    let out = dir.at("out");
    fs::create_dir_all(dir.path("empty")).unwrap();
    let empty = dir.at("empty");
    let (colmap, recording) = (fixture("colmap_text"), fixture("record3d/clip.r3d"));
    let davis = fixture("davis/JPEGImages/480p/ball");
    for (args, code, says) in [
        (vec!["import", &*empty, "-o", &out], 65, "none of the known layouts"),
        (vec!["import", &empty, "-o", &out, "--format", "vipe"], 65, "pose"),
        (
            vec!["import", &empty, "-o", &out, "--format", "obj"],
            2,
            "no format is called obj",
        ),
        (vec!["import", &davis, "-o", &out], 65, "no camera poses"),
        (
            vec!["import", &colmap, "-o", &out, "--fix", "--no-check"],
            2,
            "cannot be used with",
        ),
        (
            vec!["import", &recording, "-o", &out, "--depth", "/nowhere"],
            66,
            "/nowhere",
        ),
    ] {
        refused(&args, code, &[says]);
    }
    assert!(!dir.path("out").exists(), "what cannot be used leaves nothing behind");
}

#[track_caller]
fn bench() -> Option<PathBuf> {
    m4_testkit::shared("bench/quad-1")
}

/// A scene whose cameras are labelled with the wrong axis convention.
#[test]
fn wrong_axes_are_detected_and_corrected() {
    let Some(scene) = bench() else { return };
    let dir = Scratch::new();
    let source = scene.display().to_string();
    let told = |name: &str, more: &[&str]| -> Value {
        let out = dir.at(name);
        let args = ["import", &source, "-o", &out, "--axes", "opencv", "--json"];
        succeed(&[&args[..], more].concat()).result()
    };
    let wrong = told("wrong", &[]);
    // its masks are 255 where something moves, nerfstudio's are 0
    let causes = |found: &Value| -> Vec<String> {
        let causes = found["causes"].as_array().unwrap().iter();
        causes.map(|c| c["cause"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(wrong["check"]["verdict"], "bad");
    assert_eq!(causes(&wrong["check"]), ["masks", "axes"]);
    let right = told("right", &["--fix"]);
    assert_eq!(right["check"]["verdict"], "good", "{right}");
    assert_eq!(causes(&right["check"]["repaired"]), ["masks", "axes"]);
    let read = |path: &Path| capture::read(path, Split::Test, &CaptureOptions::default(), &Silent).unwrap();
    let (truth, fixed) = (read(&scene), read(&dir.path("right")));
    assert_eq!(truth.frames.len(), fixed.frames.len());
    for (a, b) in truth.frames.iter().zip(&fixed.frames) {
        assert!((a.camera.c2w.matrix() - b.camera.c2w.matrix()).amax() < 1e-9);
    }
}

/// What is exported comes back by the importer, which was written against the formats and not against the exporter.
#[test]
fn exported_captures_import_to_the_same_capture() {
    let dir = Scratch::new();
    let source = fixture("dycheck");
    let own = dir.at("own");
    succeed(&["import", &source, "-o", &own, "--no-check"]);
    let read = |name: &str, split| capture::read(&dir.path(name), split, &CaptureOptions::default(), &Silent).unwrap();
    let (train, test) = (read("own", Split::Train), read("own", Split::Test));
    let moves = |c: &minute4d::core::Capture| {
        c.frames
            .iter()
            .filter_map(|f| f.mask.as_ref())
            .map(|m| m.count())
            .sum::<usize>()
    };
    for (format, views) in [("nerfstudio", true), ("colmap", false)] {
        let (out, again) = (dir.at(format), dir.at(&format!("again-{format}")));
        let report = succeed(&["export", &own, "--format", format, "-o", &out, "--json"]).result();
        assert!(report["bytes"].as_u64().unwrap() > 1000, "{report}");
        assert_eq!(
            report["losses"]["dropped"].to_string().contains("held-out views"),
            !views,
            "{report}"
        );
        succeed(&["import", &out, "-o", &again, "--no-check"]);
        let back = read(&format!("again-{format}"), Split::Train);
        assert_eq!(back.frames.len(), train.frames.len(), "{format}");
        for (a, b) in back.frames.iter().zip(&train.frames) {
            assert!(
                (a.camera.c2w.matrix() - b.camera.c2w.matrix()).amax() < 1e-6,
                "{format}"
            );
            assert!((a.camera.intrinsics.fx - b.camera.intrinsics.fx).abs() < 1e-9);
            assert_eq!(a.rgb, b.rgb, "{format}");
            if views {
                let (Some(a), Some(b)) = (&a.depth, &b.depth) else {
                    continue;
                };
                assert!((a.at(9, 7) - b.at(9, 7)).abs() <= 1e-3 * b.at(9, 7), "{format}");
            }
        }
        assert_eq!(moves(&back), moves(&train), "{format}");
        if views {
            assert_eq!(
                read(&format!("again-{format}"), Split::Test).frames.len(),
                test.frames.len()
            );
        }
        refused(
            &["export", &own, "--format", format, "-o", &out],
            73,
            &["already exists", "--force"],
        );
    }
}

#[test]
fn data_sets_that_name_outside_files_need_permission() {
    let dir = Scratch::new();
    let (source, out) = (fixture("blender"), dir.at("out"));
    let args = ["import", &source, "-o", &out, "--no-check"];
    let words = ["transforms_train.json", "clip/images/", "--allow-outside"];
    refused(&args, 65, &words);
    assert!(!dir.path("out").exists());
    succeed(&[&args[..], &["--allow-outside"]].concat());
    // The same of a capture, by every command that reads one.
    let list = dir.path("out/transforms_train.json");
    let text = fs::read_to_string(&list).unwrap();
    fs::rename(dir.path("out/train"), dir.path("private")).unwrap();
    fs::write(&list, text.replace("\"train/", "\"../private/")).unwrap();
    let data = ["--data", &out];
    for command in [
        &["inspect", &out][..],
        &["split", &out, "-o", &dir.at("made"), "--protocol", "holdout"],
        &["export", &out, "--format", "nerfstudio", "-o", &dir.at("made")],
        &["train", &out, "-o", &dir.at("made"), "--iterations", "1"],
        &["run", &out, "-o", &dir.at("made"), "--iterations", "1"],
        &["enhance", &out, "-o", &dir.at("made")],
        &["eval-geometry", &out, "--truth", &out],
        &["ablate", &out, "-o", &dir.at("made"), data[0], data[1]],
    ] {
        refused(command, 65, &["transforms_train.json", "private/", "--allow-outside"]);
    }
    succeed(&["inspect", &out, "--allow-outside"]);
    succeed(&[
        "export",
        &out,
        "--format",
        "nerfstudio",
        "-o",
        &dir.at("exported"),
        "--allow-outside",
    ]);
    let set = [
        "run",
        &out,
        "-o",
        &dir.at("made"),
        "--set",
        "capture.reach=\"Anywhere\"",
    ];
    refused(&set, 78, &["capture.reach"]);
}
