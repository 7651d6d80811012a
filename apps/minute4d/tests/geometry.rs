//! Geometry from outside. What the user gives replaces what would be computed, and what does not
//! fit is refused by name; clips that geometry cannot make much of end in a capture with a warning,
//! or in a refusal that says what to do (docs/geometry.md has the table).

use crate::common::clips::{self, FOCAL_PX, SIZE, camera, frame_image, see, walk};
#[cfg(feature = "nets")]
use crate::common::text;
use crate::common::{Ended, Scratch, read_capture};
use m4_core::{
    Camera, Capture, CaptureFrame, CounterRng, DepthMap, Mask, Plane, RgbImage, Sim3, log_so3,
};
use m4_eval::geometry::placement;
use m4_io::capture::{self, Split};
use m4_io::image::{read_depth, read_mask, write_depth, write_mask};
use minute4d::Silent;
use serde_json::{Value, json};
use std::fs;

const FRAMES: usize = 12;

/// Depth in metres, as the camera sees it.
fn depth(camera: &Camera) -> DepthMap {
    Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
        see(camera, x as f64, y as f64).1 as f32
    })
}

/// Writes a clip with its ground truth: `clip/`, `depth/`, `masks/`, `poses.json`.
fn write_clip() -> (Scratch, Vec<Camera>) {
    let dir = Scratch::new();
    let cameras = walk(FRAMES);
    clips::write(&dir.path("clip"), cameras.iter().map(frame_image));
    for folder in ["depth", "masks"] {
        fs::create_dir(dir.path(folder)).unwrap();
    }
    for (i, camera) in cameras.iter().enumerate() {
        write_depth(
            &dir.path(&format!("depth/{i:05}.png")),
            &depth(camera),
            0.001,
        )
        .unwrap();
        let mask: Mask = Plane::from_fn(SIZE.0, SIZE.1, |x, _| if x < 40 { 255 } else { 0 });
        write_mask(&dir.path(&format!("masks/{i:05}.png")), &mask).unwrap();
    }
    let frames = cameras.iter().enumerate().map(|(i, camera)| CaptureFrame {
        name: format!("{i:05}"),
        camera: *camera,
        t: i as f64,
        rgb: frame_image(camera),
        depth: None,
        mask: None,
        motion: None,
        instances: None,
        camera_index: None,
        distance_sigma: None,
    });
    let truth = Capture {
        frames: frames.collect(),
        time_frames: FRAMES,
        duration_s: Some(1.1),
        metric: true,
        tracks: None,
    };
    capture::write(&dir.path("truth"), &truth, Split::Train, &Silent).unwrap();
    fs::copy(
        dir.path("truth/transforms_train.json"),
        dir.path("poses.json"),
    )
    .unwrap();
    (dir, cameras)
}

const GEOMETRY: &str = "geometry clip -o out --force";

/// `geometry` of the clip with these options: the record and the capture.
fn geometry(dir: &Scratch, options: &str) -> (Value, Capture) {
    let ended = dir.succeed(&format!("{GEOMETRY} --json {options}"));
    let capture = read_capture(&dir.path("out"), Split::Train);
    (ended.result()["record"].clone(), capture)
}

/// Mean relative error of the depth of a capture, in its own unit, without any alignment.
fn depth_error(capture: &Capture, cameras: &[Camera]) -> f64 {
    let mut sum = 0.0;
    for (frame, camera) in capture.frames.iter().zip(cameras) {
        let (estimate, truth) = (frame.depth.as_ref().unwrap().to_map(), depth(camera));
        let errors = estimate
            .data()
            .iter()
            .zip(truth.data())
            .map(|(a, b)| f64::from((a - b).abs() / b));
        sum += errors.sum::<f64>() / truth.data().len() as f64;
    }
    sum / capture.frames.len() as f64
}

fn poses_differ(capture: &Capture, cameras: &[Camera]) -> f64 {
    let both = capture.frames.iter().zip(cameras);
    both.map(|(f, c)| (f.camera.c2w.matrix() - c.c2w.matrix()).norm())
        .fold(0.0, f64::max)
}

#[test]
fn given_poses_are_used_and_set_the_unit_of_depth() {
    let (dir, cameras) = write_clip();
    let (record, capture) = geometry(&dir, "--poses poses.json");
    assert_eq!(record["found"]["camera_motion"], "parallax", "{record}");
    assert_eq!(record["found"]["confidence"]["focal"], "given", "{record}");
    assert!(poses_differ(&capture, &cameras) < 1e-6);
    let error = depth_error(&capture, &cameras);
    assert!(error < 0.08, "{error}");
}

