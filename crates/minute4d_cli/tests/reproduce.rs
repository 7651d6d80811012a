//! Protocols from outside: frames are split, scenes judged, and the tables of data sets made from folders in their exact layouts.

use crate::common::clips::{write_dycheck, write_dycheck_of, write_nvidia};
use crate::common::{SIZE, Scratch, capture, clips, mean_image_psnr_db, seen_from, write_capture};
use minute4d::Silent;
use minute4d::m4_core::{Camera, Capture, CaptureFrame, Plane};
use minute4d::m4_io::capture::Split;
use serde_json::{Value, json};
use std::fs;

#[test]
fn eval_by_protocol_reports_every_choice() {
    let dir = Scratch::new();
    let whole: Capture = capture(24, false);
    minute4d::m4_io::capture::write(&dir.path("whole"), &whole, Split::Train, &Silent).unwrap();
    let record = dir.succeed("split whole --protocol rodygs -o part --json").result();
    assert_eq!(record["held_out"], json!([4, 12, 20]));
    dir.succeed("train part -o run --iterations 60");
    let report = dir.succeed("eval run --data part --protocol rodygs --json").result();
    let c = &report["choices"];
    assert_eq!((&c["protocol"], &c["task"]), (&json!("rodygs"), &json!("held_out_frames")));
    assert_eq!(c["frames"]["rule"], json!({"rule": "every", "every": 8, "offset": 4}));
    assert_eq!((&c["frames"]["indices"], &c["frames"]["of_frames"]), (&json!([4, 12, 20]), &json!(24)));
    assert_eq!(c["frames"]["scored"].as_array().unwrap().len(), 3);
    assert_eq!(c["frames"]["also_training"], json!([]));
    assert_eq!(c["resolution"], json!({"scored_px": [64, 48], "protocol_px": [360, 480]}));
    assert_eq!(c["mask"]["source"], "none");
    assert!(c["render"].as_str().unwrap().contains("not rounded"));
    for metric in ["psnr_db", "ssim", "psnr_per_channel", "psnr_per_channel_unclamped", "ssim_gaussian_zero_padded"] {
        assert!(c["metrics"][metric].is_string(), "{metric}: {c}");
    }
    assert!(c["metrics"]["ssim"].as_str().unwrap().contains("11 px"), "{c}");
    // no weights here: said, with the command that gets them
    let lpips = c["lpips"].as_array().unwrap();
    assert_eq!((lpips.len(), &lpips[0]["net"], &lpips[1]["net"]), (2, &json!("alex"), &json!("vgg")));
    assert!(
        lpips[0]["absent"].as_str().unwrap().contains(if cfg!(feature = "nets") {
            "minute4d weights fetch lpips-alex"
        } else {
            minute4d::BUILD_FULL
        }),
        "{c}"
    );
    assert!(lpips[0]["definition"].as_str().unwrap().contains("2 x - 1") && lpips[0]["score"].is_null());
    let poses = &c["poses"];
    assert_eq!((&poses["treatment"], &poses["geometry_saw_held_out"]), (&json!("given"), &json!(true)));
    assert_eq!(poses["refinement_of_protocol"]["steps"], 1000);
    assert!(poses["words"].as_str().unwrap().contains("was not done here"), "{poses}");
    assert_eq!(c["headline"]["name"], "psnr_db");
    let number = |v: &Value| v.as_f64().unwrap();
    assert_eq!(number(&c["headline"]["mean"]), number(&report["mean"]["psnr_db"]));
    let (held_out, kept): (Vec<_>, Vec<_>) = whole.frames.iter().enumerate().partition(|(i, _)| i % 8 == 4);
    let views = held_out.into_iter().map(|(_, frame)| frame.rgb.clone());
    let trivial = mean_image_psnr_db(kept.into_iter().map(|(_, frame)| frame), views, usize::MAX);
    let psnr = number(&report["mean"]["psnr_db"]);
    assert!(psnr > trivial + 3.0, "{psnr} dB, the mean image {trivial} dB");
    // a mean of logarithms is never below that of the mean
    let others = &report["mean_others"];
    assert!(number(&others["psnr_per_channel"]["mean"]) >= number(&report["mean"]["psnr_db"]) - 1e-9);
    assert_eq!(dir.json("run/eval.json")["choices"], report["choices"]);

    let refined = dir.succeed("eval run --data part --protocol rodygs --refine-poses --json");
    let refined = refined.result();
    let poses = &refined["choices"]["poses"];
    assert_eq!((&poses["treatment"], poses["moved"].as_array().unwrap().len()), (&json!("refined"), 3));
    assert_eq!(number(&poses["mean_unrefined"]["psnr_db"]), number(&report["mean"]["psnr_db"]));
    assert!(poses["moved"].as_array().unwrap().iter().all(|m| number(&m["mse"][1]) < number(&m["mse"][0])), "{poses}");

    // without a protocol everything is as before
    let plain = dir.succeed("eval run --data part --json").result();
    assert!(plain["choices"].is_null() && plain["mean"]["psnr_db"].is_number());

    write_capture(&dir.path("views"), true);
    for (line, code, words) in [
        ("eval run --data part --protocol instant4d", 65, &["rodygs", "minute4d split"][..]),
        ("eval run --data part --protocol dycheck", 65, &["rodygs"]),
        ("eval run --data part --protocol holdout --refine-poses", 2, &["does not refine"]),
        ("eval run --data views --protocol davis", 65, &["no split.json"]),
        ("split views --protocol nvidia -o x", 2, &["nothing to split"]),
        ("split views --protocol rodygs -o views", 73, &["is an input of this command"]),
    ] {
        dir.refused(line, code, words);
    }
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
    assert_eq!((&held_out["protocol"], &novel["protocol"]), (&json!("instant4d"), &json!("dycheck")));
    assert_eq!((&held_out["task"], &novel["task"]), (&json!("held_out_frames"), &json!("novel_views")));
    assert_eq!((&held_out["scenes_of_published"], &novel["scenes_of_published"]), (&json!([2, 5]), &json!([2, 7])));
    assert_eq!(report["missing"].as_array().unwrap().len(), 5);
    // 14 frames: int(0.85 * 14) = 11 train; camera 1 at moments 1, 5, 9 and 13
    assert_eq!((&held_out["rows"][0]["views"], &novel["rows"][0]["views"]), (&json!(3), &json!(4)));
    let number = |v: &Value| v.as_f64().unwrap();
    let (frames, views) = (capture(14, false).frames, capture(14, true).frames);
    // held out are frames 4, 8 and 12
    let (left_out, kept): (Vec<_>, Vec<_>) = frames.iter().enumerate().partition(|(i, _)| i % 4 == 0 && *i > 0);
    let left_out = left_out.into_iter().map(|(_, frame)| frame.rgb.clone());
    let trivial = mean_image_psnr_db(kept.into_iter().map(|(_, frame)| frame), left_out, usize::MAX);
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
    assert!((number(&eval["choices"]["mask"]["share"]) - 56.0 / 64.0).abs() < 1e-9, "{}", eval["choices"]["mask"]);

    let table = fs::read_to_string(dir.path("out/reproduce.md")).unwrap();
    for words in ["apple", "teddy", "25.77", "29 s", "MoSca", "mPSNR", "space-out: is not there", "do not compare yet"]
    {
        assert!(table.contains(words), "{words} is not in {table}");
    }
    // each task in a part of its own
    let (first_part, second_part) = table.split_at(table.find("## dycheck").unwrap());
    assert!(first_part.contains("25.77") && !first_part.contains("MoSca"));
    assert!(second_part.contains("MoSca") && !second_part.contains("25.77"));
    for protocol in ["instant4d", "dycheck"] {
        let svg = fs::read_to_string(dir.path(&format!("out/reproduce-{protocol}.svg"))).unwrap();
        assert!(svg.contains("this run") && svg.matches("<rect").count() > 10, "{svg}");
    }

    // nothing is made again
    let made = |scene: &str| {
        fs::metadata(dir.path(&format!("out/instant4d/{scene}/run/eval.json"))).unwrap().modified().unwrap()
    };
    let (apple, teddy) = (made("apple"), made("teddy"));
    let again = dir.succeed(line);
    assert_eq!(again.result()["tables"], report["tables"]);
    assert_eq!((made("apple"), made("teddy")), (apple, teddy));
    assert!(!again.stdout.contains("\"train\""), "{}", again.stdout);
    // but what has lost its scores is
    fs::remove_file(dir.path("out/instant4d/teddy/run/eval.json")).unwrap();
    assert_eq!(dir.succeed(line).result()["tables"][1], report["tables"][1]);
    assert!(made("apple") == apple && made("teddy") > teddy);
}

