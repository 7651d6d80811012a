//! Protocols from outside: frames are split, scenes judged, and the tables of data sets made from folders in their exact layouts.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{
    SIZE, Scratch, capture, clips, mean_image_psnr_db, refused, seen_from, succeed, train, write_capture,
};
use minute4d::Silent;
use minute4d::core::{Camera, Capture, CaptureFrame, Plane};
use minute4d::io::capture::Split;
use minute4d::io::image::{write_mask, write_rgb};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// Numbers as numpy saves them, `<f4` or `<f8`.
fn write_npy(path: &Path, shape: &[usize], values: &[f64], double: bool) {
    let (name, shape) = (
        if double { "<f8" } else { "<f4" },
        format!("{shape:?}").replace(['[', ']'], ""),
    );
    let mut header = format!("{{'descr': '{name}', 'fortran_order': False, 'shape': ({shape},), }}");
    while !(10 + header.len() + 1).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    for v in values {
        if double {
            bytes.extend(v.to_le_bytes());
        } else {
            bytes.extend((*v as f32).to_le_bytes());
        }
    }
    fs::write(path, bytes).unwrap();
}

/// `camera/ID.json` of DyCheck: of images twice as large.
fn dycheck_camera(path: &Path, camera: &Camera) {
    let r = camera.c2w.rotation;
    let orientation: Vec<Vec<f64>> = (0..3).map(|i| (0..3).map(|j| r[(j, i)]).collect()).collect();
    let c = camera.centre();
    let k = &camera.intrinsics;
    let value = json!({
        "orientation": orientation,
        "position": [c.x, c.y, c.z],
        "focal_length": 2.0 * k.fx,
        "principal_point": [2.0 * k.cx, 2.0 * k.cy],
        "image_size": [2 * k.width, 2 * k.height],
        "skew": 0.0,
        "pixel_aspect_ratio": 1.0,
        "radial_distortion": [0.0, 0.0, 0.0],
        "tangential_distortion": [0.0, 0.0],
    });
    fs::write(path, value.to_string()).unwrap();
}

/// A scene as DyCheck publishes it: `n` frames of camera 0 with depth, every fourth moment from camera 1 with a mask of co-visibility.
fn write_dycheck(root: &Path, n: usize, with_masks: bool) {
    write_dycheck_of(root, [capture(n, false), capture(n, true)], with_masks);
}

/// The same of training frames and views.
fn write_dycheck_of(root: &Path, [train, test]: [Capture; 2], with_masks: bool) {
    let n = train.frames.len();
    for folder in ["camera", "rgb/2x", "depth/2x", "splits", "covisible/2x/val"] {
        fs::create_dir_all(root.join(folder)).unwrap();
    }
    let mut meta = serde_json::Map::new();
    let mut put = |frame: &CaptureFrame, camera: usize, i: usize| {
        let id = format!("{camera}_{i:05}");
        dycheck_camera(&root.join(format!("camera/{id}.json")), &frame.camera);
        write_rgb(&root.join(format!("rgb/2x/{id}.png")), &frame.rgb).unwrap();
        meta.insert(
            id.clone(),
            json!({"appearance_id": i, "camera_id": camera, "warp_id": i}),
        );
        id
    };
    let mut train_ids = Vec::new();
    for (i, frame) in train.frames.iter().enumerate() {
        let id = put(frame, 0, i);
        let depth = frame.depth.as_ref().unwrap().to_map();
        let values: Vec<f64> = depth.data().iter().map(|&z| f64::from(z)).collect();
        let shape = [depth.height(), depth.width(), 1];
        write_npy(&root.join(format!("depth/2x/{id}.npy")), &shape, &values, false);
        train_ids.push(id);
    }
    let mut val_ids = Vec::new();
    for (i, frame) in test.frames.iter().enumerate().skip(1).step_by(4) {
        let id = put(frame, 1, i);
        if with_masks {
            let (w, h) = frame.rgb.size();
            let mask = Plane::from_fn(w, h, |x, _| if x < w - 8 { 255 } else { 0 });
            write_mask(&root.join(format!("covisible/2x/val/{id}.png")), &mask).unwrap();
        }
        val_ids.push(id);
    }
    let split = |ids: &[String]| {
        let part = |id: &String, k: usize| id.split('_').nth(k).unwrap().parse::<u32>().unwrap();
        json!({
            "frame_names": ids,
            "camera_ids": ids.iter().map(|id| part(id, 0)).collect::<Vec<_>>(),
            "time_ids": ids.iter().map(|id| part(id, 1)).collect::<Vec<_>>(),
        })
    };
    let put = |name: &str, value: &Value| fs::write(root.join(name), value.to_string()).unwrap();
    put("splits/train.json", &split(&train_ids));
    put("splits/val.json", &split(&val_ids));
    let ids: Vec<&String> = train_ids.iter().chain(&val_ids).collect();
    let dataset =
        json!({"count": ids.len(), "num_exemplars": n, "ids": ids, "train_ids": train_ids, "val_ids": val_ids});
    put("dataset.json", &dataset);
    put("metadata.json", &Value::Object(meta));
    put(
        "scene.json",
        &json!({"center": [0.0, 0.0, 3.0], "scale": 1.0, "near": 2.0, "far": 6.0}),
    );
    put(
        "extra.json",
        &json!({"factor": 2, "fps": 10, "lookat": [0.0, 0.0, 4.0], "up": [0.0, -1.0, 0.0]}),
    );
}

