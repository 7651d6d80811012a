//! Protocols from outside: frames are split, scenes judged, and the tables of data sets made from
//! folders in their exact layouts.

use crate::common::clips::{write_dycheck, write_dycheck_of, write_npy};
use crate::common::{SIZE, Scratch, capture, clips, mean_image_psnr_db, see};
use m4_core::{Camera, Capture, CaptureFrame, Plane, RgbImage};
use m4_io::image::{write_mask, write_rgb};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

/// What a camera sees at the moment of frame `i` of `n`.
fn seen_from(camera: &Camera, i: usize, n: usize) -> RgbImage {
    see(camera, i as f64 / (n - 1) as f64).0
}

/// A scene in the layout of RoDynRF's bundle: camera `i` took image `i`, camera 0 is judged at all
/// moments.
fn write_nvidia(root: &Path, n: usize) {
    for folder in ["images_2", "disp", "motion_masks", "gt"] {
        fs::create_dir_all(root.join(folder)).unwrap();
    }
    let train = capture(n, false);
    let mut poses = Vec::new();
    for (i, frame) in train.frames.iter().enumerate() {
        let (r, c, k) = (
            frame.camera.c2w.rotation,
            frame.camera.centre(),
            &frame.camera.intrinsics,
        );
        let hwf = [2.0 * k.height as f64, 2.0 * k.width as f64, 2.0 * k.fx];
        for row in 0..3 {
            // down, right, back
            poses.extend([r[(row, 1)], r[(row, 0)], -r[(row, 2)], c[row], hwf[row]]);
        }
        poses.extend([2.5, 4.0]);
        write_rgb(&root.join(format!("images_2/{i:03}.png")), &frame.rgb).unwrap();
        write_mask(
            &root.join(format!("motion_masks/{i:03}.png")),
            &frame.mask.as_ref().unwrap().to_mask(),
        )
        .unwrap();
        let depth = frame.depth.as_ref().unwrap().to_map();
        let disparity: Vec<f64> = depth.data().iter().map(|&z| 1.0 / f64::from(z)).collect();
        let shape = [depth.height(), depth.width()];
        write_npy(
            &root.join(format!("disp/{i:03}.npy")),
            &shape,
            &disparity,
            false,
        );
        let truth = seen_from(&train.frames[0].camera, i, n);
        write_rgb(&root.join(format!("gt/v000_t{i:03}.png")), &truth).unwrap();
    }
    write_npy(&root.join("poses_bounds.npy"), &[n, 17], &poses, true);
}