#[test]
fn nvidia_layout_is_reproduced() {
    let dir = Scratch::new();
    write_nvidia(&dir.path("data/Balloon1"), 12);
    let line = "reproduce nvidia --data data -o out --iterations 60";
    let report = dir.succeed(&format!("{line} --json")).result();
    let row = &report["tables"][0]["rows"][0];
    let number = |v: &Value| v.as_f64().unwrap();
    assert_eq!((&row["scene"], &row["views"]), (&json!("Balloon1"), &json!(12)));
    let frames = capture(12, false).frames;
    let views = (0..12).map(|i| seen_from(&frames[0].camera, i, 12));
    let trivial = mean_image_psnr_db(&frames, views, usize::MAX);
    let psnr = number(&row["headline"]);
    assert!(
        psnr > trivial + 3.0 && row["headline"] == row["others"]["psnr_eight_bit"],
        "{psnr} dB, the mean image {trivial} dB: {row}"
    );
    assert!(number(&row["others"]["ssim_skimage_uniform"]) > 0.3, "{row}");
    // the view at time 0 took part in training
    let eval = dir.json("out/nvidia/Balloon1/run/eval.json");
    let frames = &eval["choices"]["frames"];
    assert_eq!(frames["also_training"].as_array().unwrap().len(), 1, "{frames}");
    assert_eq!(frames["mean_without"]["frames"], 11);
    let table = fs::read_to_string(dir.path("out/reproduce.md")).unwrap();
    assert!(table.contains("1218") && table.contains("24.73") && !table.contains("25.77"), "{table}");

    let words = ["breakdance-flare", "davischallenge.org"];
    dir.refused("reproduce davis --data data -o out", 66, &words);
    let words = ["its protocols are nvidia"];
    dir.refused("reproduce nvidia --data data -o out --protocols dycheck", 2, &words);
    fs::remove_dir_all(dir.path("data/Balloon1/gt")).unwrap();
    dir.refused(line, 65, &["no held-out views"]);
}