/// A scene in the layout of RoDynRF's bundle: camera `i` took image `i`, camera 0 is judged at all moments.
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
        write_npy(&root.join(format!("disp/{i:03}.npy")), &shape, &disparity, false);
        let truth = seen_from(&train.frames[0].camera, i, n);
        write_rgb(&root.join(format!("gt/v000_t{i:03}.png")), &truth).unwrap();
    }
    write_npy(&root.join("poses_bounds.npy"), &[n, 17], &poses, true);
}

#[test]
fn eval_by_protocol_reports_every_choice() {
    let dir = Scratch::new();
    let whole: Capture = capture(24, false);
    minute4d::io::capture::write(&dir.path("whole"), &whole, Split::Train, &Silent).unwrap();
    let (data, out) = (dir.at("part"), dir.at("run"));
    let record = succeed(&["split", &dir.at("whole"), "--protocol", "rodygs", "-o", &data, "--json"]).result();
    assert_eq!(record["held_out"], json!([4, 12, 20]));
    assert_eq!(train(&data, &out, "60", &[]).code, 0);

    let by = |protocol: &str, more: &[&str]| {
        let args = ["eval", &out, "--data", &data, "--protocol", protocol, "--json"];
        succeed(&args.iter().chain(more).copied().collect::<Vec<_>>()).result()
    };
    let report = by("rodygs", &[]);
    let c = &report["choices"];
    assert_eq!(
        (&c["protocol"], &c["task"]),
        (&json!("rodygs"), &json!("held_out_frames"))
    );
    assert_eq!(c["frames"]["rule"], json!({"rule": "every", "every": 8, "offset": 4}));
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
    assert!(c["metrics"]["ssim"].as_str().unwrap().contains("11 px"), "{c}");
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
                "minute4d weights fetch lpips-alex"
            } else {
                minute4d::BUILD_FULL
            }),
        "{c}"
    );
    assert!(lpips[0]["definition"].as_str().unwrap().contains("2 x - 1") && lpips[0]["score"].is_null());
    let poses = &c["poses"];
    assert_eq!(
        (&poses["treatment"], &poses["geometry_saw_held_out"]),
        (&json!("given"), &json!(true))
    );
    assert_eq!(poses["refinement_of_protocol"]["steps"], 1000);
    assert!(
        poses["words"].as_str().unwrap().contains("was not done here"),
        "{poses}"
    );
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
    assert_eq!(read_json(&dir.path("run/eval.json"))["choices"], report["choices"]);

    let refined = by("rodygs", &["--refine-poses"]);
    let poses = &refined["choices"]["poses"];
    assert_eq!(
        (&poses["treatment"], poses["moved"].as_array().unwrap().len()),
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
    let plain = succeed(&["eval", &out, "--data", &data, "--json"]).result();
    assert!(plain["choices"].is_null() && plain["mean"]["psnr_db"].is_number());

    let refuse = |protocol: &str, more: &[&str], code: i32, words: &[&str]| {
        let args = ["eval", &out, "--data", &data, "--protocol", protocol];
        refused(&args.iter().chain(more).copied().collect::<Vec<_>>(), code, words);
    };
    refuse("instant4d", &[], 65, &["rodygs", "minute4d split"]);
    refuse("dycheck", &[], 65, &["rodygs"]);
    refuse("holdout", &["--refine-poses"], 2, &["does not refine"]);
    write_capture(&dir.path("views"), true);
    let views = dir.at("views");
    refused(
        &["eval", &out, "--data", &views, "--protocol", "davis"],
        65,
        &["no split.json"],
    );
    refused(
        &["split", &views, "--protocol", "nvidia", "-o", &dir.at("x")],
        2,
        &["nothing to split"],
    );
    refused(
        &["split", &views, "--protocol", "rodygs", "-o", &views],
        2,
        &["into itself"],
    );
}

