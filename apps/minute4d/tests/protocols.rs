//! Protocols from outside: frames are split, scenes scored.

use crate::common::clips::write_dycheck;
use crate::common::{Scratch, capture, mean_image_psnr_db, write_capture};
use m4_core::Capture;
use m4_io::capture::Split;
use minute4d::Silent;
use serde_json::{Value, json};
use std::fs;

#[test]
fn eval_by_protocol_reports_every_choice() {
    let dir = Scratch::new();
    let whole: Capture = capture(24, false);
    m4_io::capture::write(&dir.path("whole"), &whole, Split::Train, &Silent).unwrap();
    let record = dir
        .succeed("split whole --protocol rodygs -o part --json")
        .result();
    assert_eq!(record["held_out"], json!([4, 12, 20]));
    dir.succeed("train part -o run --iterations 60");
    let report = dir
        .succeed("eval run --data part --protocol rodygs --json")
        .result();
    let c = &report["choices"];
    assert_eq!(
        (&c["protocol"], &c["task"]),
        (&json!("rodygs"), &json!("held_out_frames"))
    );
    assert_eq!(
        c["frames"]["rule"],
        json!({"rule": "every", "every": 8, "offset": 4})
    );
    assert_eq!(
        (&c["frames"]["indices"], &c["frames"]["of_frames"]),
        (&json!([4, 12, 20]), &json!(24))
    );
    assert_eq!(c["frames"]["scored"].as_array().unwrap().len(), 3);
    assert_eq!(c["frames"]["also_training"], json!([]));
    assert_eq!(
        c["resolution"],
        json!({"scored_px": [64, 48], "protocol_px": [360, 480]})
    );
    assert_eq!(c["mask"]["source"], "none");
    assert!(c["render"].as_str().unwrap().contains("not rounded"));
    for metric in [
        "psnr_db",
        "ssim",
        "psnr_per_channel",
        "psnr_per_channel_unclamped",
        "ssim_gaussian_zero_padded",
    ] {
        assert!(c["metrics"][metric].is_string(), "{metric}: {c}");
    }
    assert!(
        c["metrics"]["ssim"].as_str().unwrap().contains("11 px"),
        "{c}"
    );
    // no weights here: said, with the command that gets them
    let lpips = c["lpips"].as_array().unwrap();
    assert_eq!(
        (lpips.len(), &lpips[0]["net"], &lpips[1]["net"]),
        (2, &json!("alex"), &json!("vgg"))
    );
    assert!(
        lpips[0]["absent"]
            .as_str()
            .unwrap()
            .contains(if cfg!(feature = "nets") {
                "weights lpips-alex are not installed"
            } else {
                "built without networks"
            }),
        "{c}"
    );
    assert!(
        lpips[0]["definition"].as_str().unwrap().contains("2 x - 1") && lpips[0]["score"].is_null()
    );
    let poses = &c["poses"];
    assert_eq!(
        (&poses["treatment"], &poses["geometry_saw_held_out"]),
        (&json!("given"), &json!(true))
    );
    assert_eq!(poses["refinement_of_protocol"]["steps"], 1000);
    assert!(
        poses["words"]
            .as_str()
            .unwrap()
            .contains("was not done here"),
        "{poses}"
    );
    assert_eq!(c["headline"]["name"], "psnr_db");
    let number = |v: &Value| v.as_f64().unwrap();
    assert_eq!(
        number(&c["headline"]["mean"]),
        number(&report["mean"]["psnr_db"])
    );
    let (held_out, training): (Vec<_>, Vec<_>) = whole
        .frames
        .iter()
        .enumerate()
        .partition(|(i, _)| i % 8 == 4);
    let views = held_out.into_iter().map(|(_, frame)| frame.rgb.clone());
    let trivial = mean_image_psnr_db(
        training.into_iter().map(|(_, frame)| frame),
        views,
        usize::MAX,
    );
    let psnr = number(&report["mean"]["psnr_db"]);
    assert!(
        psnr > trivial + 3.0,
        "{psnr} dB, the mean image {trivial} dB"
    );
    // a mean of logarithms is never below that of the mean
    let others = &report["mean_others"];
    assert!(
        number(&others["psnr_per_channel"]["mean"]) >= number(&report["mean"]["psnr_db"]) - 1e-9
    );
    assert_eq!(dir.json("run/eval.json")["choices"], report["choices"]);

    let refined = dir.succeed("eval run --data part --protocol rodygs --refine-poses --json");
    let refined = refined.result();
    let poses = &refined["choices"]["poses"];
    assert_eq!(
        (
            &poses["treatment"],
            poses["moved"].as_array().unwrap().len()
        ),
        (&json!("refined"), 3)
    );
    assert_eq!(
        number(&poses["mean_unrefined"]["psnr_db"]),
        number(&report["mean"]["psnr_db"])
    );
    assert!(
        poses["moved"]
            .as_array()
            .unwrap()
            .iter()
            .all(|m| number(&m["mse"][1]) < number(&m["mse"][0])),
        "{poses}"
    );

    // without a protocol everything is as before
    let plain = dir.succeed("eval run --data part --json").result();
    assert!(plain["choices"].is_null() && plain["mean"]["psnr_db"].is_number());

    write_capture(&dir.path("views"), true);
    for (line, code, words) in [
        (
            "eval run --data part --protocol instant4d",
            65,
            &["rodygs", "minute4d split"][..],
        ),
        ("eval run --data part --protocol dycheck", 65, &["rodygs"]),
        (
            "eval run --data part --protocol holdout --refine-poses",
            2,
            &["does not refine"],
        ),
        (
            "eval run --data views --protocol davis",
            65,
            &["no split.json"],
        ),
        (
            "split views --protocol nvidia -o x",
            2,
            &["nothing to split"],
        ),
        (
            "split views --protocol rodygs -o views",
            73,
            &["is an input of this command"],
        ),
    ] {
        dir.refused(line, code, words);
    }
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