#[test]
fn faithful_settings_follow_the_data_set_and_options_win() {
    let dir = Scratch::new();
    let printed = |suite: &str, more: &str, wanted: &[&str]| {
        let line = format!("reproduce {suite} --data data -o out --print-config --profile faithful {more}");
        let text = dir.succeed(&line).stdout;
        assert!(wanted.iter().all(|line| text.lines().any(|l| l == *line)), "{suite} {more}: {wanted:?} in {text}");
    };
    printed("dycheck", "", &["iterations = 5000", "every_frames = 50", "every = 10"]);
    printed("nvidia", "", &["iterations = 1500", "every_frames = 2", "every = 1"]);
    printed("davis", "", &["iterations = 5000", "every_frames = 10", "every = 10"]);
    let more = "--iterations 7 --set enhance.masks.every_frames=3";
    printed("nvidia", more, &["iterations = 7", "every_frames = 3", "every = 1"]);
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
    let views: Vec<Camera> = (0..24).map(|i| clips::camera(0.02 * f64::from(i), 0.1, clips::FOCAL_PX)).collect();
    let captures = [room(&clips::walk(24)), room(&views)];
    write_dycheck_of(&dir.path("data/spin"), captures, true);
    let with = |more: &str| {
        let line = "reproduce dycheck --data data -o out --scenes spin --json --iterations 15 --set train.density.enabled=true";
        dir.succeed(&format!("{line} {more}")).result()
    };
    let report = with("--protocols instant4d --ablations");
    let rows = report["tables"][0]["ablations"][0]["report"]["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 5, "{report}");
    for row in rows {
        // depth without a map of motion: there is nothing that segmentation could have made of it
        assert_eq!(row["skipped"].is_string(), row["row"] == "no-seg", "{row}");
        assert_eq!(row["psnr_db"].is_number(), row["row"] != "no-seg", "{row}");
    }
    let table = fs::read_to_string(dir.path("out/reproduce.md")).unwrap();
    for words in ["#### spin", "without loss-guided", "no density control", "24.60 dB"] {
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
    assert!(row["geometry_s"].as_f64().unwrap() > 0.0 && row["psnr_db"].is_number(), "{row}");
    assert!(dir.path("out/captures-own/spin/geometry.json").is_file());
}

#[test]
fn import_copies_published_masks() {
    let dir = Scratch::new();
    write_dycheck(&dir.path("apple"), 14, true);
    dir.succeed("import apple -o capture");
    assert_eq!(dir.count("capture/covisible"), 4);
    // what an earlier import left does not stay
    fs::remove_dir_all(dir.path("apple/covisible")).unwrap();
    dir.succeed("import apple -o capture --force");
    assert!(!dir.path("capture/covisible").exists());
}