#[test]
fn poses_of_another_clip_are_rejected() {
    let (dir, _) = write_clip();
    let mut list: Value =
        serde_json::from_slice(&fs::read(dir.path("poses.json")).unwrap()).unwrap();
    list["frames"].as_array_mut().unwrap().truncate(10);
    dir.write("short.json", list.to_string());
    for (poses, code, words) in [
        (
            "short.json",
            65,
            &["short.json", "10 poses", "12 frames"][..],
        ),
        ("none.json", 66, &["none.json", "given as poses"]),
    ] {
        dir.refused(&format!("{GEOMETRY} --poses {poses}"), code, words);
    }
}

#[test]
fn given_intrinsics_are_used_with_their_principal_point() {
    let (dir, _) = write_clip();
    // Images cut off at the left: the principal point is no longer in the middle.
    let cut = 24;
    fs::remove_dir_all(dir.path("clip")).unwrap();
    let crop = |c: &Camera| {
        let whole = frame_image(c);
        Plane::from_fn(SIZE.0 - cut, SIZE.1, |x, y| whole[(x + cut, y)])
    };
    clips::write(&dir.path("clip"), walk(FRAMES).iter().map(crop));
    let cx = SIZE.0 as f64 / 2.0 - cut as f64;
    let lens =
        json!({"fl_x": FOCAL_PX, "cx": cx, "cy": SIZE.1 / 2, "w": SIZE.0 - cut, "h": SIZE.1});
    dir.write("lens.json", lens.to_string());
    let (record, capture) = geometry(&dir, "--intrinsics lens.json");
    let k = capture.frames[0].camera.intrinsics;
    assert!(
        (k.cx - cx).abs() < 1e-9 && (k.fx - FOCAL_PX).abs() < 1e-9,
        "{k:?}"
    );
    let with = record["found"]["residual_px"].as_f64().unwrap();
    assert!(with < 0.3, "{with}");
    assert_eq!(record["found"]["given"], json!(["intrinsics"]));
    // Where the middle is taken for it, the way is bent: poses of the true lens are nearer to the
    // truth.
    let turn = |clip: &Capture| {
        let (a, b) = (
            clip.frames[0].camera.c2w,
            clip.frames[FRAMES - 1].camera.c2w,
        );
        log_so3(&a.rotation.tr_mul(&b.rotation))
    };
    let cameras = walk(FRAMES);
    let truth = log_so3(
        &cameras[0]
            .c2w
            .rotation
            .tr_mul(&cameras[FRAMES - 1].c2w.rotation),
    );
    assert!(
        (turn(&capture) - truth).norm() < 0.01,
        "{} {}",
        turn(&capture),
        truth
    );
    for (lens, code, words) in [
        ("150,150,200,60", 65, "outside the frames"),
        ("150,150,300,60", 65, "the principal point cx is 300"),
        ("150,150", 65, "2 numbers"),
        ("nothing.json", 66, "nothing.json"),
    ] {
        dir.refused(&format!("{GEOMETRY} --intrinsics {lens}"), code, &[words]);
    }
}

/// Writes the clip `bent/` of an action camera: 120 degrees from corner to corner, equisolid, so
/// that a ray at an angle `a` arrives `2 * 100 sin(a / 2)` pixels from the centre.
fn write_bent_clip() -> (Scratch, Vec<Camera>) {
    let (dir, mut cameras) = (Scratch::new(), walk(2 * FRAMES));
    let (cx, cy) = (SIZE.0 as f64 / 2.0, SIZE.1 as f64 / 2.0);
    for camera in &mut cameras {
        (camera.intrinsics.fx, camera.intrinsics.fy) = (100.0, 100.0);
    }
    let image = |camera: &Camera| {
        Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            let (dx, dy) = (x as f64 + 0.5 - cx, y as f64 + 0.5 - cy);
            let r = dx.hypot(dy);
            let stretch = 100.0 * (2.0 * (r / 200.0).asin()).tan() / r;
            see(camera, cx + dx * stretch - 0.5, cy + dy * stretch - 0.5).0
        })
    };
    clips::write(&dir.path("bent"), cameras.iter().map(image));
    (dir, cameras)
}

