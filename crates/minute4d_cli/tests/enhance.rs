//! Enhancement and ablation from outside.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

#[cfg(feature = "nets")]
use crate::common::{Ended, program};
use crate::common::{Scratch, capture, mean_image_psnr_db, refused, succeed, write_capture};
use minute4d::BUILD_FULL;
use minute4d::Silent;
use minute4d::io::capture::{self as captures, CaptureOptions, Split};
use serde_json::Value;
use std::fs;
use std::path::Path;

fn read(path: &Path) -> minute4d::core::Capture {
    captures::read(path, Split::Train, &CaptureOptions::default(), &Silent).unwrap()
}

#[test]
fn points_are_tracked_without_weights() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let (from, to) = (dir.at("capture"), dir.at("better"));
    let args = [
        "enhance",
        &from,
        "-o",
        &to,
        "--segmenter",
        "none",
        "--tracker",
        "flow",
        "--json",
    ];
    let report = succeed(&args).result()["record"].clone();
    assert_eq!(
        (&report["segmenter"], &report["tracker"]),
        (&"none".into(), &"flow".into())
    );
    let (before, after) = (read(&dir.path("capture")), read(&dir.path("better")));
    assert_eq!(before.frames.len(), after.frames.len());
    let count = after.tracks.as_ref().map_or(0, |tracks| tracks.count());
    assert_eq!(report["tracks"], count);
    assert!(count > 0, "{report}");
    for (a, b) in before.frames.iter().zip(&after.frames) {
        assert_eq!((&a.rgb, &a.mask), (&b.rgb, &b.mask));
    }
    // another is not written over it
    refused(&["enhance", &from, "-o", &to, "--segmenter", "none"], 73, &["--force"]);
}

#[test]
fn impossible_enhancements_are_rejected_with_a_reason() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let from = dir.at("capture");
    let to = dir.at("out");
    let with = |more: &[&'static str]| -> Vec<String> {
        let all = ["enhance", &from, "-o", &to];
        all.iter().chain(more).map(|&word| word.to_owned()).collect()
    };
    let check = |more: &[&'static str], code: i32, words: &[&str]| {
        let args = with(more);
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        refused(&args, code, words);
        assert!(!dir.path("out").exists());
    };
    check(&["--segmenter", "none", "--tracker", "none"], 2, &["nothing to do"]);
    if cfg!(feature = "nets") {
        check(
            &["--segmenter", "sam2"],
            66,
            &["weights add sam2.1-large", "--segmenter none"],
        );
        check(
            &["--tracker", "tapip3d"],
            66,
            &["weights add tapip3d", "--tracker flow"],
        );
    } else {
        check(&["--segmenter", "sam2"], 69, &["without networks", BUILD_FULL]);
        check(&["--tracker", "tapip3d"], 69, &["without networks", BUILD_FULL]);
    }
    refused(&["enhance", &dir.at("nowhere"), "-o", &to], 66, &["nowhere"]);
}