#[test]
fn dycheck_layout_is_reproduced() {
    let dir = Scratch::new();
    for (scene, masks) in [("apple", true), ("teddy", true)] {
        write_dycheck(&dir.path(&format!("data/iphone/{scene}")), 14, masks);
    }
    let line = "reproduce dycheck --data data -o out --iterations 40 --json";
    let report = dir.succeed(line).result();
    let tables = report["tables"].as_array().unwrap();
    assert_eq!(tables.len(), 2);
    let [held_out, novel] = [&tables[0], &tables[1]];
    assert_eq!(
        (&held_out["protocol"], &novel["protocol"]),
        (&json!("instant4d"), &json!("dycheck"))
    );
    assert_eq!(
        (&held_out["task"], &novel["task"]),
        (&json!("held_out_frames"), &json!("novel_views"))
    );
    assert_eq!(
        (
            &held_out["scenes_of_published"],
            &novel["scenes_of_published"]
        ),
        (&json!([2, 5]), &json!([2, 7]))
    );
    assert_eq!(report["missing"].as_array().unwrap().len(), 5);
    // 14 frames: int(0.85 * 14) = 11 train; camera 1 at moments 1, 5, 9 and 13
    assert_eq!(
        (&held_out["rows"][0]["views"], &novel["rows"][0]["views"]),
        (&json!(3), &json!(4))
    );
    let number = |v: &Value| v.as_f64().unwrap();
    let (frames, views) = (capture(14, false).frames, capture(14, true).frames);
    // held out are frames 4, 8 and 12
    let (left_out, training): (Vec<_>, Vec<_>) = frames
        .iter()
        .enumerate()
        .partition(|(i, _)| i % 4 == 0 && *i > 0);
    let left_out = left_out.into_iter().map(|(_, frame)| frame.rgb.clone());
    let trivial = mean_image_psnr_db(
        training.into_iter().map(|(_, frame)| frame),
        left_out,
        usize::MAX,
    );
    for row in held_out["rows"].as_array().unwrap() {
        let psnr = number(&row["headline"]);
        assert!(
            // measured: 2.6 dB
            psnr > trivial + 2.0 && row["headline"] == row["psnr_db"],
            "{psnr} dB, the mean image {trivial} dB: {row}"
        );
    }
    // the last 8 columns are masked
    let novel_views = views.into_iter().skip(1).step_by(4).map(|frame| frame.rgb);
    let trivial = mean_image_psnr_db(&frames, novel_views, SIZE.0 - 8);
    for row in novel["rows"].as_array().unwrap() {
        assert_eq!(row["headline"], row["others"]["psnr_joint_masked"]);
        let psnr = number(&row["headline"]);
        assert!(
            psnr > trivial + 3.0 && row["headline"] != row["psnr_db"],
            "{psnr} dB, the mean image {trivial} dB: {row}"
        );
        assert_eq!(row["mask"], "published co-visibility masks,");
    }
    let eval = dir.json("out/dycheck/apple/run/eval.json");
    assert!(
        (number(&eval["choices"]["mask"]["share"]) - 56.0 / 64.0).abs() < 1e-9,
        "{}",
        eval["choices"]["mask"]
    );

    let table = fs::read_to_string(dir.path("out/reproduce.md")).unwrap();
    for words in [
        "apple",
        "teddy",
        "25.77",
        "29 s",
        "MoSca",
        "mPSNR",
        "space-out: is not there",
        "do not compare yet",
    ] {
        assert!(table.contains(words), "{words} is not in {table}");
    }
    // each task in a part of its own
    let (first_part, second_part) = table.split_at(table.find("## dycheck").unwrap());
    assert!(first_part.contains("25.77") && !first_part.contains("MoSca"));
    assert!(second_part.contains("MoSca") && !second_part.contains("25.77"));
    for protocol in ["instant4d", "dycheck"] {
        let svg = fs::read_to_string(dir.path(&format!("out/reproduce-{protocol}.svg"))).unwrap();
        assert!(
            svg.contains("this run") && svg.matches("<rect").count() > 10,
            "{svg}"
        );
    }

    // nothing is made again
    let eval_time = |scene: &str| {
        fs::metadata(dir.path(&format!("out/instant4d/{scene}/run/eval.json")))
            .unwrap()
            .modified()
            .unwrap()
    };
    let (apple, teddy) = (eval_time("apple"), eval_time("teddy"));
    let again = dir.succeed(line);
    assert_eq!(again.result()["tables"], report["tables"]);
    assert_eq!((eval_time("apple"), eval_time("teddy")), (apple, teddy));
    assert!(!again.stdout.contains("\"train\""), "{}", again.stdout);
    // but what has lost its scores is
    fs::remove_file(dir.path("out/instant4d/teddy/run/eval.json")).unwrap();
    assert_eq!(dir.succeed(line).result()["tables"][1], report["tables"][1]);
    assert!(eval_time("apple") == apple && eval_time("teddy") > teddy);
}

#[test]
fn nvidia_layout_is_reproduced() {
    let dir = Scratch::new();
    write_nvidia(&dir.path("data/Balloon1"), 12);
    let line = "reproduce nvidia --data data -o out --iterations 60";
    let report = dir.succeed(&format!("{line} --json")).result();
    let row = &report["tables"][0]["rows"][0];
    let number = |v: &Value| v.as_f64().unwrap();
    assert_eq!(
        (&row["scene"], &row["views"]),
        (&json!("Balloon1"), &json!(12))
    );
    let frames = capture(12, false).frames;
    let views = (0..12).map(|i| seen_from(&frames[0].camera, i, 12));
    let trivial = mean_image_psnr_db(&frames, views, usize::MAX);
    let psnr = number(&row["headline"]);
    assert!(
        psnr > trivial + 3.0 && row["headline"] == row["others"]["psnr_eight_bit"],
        "{psnr} dB, the mean image {trivial} dB: {row}"
    );
    assert!(
        number(&row["others"]["ssim_skimage_uniform"]) > 0.3,
        "{row}"
    );
    // the view at time 0 took part in training
    let eval = dir.json("out/nvidia/Balloon1/run/eval.json");
    let frames = &eval["choices"]["frames"];
    assert_eq!(
        frames["also_training"].as_array().unwrap().len(),
        1,
        "{frames}"
    );
    assert_eq!(frames["mean_without"]["frames"], 11);
    let table = fs::read_to_string(dir.path("out/reproduce.md")).unwrap();
    assert!(
        table.contains("1218") && table.contains("24.73") && !table.contains("25.77"),
        "{table}"
    );

    let words = ["breakdance-flare", "davischallenge.org"];
    dir.refused("reproduce davis --data data -o out", 66, &words);
    let words = ["its protocols are nvidia"];
    dir.refused(
        "reproduce nvidia --data data -o out --protocols dycheck",
        2,
        &words,
    );
    fs::remove_dir_all(dir.path("data/Balloon1/gt")).unwrap();
    dir.refused(line, 65, &["no held-out views"]);
}