/// Root mean square distance of camera centres after alignment over the length of the path.
fn path_error(capture: &Capture, cameras: &[Camera]) -> f64 {
    let centres: Vec<_> = capture.frames.iter().map(|f| f.camera.centre()).collect();
    let truth: Vec<_> = cameras.iter().map(Camera::centre).collect();
    let world = Sim3::umeyama(&centres, &truth).unwrap();
    let pairs = centres.iter().zip(&truth);
    let squared: f64 = pairs
        .map(|(a, b)| (world.transform(a) - b).norm_squared())
        .sum();
    let length: f64 = truth.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    (squared / truth.len() as f64).sqrt() / length
}

#[test]
fn frames_of_an_action_camera_are_straightened() {
    let (dir, cameras) = write_bent_clip();
    let ended = dir.succeed("geometry bent -o out --json");
    assert!(
        ended.stderr.contains("the lens bends straight lines"),
        "{}",
        ended.stderr
    );
    let result = ended.result();
    let summary = &result["record"]["found"];
    let focal_px = summary["distortion"]["focal_px"].as_f64().unwrap();
    assert!((focal_px / 100.0 - 1.0).abs() < 0.02, "{summary}");
    let capture = read_capture(&dir.path("out"), Split::Train);
    let error = path_error(&capture, &cameras);
    assert!(error < 0.001, "{error}");

    // The same lens in a file: as OpenCV's fisheye, the series of the sine.
    let lens = json!({"fl_x": 100, "w": SIZE.0, "h": SIZE.1, "camera_model": "OPENCV_FISHEYE",
                      "k1": -1.0 / 24.0, "k2": 1.0 / 1920.0});
    dir.write("lens.json", lens.to_string());
    let ended = dir.succeed("geometry bent -o given --json --lens lens.json");
    let summary = &ended.result()["record"]["found"];
    assert_eq!(summary["distortion"], Value::Null, "{summary}");
    assert!(summary["residual_px"].as_f64().unwrap() < 0.3, "{summary}");
    let capture = read_capture(&dir.path("given"), Split::Train);
    let error = path_error(&capture, &cameras);
    assert!(error < 0.001, "{error}");
}

#[test]
fn given_masks_are_used_unchanged() {
    let (dir, _) = write_clip();
    let (record, _) = geometry(&dir, "--masks masks");
    let share = record["found"]["moving_share"].as_f64().unwrap();
    assert!((share - 0.25).abs() < 0.03, "{record}");
    let actual = read_mask(&dir.path("out/mask/00003.png")).unwrap();
    assert!(actual.at(10, 60) && !actual.at(100, 60));
    let line = format!("{GEOMETRY} --masks masks");
    fs::remove_file(dir.path("masks/00004.png")).unwrap();
    dir.refused(&line, 65, &["masks", "11 masks", "12 frames"]);
    let mask: Mask = Plane::filled(SIZE.1, SIZE.0, 0);
    write_mask(&dir.path("masks/00004.png"), &mask).unwrap();
    dir.refused(&line, 65, &["00004.png", "120 x 160"]);
    dir.write("masks/00004.png", "no image");
    dir.refused(&line, 65, &["00004.png"]);
    dir.refused(
        &format!("{GEOMETRY} --masks none"),
        66,
        &["none", "given as masks"],
    );
}

#[test]
fn given_depth_sets_the_unit() {
    let (dir, cameras) = write_clip();
    // Every other pixel column unknown: what is measured there must have the same unit.
    for i in 0..FRAMES {
        let path = dir.path(&format!("depth/{i:05}.png"));
        let map = read_depth(&path, 0.001).unwrap().to_map();
        let holes = Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
            if (x / 20) % 2 == 0 { map[(x, y)] } else { 0.0 }
        });
        write_depth(&path, &holes, 0.001).unwrap();
    }
    let (record, capture) = geometry(&dir, "--depth depth");
    assert!(capture.metric);
    let error = depth_error(&capture, &cameras);
    assert!(error < 0.08, "{error} {record}");
    // The length of the way, in metres.
    let way = |a: &Camera, b: &Camera| (a.centre() - b.centre()).norm();
    let ours = way(
        &capture.frames[0].camera,
        &capture.frames[FRAMES - 1].camera,
    );
    let truth = way(&cameras[0], &cameras[FRAMES - 1]);
    assert!((ours / truth - 1.0).abs() < 0.05, "{ours} {truth}");

    let line = format!("{GEOMETRY} --depth depth");
    let empty: DepthMap = Plane::filled(SIZE.0, SIZE.1, 0.0);
    for i in 0..FRAMES {
        write_depth(&dir.path(&format!("depth/{i:05}.png")), &empty, 0.001).unwrap();
    }
    dir.refused(&line, 65, &["depth", "0 (unknown) everywhere"]);
    let colour = frame_image(&cameras[0]);
    m4_io::image::write_rgb(&dir.path("depth/00002.png"), &colour).unwrap();
    dir.refused(&line, 65, &["00002.png", "16 bits"]);
}