#[test]
fn ablate_writes_a_table_of_every_row() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), true);
    let (from, to) = (dir.at("capture"), dir.at("table"));
    let args = ["ablate", &from, "-o", &to, "--iterations", "40", "--json"];
    let report = succeed(&args).result();
    let rows = report["rows"].as_array().unwrap();
    let names: Vec<&str> = rows.iter().map(|row| row["row"].as_str().unwrap()).collect();
    assert_eq!(names, ["full", "no-seg", "no-track", "no-density"]);
    let held_out = capture(6, true).frames.into_iter().map(|f| f.rgb);
    let trivial = mean_image_psnr_db(&capture(6, false).frames, held_out, usize::MAX);
    for row in rows {
        if row["row"] == "no-seg" {
            assert!(row["skipped"].as_str().unwrap().contains("no motion map"), "{row}");
            continue;
        }
        let psnr = row["psnr_db"].as_f64().unwrap();
        assert!(
            psnr > trivial + 3.0 && row["ssim"].is_number(),
            "{psnr} dB, the mean image {trivial} dB: {row}"
        );
        assert_eq!(
            (&row["iterations"], row["train_s"].is_number()),
            (&40.into(), true),
            "{row}"
        );
        assert!(row["geometry_s"].is_null(), "{row}");
    }
    let table = fs::read_to_string(dir.path("table/ablation.md")).unwrap();
    assert!(
        table.contains("without density control") && table.contains("not made"),
        "{table}"
    );
    let kept: Value = serde_json::from_slice(&fs::read(dir.path("table/ablation.json")).unwrap()).unwrap();
    assert_eq!(kept, report);
    // what is finished is taken as it is
    let scene = dir.path("table/full/scene.safetensors");
    let before = fs::metadata(&scene).unwrap().modified().unwrap();
    assert_eq!(succeed(&args).result()["rows"][0]["psnr_db"], rows[0]["psnr_db"]);
    assert_eq!(fs::metadata(&scene).unwrap().modified().unwrap(), before);

    write_capture(&dir.path("no-views"), false);
    let bare = dir.at("no-views");
    refused(&["ablate", &bare, "-o", &dir.at("none")], 65, &["transforms_test.json"]);
}

/// Networks with synthetic weights: only that they run and return is tested.
#[cfg(feature = "nets")]
#[test]
fn networks_enhance_a_capture() {
    use m4_testkit::{FormulaWeights, write_formula_weights};
    let dir = Scratch::new();
    let store = dir.path("weights");
    for name in ["sam2.1-tiny", "tapip3d"] {
        fs::create_dir_all(store.join(name)).unwrap();
    }
    let tiny = include_str!("../../../fixtures/sam2/tiny.keys.txt");
    write_formula_weights(tiny, &store.join("sam2.1-tiny/sam2.1_hiera_tiny.pt"));
    let keys = include_str!("../../../fixtures/tapip3d/keys.txt");
    let config = include_str!("../../../fixtures/tapip3d/config.json");
    FormulaWeights::of_keys(keys)
        .scaled("point_updater.flow_head.weight", 0.005)
        .write_with(Some(("config", config)), &store.join("tapip3d/tapip3d.safetensors"));
    captures::write(&dir.path("capture"), &capture(3, false), Split::Train, &Silent).unwrap();
    let mut command = program();
    command.env("MINUTE4D_WEIGHTS", &store);
    command.args(["enhance", &dir.at("capture"), "-o", &dir.at("better"), "--json"]);
    command.args(["--segmenter", "sam2", "--tracker", "tapip3d"]);
    for set in [
        "enhance.tapip3d.size=1.0",
        "enhance.tapip3d.iterations=1",
        "enhance.tapip3d.most=40",
        "enhance.tapip3d.every=1",
    ] {
        command.args(["--set", set]);
    }
    let ended = Ended::of(command.output().unwrap());
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    let report = ended.result()["record"].clone();
    assert_eq!(
        (&report["segmenter"], &report["tracker"]),
        (&"sam2".into(), &"tapip3d".into())
    );
    let networks: Vec<&str> = report["networks"]
        .as_array()
        .unwrap()
        .iter()
        .map(|n| n["weights"].as_str().unwrap())
        .collect();
    assert_eq!(networks, ["sam2.1-tiny", "tapip3d"]);
    assert_eq!(report["networks"][1]["commercial"], false);
    assert!(report["tracks"].as_u64().unwrap() > 0, "{report}");
    let found: Value = serde_json::from_slice(&fs::read(dir.path("better/instances.json")).unwrap()).unwrap();
    assert_eq!(found["segmenter"], "sam2.1-tiny");
    let better = read(&dir.path("better"));
    assert!(
        better
            .frames
            .iter()
            .all(|frame| frame.instances.is_some() && frame.mask.is_some())
    );
}