#[test]
fn faithful_settings_follow_the_data_set_and_options_win() {
    let dir = Scratch::new();
    let printed = |suite: &str, more: &str, wanted: &[&str]| {
        let line = format!(
            "reproduce {suite} --data data -o out --print-config --profile faithful {more}"
        );
        let text = dir.succeed(&line).stdout;
        assert!(
            wanted.iter().all(|line| text.lines().any(|l| l == *line)),
            "{suite} {more}: {wanted:?} in {text}"
        );
    };
    printed(
        "dycheck",
        "",
        &["iterations = 5000", "every_frames = 50", "every = 10"],
    );
    printed(
        "nvidia",
        "",
        &["iterations = 1500", "every_frames = 2", "every = 1"],
    );
    printed(
        "davis",
        "",
        &["iterations = 5000", "every_frames = 10", "every = 10"],
    );
    let more = "--iterations 7 --set enhance.masks.every_frames=3";
    printed(
        "nvidia",
        more,
        &["iterations = 7", "every_frames = 3", "every = 1"],
    );
}

/// What cameras see of a room in which nothing moves.
fn room(cameras: &[Camera]) -> Capture {
    let frame = |(i, camera): (usize, &Camera)| {
        let (w, h) = clips::SIZE;
        let depth = Plane::from_fn(w, h, |x, y| clips::see(camera, x as f64, y as f64).1 as f32);
        CaptureFrame {
            name: format!("{i:05}"),
            camera: *camera,
            t: i as f64,
            rgb: clips::frame_image(camera),
            depth: Some(depth.into()),
            mask: None,
            motion: None,
            instances: None,
            camera_index: None,
            distance_sigma: None,
        }
    };
    Capture {
        frames: cameras.iter().enumerate().map(frame).collect(),
        time_frames: cameras.len(),
        duration_s: Some(2.3),
        metric: false,
        tracks: None,
    }
}

#[test]
fn reproduce_runs_ablations_and_estimated_geometry() {
    let dir = Scratch::new();
    let views: Vec<Camera> = (0..24)
        .map(|i| clips::camera(0.02 * f64::from(i), 0.1, clips::FOCAL_PX))
        .collect();
    let captures = [room(&clips::walk(24)), room(&views)];
    write_dycheck_of(&dir.path("data/spin"), captures, true);
    let with = |more: &str| {
        let line = "reproduce dycheck --data data -o out --scenes spin --json --iterations 15 --set train.density.enabled=true";
        dir.succeed(&format!("{line} {more}")).result()
    };
    let report = with("--protocols instant4d --ablations");
    let rows = report["tables"][0]["ablations"][0]["report"]["rows"]
        .as_array()
        .unwrap();
    assert_eq!(rows.len(), 5, "{report}");
    for row in rows {
        // depth without a map of motion: there is nothing that segmentation could have made of it
        assert_eq!(row["skipped"].is_string(), row["row"] == "no-seg", "{row}");
        assert_eq!(row["psnr_db"].is_number(), row["row"] != "no-seg", "{row}");
    }
    let table = fs::read_to_string(dir.path("out/reproduce.md")).unwrap();
    for words in [
        "#### spin",
        "without loss-guided",
        "no density control",
        "24.60 dB",
    ] {
        assert!(table.contains(words), "{words} is not in {table}");
    }
    // poses of the images alone: the views of other cameras are placed by aligning
    // ... and what was made with the data set's is computed again
    let report = with("--protocols instant4d,dycheck --geometry own --ablations");
    let [held_out, novel] = [0, 1].map(|k| &report["tables"][k]);
    assert_eq!(held_out["rows"][0]["poses"], "own", "{held_out}");
    for table in [held_out, novel] {
        let full = &table["ablations"][0]["report"]["rows"][0];
        let [a, b] = [full, &table["rows"][0]].map(|row| row["psnr_db"].as_f64().unwrap());
        assert!((a - b).abs() < 0.5, "{full}");
    }
    let row = &novel["rows"][0];
    assert_eq!(row["poses"], "own, aligned", "{row}");
    assert!(
        row["geometry_s"].as_f64().unwrap() > 0.0 && row["psnr_db"].is_number(),
        "{row}"
    );
    assert!(dir.path("out/captures-own/spin/geometry.json").is_file());
}