#[cfg(feature = "nets")]
#[test]
fn segmenter_without_weights_names_the_download_and_auto_falls_back() {
    let (dir, _) = write_clip();
    fs::create_dir(dir.path("weights")).unwrap();
    let store = dir.path("weights");
    let (record, _) = geometry(&dir, "");
    assert_eq!(record["found"]["segmenter"], "none");
    let asked = format!("{GEOMETRY} --segmenter mobilesam");
    let env = [("MINUTE4D_WEIGHTS", text(&store))];
    let words = [
        "mobilesam",
        "minute4d weights fetch mobile-sam",
        "--segmenter none",
    ];
    dir.refused_with(&asked, &env, 66, &words);
    // What lies there and is no checkpoint is refused, asked for or not.
    fs::create_dir(store.join("mobile-sam")).unwrap();
    fs::write(store.join("mobile-sam/mobile_sam.pt"), "no weights").unwrap();
    let words = ["mobile_sam.pt", "MobileSAM", "--segmenter none"];
    dir.refused_with(&asked, &env, 69, &words);
    dir.refused_with(GEOMETRY, &env, 69, &words);
}

#[test]
fn changed_masks_invalidate_the_result() {
    let (dir, _) = write_clip();
    let (first, _) = geometry(&dir, "--masks masks");
    let mask: Mask = Plane::filled(SIZE.0, SIZE.1, 0);
    write_mask(&dir.path("masks/00000.png"), &mask).unwrap();
    let (second, _) = geometry(&dir, "--masks masks");
    assert_ne!(first["key"], second["key"]);
}

fn record_of(dir: &Scratch, images: Vec<RgbImage>) -> Ended {
    clips::write(&dir.path("clip"), images);
    dir.succeed("geometry clip -o out --json")
}

/// The summary of the geometry of these images, and all warnings in one text.
fn summary_of(images: Vec<RgbImage>) -> (Value, String) {
    let ended = record_of(&Scratch::new(), images);
    assert!(!ended.stderr.contains("panicked"), "{}", ended.stderr);
    let record = ended.result()["record"].clone();
    let warnings = record["warnings"].as_array().unwrap().iter();
    let warnings: Vec<&str> = warnings.map(|w| w.as_str().unwrap()).collect();
    (record["found"].clone(), warnings.join("\n"))
}

fn contains(text: &str, words: &[&str]) {
    for word in words {
        assert!(text.contains(word), "{word:?} is not in {text:?}");
    }
}

/// What an honest sensor adds.
fn noisy(image: &RgbImage, frame: u64) -> RgbImage {
    let mut rng = CounterRng::new(5, 0, frame);
    image.map(|rgb| rgb.map(|v| (f64::from(v) + 2.0 * rng.normal()).clamp(0.0, 255.0) as u8))
}

/// Largest errors of the cameras of a capture after the similarity that places them best: of the
/// centre, per cent of the length of the path; of the axes, degrees; of the focal length, per cent.
pub(crate) fn camera_errors(capture: &Capture, truth: &[Camera]) -> [f64; 3] {
    let cameras: Vec<Camera> = capture.frames.iter().map(|frame| frame.camera).collect();
    assert_eq!(cameras.len(), truth.len());
    let sim = placement(&cameras, truth).unwrap();
    let length: f64 = truth
        .windows(2)
        .map(|pair| (pair[1].centre() - pair[0].centre()).norm())
        .sum();
    let errors = cameras.iter().zip(truth).map(|(ours, truth)| {
        let turn = (sim.rotation * ours.c2w.rotation).transpose() * truth.c2w.rotation;
        [
            100.0 * (sim.transform(&ours.centre()) - truth.centre()).norm() / length,
            log_so3(&turn).norm().to_degrees(),
            100.0 * (ours.intrinsics.fx / truth.intrinsics.fx - 1.0).abs(),
        ]
    });
    errors.fold([0.0; 3], |largest, errors| {
        std::array::from_fn(|k| f64::max(largest[k], errors[k]))
    })
}

