//! Enhancement and ablation from outside.

#[cfg(feature = "nets")]
use crate::common::Ended;
use crate::common::{Scratch, capture, mean_image_psnr_db, read_capture, write_capture};
use minute4d::BUILD_FULL;
#[cfg(feature = "nets")]
use minute4d::Silent;
use minute4d::m4_io::capture::Split;
use std::fs;

#[test]
fn points_are_tracked_without_weights() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let line = "enhance capture -o better --segmenter none";
    let report = dir.succeed(&format!("{line} --tracker flow --json")).result()["record"].clone();
    assert_eq!((&report["segmenter"], &report["tracker"]), (&"none".into(), &"flow".into()));
    let (before, after) =
        (read_capture(&dir.path("capture"), Split::Train), read_capture(&dir.path("better"), Split::Train));
    assert_eq!(before.frames.len(), after.frames.len());
    let count = after.tracks.as_ref().map_or(0, |tracks| tracks.count());
    assert_eq!(report["tracks"], count);
    assert!(count > 0, "{report}");
    for (a, b) in before.frames.iter().zip(&after.frames) {
        assert_eq!((&a.rgb, &a.mask), (&b.rgb, &b.mask));
    }
    // another is not written over it
    dir.refused(line, 73, &["--force"]);
}

#[test]
fn impossible_enhancements_are_rejected_with_a_reason() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let without = ["without networks", BUILD_FULL];
    let of_networks = |line: &str, words: &[&str]| match cfg!(feature = "nets") {
        true => dir.refused(line, 66, words),
        false => dir.refused(line, 69, &without),
    };
    let line = "enhance capture -o out --segmenter none --tracker none";
    dir.refused(line, 2, &["nothing to do"]);
    of_networks("enhance capture -o out --segmenter sam2", &["weights add sam2.1-large", "--segmenter none"]);
    of_networks("enhance capture -o out --tracker tapip3d", &["weights add tapip3d", "--tracker flow"]);
    dir.refused("enhance nowhere -o out", 66, &["nowhere"]);
    assert!(!dir.path("out").exists());
}

#[test]
fn ablate_writes_a_table_of_every_row() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), true);
    let line = "ablate capture -o table --iterations 40 --set train.density.enabled=true --json";
    let report = dir.succeed(line).result();
    let rows = report["rows"].as_array().unwrap();
    let names: Vec<&str> = rows.iter().map(|row| row["row"].as_str().unwrap()).collect();
    assert_eq!(names, ["full", "no-seg", "no-track", "no-loss-guided", "no-density"]);
    let held_out = capture(6, true).frames.into_iter().map(|f| f.rgb);
    let trivial = mean_image_psnr_db(&capture(6, false).frames, held_out, usize::MAX);
    for row in rows {
        if row["row"] == "no-seg" {
            assert!(row["skipped"].as_str().unwrap().contains("no motion map"), "{row}");
            continue;
        }
        let psnr = row["psnr_db"].as_f64().unwrap();
        // 26 rounds within 36 steps: gradients add splats faster than they can be trained
        let least = if row["row"] == "no-loss-guided" { 1.0 } else { 3.0 };
        assert!(psnr > trivial + least && row["ssim"].is_number(), "{psnr} dB, the mean image {trivial} dB: {row}");
        assert_eq!((&row["iterations"], row["train_s"].is_number()), (&40.into(), true), "{row}");
        assert!(row["geometry_s"].is_null(), "{row}");
    }
    let table = fs::read_to_string(dir.path("table/ablation.md")).unwrap();
    assert!(
        table.contains("without loss-guided (as 3DGS)")
            && table.contains("no density control")
            && table.contains("not applicable"),
        "{table}"
    );
    assert_eq!(dir.json("table/ablation.json"), report);
    // what is finished is taken as it is
    let scene = dir.path("table/full/scene.safetensors");
    let before = fs::metadata(&scene).unwrap().modified().unwrap();
    assert_eq!(dir.succeed(line).result()["rows"][0]["psnr_db"], rows[0]["psnr_db"]);
    assert_eq!(fs::metadata(&scene).unwrap().modified().unwrap(), before);

    write_capture(&dir.path("no-views"), false);
    dir.refused("ablate no-views -o none", 65, &["transforms_test.json"]);
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
    minute4d::m4_io::capture::write(&dir.path("capture"), &capture(3, false), Split::Train, &Silent).unwrap();
    let line = "enhance capture -o better --json --segmenter sam2 --tracker tapip3d --set enhance.tapip3d.size=1.0 \
                --set enhance.tapip3d.iterations=1 --set enhance.tapip3d.most=40 --set enhance.tapip3d.every=1";
    let mut command = dir.command(line);
    let ended = Ended::of(command.env("MINUTE4D_WEIGHTS", &store).output().unwrap());
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    let report = ended.result()["record"].clone();
    assert_eq!((&report["segmenter"], &report["tracker"]), (&"sam2".into(), &"tapip3d".into()));
    let networks: Vec<&str> =
        report["networks"].as_array().unwrap().iter().map(|n| n["weights"].as_str().unwrap()).collect();
    assert_eq!(networks, ["sam2.1-tiny", "tapip3d"]);
    assert_eq!(report["networks"][1]["commercial"], false);
    assert!(report["tracks"].as_u64().unwrap() > 0, "{report}");
    assert_eq!(dir.json("better/instances.json")["segmenter"], "sam2.1-tiny");
    let better = read_capture(&dir.path("better"), Split::Train);
    assert!(better.frames.iter().all(|frame| frame.instances.is_some() && frame.mask.is_some()));
}