#[test]
fn dycheck_layout_is_reproduced() {
    let dir = Scratch::new();
    for (scene, masks) in [("apple", true), ("teddy", true)] {
        write_dycheck(&dir.path(&format!("data/iphone/{scene}")), 14, masks);
    }
    let (data, out) = (dir.at("data"), dir.at("out"));
    let args = [
        "reproduce",
        "dycheck",
        "--data",
        &data,
        "-o",
        &out,
        "--iterations",
        "40",
        "--json",
    ];
    let first = succeed(&args);
    let report = first.result();
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
        (&held_out["scenes_of_published"], &novel["scenes_of_published"]),
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
    let eval = read_json(&dir.path("out/dycheck/apple/run/eval.json"));
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
        assert!(svg.contains("this run") && svg.matches("<rect").count() > 10, "{svg}");
    }

    // nothing is made again
    let made = |scene: &str| {
        fs::metadata(dir.path(&format!("out/instant4d/{scene}/run/eval.json")))
            .unwrap()
            .modified()
            .unwrap()
    };
    let (apple, teddy) = (made("apple"), made("teddy"));
    let again = succeed(&args);
    assert_eq!(again.result()["tables"], report["tables"]);
    assert_eq!((made("apple"), made("teddy")), (apple, teddy));
    assert!(!again.stdout.contains("\"train\""), "{}", again.stdout);
    // but what has lost its scores is
    fs::remove_file(dir.path("out/instant4d/teddy/run/eval.json")).unwrap();
    assert_eq!(succeed(&args).result()["tables"][1], report["tables"][1]);
    assert!(made("apple") == apple && made("teddy") > teddy);
}

#[test]
fn nvidia_layout_is_reproduced() {
    let dir = Scratch::new();
    write_nvidia(&dir.path("data/Balloon1"), 12);
    let (data, out) = (dir.at("data"), dir.at("out"));
    let args = [
        "reproduce",
        "nvidia",
        "--data",
        &data,
        "-o",
        &out,
        "--iterations",
        "60",
        "--json",
    ];
    let report = succeed(&args).result();
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
    let eval = read_json(&dir.path("out/nvidia/Balloon1/run/eval.json"));
    let frames = &eval["choices"]["frames"];
    assert_eq!(frames["also_training"].as_array().unwrap().len(), 1, "{frames}");
    assert_eq!(frames["mean_without"]["frames"], 11);
    let table = fs::read_to_string(dir.path("out/reproduce.md")).unwrap();
    assert!(
        table.contains("1218") && table.contains("24.73") && !table.contains("25.77"),
        "{table}"
    );

    refused(
        &["reproduce", "davis", "--data", &data, "-o", &out],
        66,
        &["breakdance-flare", "davischallenge.org"],
    );
    refused(
        &[
            "reproduce",
            "nvidia",
            "--data",
            &data,
            "-o",
            &out,
            "--protocols",
            "dycheck",
        ],
        2,
        &["its protocols are nvidia"],
    );
    fs::remove_dir_all(dir.path("data/Balloon1/gt")).unwrap();
    refused(&args[..args.len() - 1], 65, &["no held-out views"]);
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
    let views: Vec<Camera> = (0..24)
        .map(|i| clips::camera(0.02 * f64::from(i), 0.1, clips::FOCAL_PX))
        .collect();
    let captures = [room(&clips::walk(24)), room(&views)];
    write_dycheck_of(&dir.path("data/spin"), captures, true);
    let (data, out) = (dir.at("data"), dir.at("out"));
    let args = [
        "reproduce",
        "dycheck",
        "--data",
        &data,
        "-o",
        &out,
        "--scenes",
        "spin",
        "--json",
        "--iterations",
        "15",
    ];
    let with = |more: &[&str]| succeed(&[&args[..], more].concat()).result();
    let report = with(&["--protocols", "instant4d", "--ablations"]);
    let rows = report["tables"][0]["ablations"][0]["report"]["rows"]
        .as_array()
        .unwrap();
    assert_eq!(rows.len(), 4, "{report}");
    for row in rows {
        // depth without a map of motion: there is nothing that segmentation could have made of it
        assert_eq!(row["skipped"].is_string(), row["row"] == "no-seg", "{row}");
        assert_eq!(row["psnr_db"].is_number(), row["row"] != "no-seg", "{row}");
    }
    let table = fs::read_to_string(dir.path("out/reproduce.md")).unwrap();
    for words in ["#### spin", "without density control", "1.17 dB"] {
        assert!(table.contains(words), "{words} is not in {table}");
    }
    // poses of the images alone: the views of other cameras are placed by aligning
    // ... and what was made with the data set's is computed again
    let report = with(&["--protocols", "instant4d,dycheck", "--geometry", "own", "--ablations"]);
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

#[test]
fn import_copies_published_masks() {
    let dir = Scratch::new();
    write_dycheck(&dir.path("apple"), 14, true);
    let (source, out) = (dir.at("apple"), dir.at("capture"));
    succeed(&["import", &source, "-o", &out, "--no-check"]);
    let masks = || fs::read_dir(dir.path("capture/covisible")).unwrap().count();
    assert_eq!(masks(), 4);
    // what an earlier import left does not stay
    fs::remove_dir_all(dir.path("apple/covisible")).unwrap();
    succeed(&["import", &source, "-o", &out, "--no-check", "--force"]);
    assert!(!dir.path("capture/covisible").exists());
}