#[test]
fn translating_camera_is_reconstructed() {
    let (cameras, dir) = (walk(24), Scratch::new());
    let record =
        record_of(&dir, cameras.iter().map(frame_image).collect()).result()["record"].clone();
    let summary = &record["found"];
    assert_eq!(summary["camera_motion"], "parallax", "{record}");
    let capture = read_capture(&dir.path("out"), Split::Train);
    // measured: 0.06 %, 0.07 degrees and 1.9 %
    let errors = camera_errors(&capture, &cameras);
    assert!(
        errors[0] < 0.3 && errors[1] < 0.3 && errors[2] < 4.0,
        "{errors:?}"
    );
    // the same walk without its bobbing is another path
    let mut level = cameras.clone();
    for camera in &mut level {
        let shift = camera.c2w.translation.x;
        camera.c2w = clips::camera(shift, -0.125 * shift, FOCAL_PX).c2w;
    }
    let errors = camera_errors(&capture, &level);
    assert!(errors[0] > 0.6 && errors[1] > 0.3, "{errors:?}");
    let confidence = &summary["confidence"];
    assert!(
        confidence["parallax_deg"].as_f64().unwrap() > 2.0,
        "{confidence}"
    );
    assert!(
        confidence["residual_px"].as_f64().unwrap() < 0.5,
        "{confidence}"
    );
    assert_eq!(summary["frontend"], "classical");
}

#[test]
fn poor_camera_motion_is_reported() {
    let turns = (0..20).map(|i| frame_image(&camera(0.0, 0.02 * f64::from(i) - 0.2, FOCAL_PX)));
    let still = frame_image(&camera(0.0, 0.0, FOCAL_PX));
    for (images, motion, words) in [
        (
            turns.collect(),
            "rotation_only",
            &[
                "the camera rotates",
                "rotations only",
                "geometry is poor",
                "sideways",
            ][..],
        ),
        // a tripod
        (
            (0..12).map(|i| noisy(&still, i)).collect(),
            "static",
            &[
                "appears to be static",
                "geometry is poor",
                m4_core::advice::DEPTH,
            ],
        ),
        (vec![still.clone(); 8], "static", &["appears to be static"]),
    ] {
        let identical = images == vec![still.clone(); 8];
        let (summary, warnings): (Value, String) = summary_of(images);
        assert_eq!(summary["camera_motion"], motion, "{summary}");
        contains(&warnings, words);
        assert!(!identical || summary["moving_share"] == 0.0, "{summary}");
        assert!(
            motion == "static" || summary["confidence"]["grade"] == "poor",
            "{summary}"
        );
    }
}

#[test]
fn zoom_without_translation_is_reported() {
    // The focal length doubles; the camera stays.
    let zoom = (0..16).map(|i| {
        frame_image(&camera(
            0.0,
            0.0,
            FOCAL_PX * 2.0_f64.powf(f64::from(i) / 15.0),
        ))
    });
    let dir = Scratch::new();
    let record = record_of(&dir, zoom.collect()).result()["record"].clone();
    assert_eq!(
        record["found"]["camera_motion"], "rotation_only",
        "{record}"
    );
    assert_eq!(record["found"]["confidence"]["grade"], "poor", "{record}");
    contains(
        &record["warnings"].to_string(),
        &["the lens zooms", "without zoom", "geometry is poor"],
    );
    // Every frame has its own lens.
    let capture = dir.json("out/transforms_train.json");
    let focal = |i: usize| capture["frames"][i]["fl_x"].as_f64().unwrap();
    let ratio = focal(15) / focal(0);
    assert!((ratio / 2.0 - 1.0).abs() < 0.03, "{ratio}");
}

#[test]
fn forward_motion_is_not_a_zoom() {
    let ahead = |i: i32| {
        let mut camera = camera(0.0, 0.0, FOCAL_PX);
        camera.c2w.translation.z = 0.08 * f64::from(i);
        camera
    };
    let (summary, warnings) = summary_of((0..16).map(|i| frame_image(&ahead(i))).collect());
    assert_eq!(summary["camera_motion"], "parallax", "{summary} {warnings}");
    assert!(!warnings.contains("zooms"), "{warnings}");
}

/// A clip that is refused with code 65 and these words, and leaves no capture.
fn refuses(images: Vec<RgbImage>, words: &[&str]) {
    let dir = Scratch::new();
    clips::write(&dir.path("clip"), images);
    dir.refused("geometry clip -o out", 65, words);
    assert!(!dir.path("out/transforms_train.json").exists());
}

#[test]
fn one_frame_and_a_black_clip_are_rejected() {
    refuses(
        vec![frame_image(&camera(0.0, 0.0, FOCAL_PX))],
        &["at least 2"],
    );
    let black: RgbImage = Plane::filled(SIZE.0, SIZE.1, [0; 3]);
    refuses(vec![black; 6], &["only 0 points", "--static-camera"]);
}
