//! Captures for other tools, read back.

use crate::common::says;
use m4_core::nalgebra::{Quaternion, UnitQuaternion, Vector3};
use m4_core::{Capture, CaptureFrame, CompactMask, Silent, Tracks};
use m4_io::dataset::colmap;
use m4_io::image::{read_mask, read_rgb};
use m4_testkit::{BoxScene, StopAtPoll};

const SIZE: [usize; 2] = [64, 48];

fn capture_of(n: usize) -> (BoxScene, Capture) {
    let world = BoxScene::new(SIZE[0], SIZE[1], n);
    let frames = (0..n).map(|t| {
        let mask = world.mask(t);
        CaptureFrame {
            name: format!("{t}.png"),
            camera: world.cameras[t],
            t: t as f64,
            rgb: world.rgb(t),
            depth: Some(world.depth(t).into()),
            mask: Some(CompactMask::from_fn(SIZE[0], SIZE[1], |x, y| {
                mask[(x, y)] != 0
            })),
            motion: None,
            instances: None,
            camera_index: None,
            distance_sigma: None,
        }
    });
    let tracks = Tracks::new(n, 2, vec![[0.5, 0.25, 3.0]; 2 * n], vec![true; 2 * n]).unwrap();
    let capture = Capture {
        frames: frames.collect(),
        time_frames: n,
        duration_s: Some(1.0),
        metric: true,
        tracks: Some(tracks),
    };
    (world, capture)
}

#[test]
fn colmap_export_has_cameras_and_static_points() {
    let (world, capture) = capture_of(5);
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("colmap");
    let written = colmap::write(&out, &capture, &Silent).unwrap();
    assert!(written.bytes > 1000);
    let model = out.join("sparse/0");
    let tables = colmap::read_tables(&model).unwrap();
    assert_eq!((tables.images.len(), tables.cameras.len()), (5, 1));
    let k = capture.frames[0].camera.intrinsics;
    let lens = &tables.cameras[0];
    assert_eq!(
        (lens.model.as_str(), lens.width, lens.height),
        ("PINHOLE", 64, 48)
    );
    assert_eq!(lens.parameters, [k.fx, k.fy, k.cx, k.cy]);
    for (i, image) in tables.images.iter().enumerate() {
        let [w, x, y, z] = image.rotation;
        let rotation =
            UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix();
        let w2c = capture.frames[i].camera.w2c();
        assert!((rotation.matrix() - w2c.rotation).amax() < 1e-9);
        assert_eq!(Vector3::from(image.translation), w2c.translation);
        assert_eq!(
            read_rgb(&out.join("images").join(&image.name)).unwrap(),
            capture.frames[i].rgb
        );
        let mask = read_mask(&out.join(format!("masks/{}.png", image.name))).unwrap();
        let own = capture.frames[i].mask.as_ref().unwrap();
        assert!(own.count() > 20, "something moves in frame {i}");
        assert_eq!(mask.count() + own.count(), SIZE[0] * SIZE[1]);
    }
    // every point lies on a static surface
    let points = colmap::read_points(&model).unwrap();
    assert!(points.len() > 1000, "{}", points.len());
    // layouts of the files: counts of 8 bytes, then rows
    let size = |name: &str| std::fs::metadata(model.join(name)).unwrap().len() as usize;
    assert_eq!(size("cameras.bin"), 8 + 4 + 4 + 8 + 8 + 4 * 8);
    assert_eq!(size("images.bin"), 8 + 5 * (4 + 7 * 8 + 4 + 10 + 8));
    assert_eq!(
        size("points3D.bin"),
        8 + points.len() * (8 + 24 + 3 + 8 + 8)
    );
    for p in &points {
        // the wall and the pillar
        let off = (0..2)
            .map(|body| world.surface_distance(body, &p.position.into(), 0).abs())
            .fold(f64::INFINITY, f64::min);
        assert!(off < 1e-5, "{p:?} lies {off} from the static surfaces");
    }
}

#[test]
fn cancelled_or_failed_exports_leave_no_files() {
    let (_, capture) = capture_of(3);
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    assert!(
        colmap::write(&out, &capture, &StopAtPoll::after(0))
            .unwrap_err()
            .to_string()
            .contains("stopped")
    );
    let mut broken = capture.clone();
    broken.frames[1].camera.c2w.rotation[(0, 0)] = f64::NAN;
    says(
        &colmap::write(&out, &broken, &Silent).unwrap_err(),
        &["frame 1"],
    );
    let mut late = capture.clone();
    late.frames[2].t = 9.0;
    says(
        &colmap::write(&out, &late, &Silent).unwrap_err(),
        &["frame 2", "t = 9"],
    );
    let mut hollow = capture.clone();
    hollow.frames[0].mask = Some(CompactMask::from_fn(0, 0, |_, _| true));
    says(
        &colmap::write(&out, &hollow, &Silent).unwrap_err(),
        &["no pixels"],
    );
    let empty = Capture {
        frames: Vec::new(),
        ..capture
    };
    let message = colmap::write(&out, &empty, &Silent).unwrap_err();
    assert!(message.to_string().contains("no frames"));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}
