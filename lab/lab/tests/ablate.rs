//! The table of the parts of the method.

use crate::common::{Scratch, capture, mean_image_psnr_db, write_capture};
use std::fs;

#[test]
fn ablate_writes_a_table_of_every_row() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), true);
    let line = "ablate capture -o table --iterations 40 --set train.density.enabled=true --json";
    let report = dir.succeed(line).result();
    let rows = report["rows"].as_array().unwrap();
    let names: Vec<&str> = rows
        .iter()
        .map(|row| row["row"].as_str().unwrap())
        .collect();
    assert_eq!(
        names,
        ["full", "no-seg", "no-track", "no-loss-guided", "no-density"]
    );
    let held_out = capture(6, true).frames.into_iter().map(|f| f.rgb);
    let trivial = mean_image_psnr_db(&capture(6, false).frames, held_out, usize::MAX);
    for row in rows {
        if row["row"] == "no-seg" {
            assert!(
                row["skipped"].as_str().unwrap().contains("no motion map"),
                "{row}"
            );
            continue;
        }
        let psnr = row["psnr_db"].as_f64().unwrap();
        // 26 rounds within 36 steps: gradients add splats faster than they can be trained
        let least = if row["row"] == "no-loss-guided" {
            1.0
        } else {
            3.0
        };
        assert!(
            psnr > trivial + least && row["ssim"].is_number(),
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
        table.contains("without loss-guided (as 3DGS)")
            && table.contains("no density control")
            && table.contains("not applicable"),
        "{table}"
    );
    assert_eq!(dir.json("table/ablation.json"), report);
    // what is finished is taken as it is
    let scene = dir.path("table/full/scene.safetensors");
    let before = fs::metadata(&scene).unwrap().modified().unwrap();
    assert_eq!(
        dir.succeed(line).result()["rows"][0]["psnr_db"],
        rows[0]["psnr_db"]
    );
    assert_eq!(fs::metadata(&scene).unwrap().modified().unwrap(), before);

    write_capture(&dir.path("no-views"), false);
    dir.refused("ablate no-views -o none", 65, &["transforms_test.json"]);
}
