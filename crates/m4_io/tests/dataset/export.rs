//! Captures for other tools, read back.

use crate::common::{Stop, says};
use m4_core::nalgebra::{Quaternion, UnitQuaternion, Vector3};
use m4_core::{Capture, CaptureFrame, CompactMask, Silent, Tracks};
use m4_io::dataset::{colmap, nerfstudio};
use m4_io::image::{read_depth, read_mask, read_rgb};
use m4_testkit::BoxScene;

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
            mask: Some(CompactMask::from_fn(SIZE[0], SIZE[1], |x, y| mask[(x, y)] != 0)),
            motion: None,
            instances: None,
            camera_index: None,
        }
    });
    let tracks = Tracks::new(n, 2, vec![[0.5, 0.25, 3.0]; 2 * n], vec![true; 2 * n]).unwrap();
    let capture =
        Capture { frames: frames.collect(), time_frames: n, duration_s: Some(1.0), metric: true, tracks: Some(tracks) };
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
    assert_eq!((lens.model.as_str(), lens.width, lens.height), ("PINHOLE", 64, 48));
    assert_eq!(lens.parameters, [k.fx, k.fy, k.cx, k.cy]);
    for (i, image) in tables.images.iter().enumerate() {
        let [w, x, y, z] = image.rotation;
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix();
        let w2c = capture.frames[i].camera.w2c();
        assert!((rotation.matrix() - w2c.rotation).amax() < 1e-9);
        assert_eq!(Vector3::from(image.translation), w2c.translation);
        assert_eq!(read_rgb(&out.join("images").join(&image.name)).unwrap(), capture.frames[i].rgb);
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
    assert_eq!(size("points3D.bin"), 8 + points.len() * (8 + 24 + 3 + 8 + 8));
    for p in &points {
        // the wall and the pillar
        let off =
            (0..2).map(|body| world.surface_distance(body, &p.position.into(), 0).abs()).fold(f64::INFINITY, f64::min);
        assert!(off < 1e-5, "{p:?} lies {off} from the static surfaces");
    }
}

#[test]
fn nerfstudio_export_has_opengl_axes_millimetres_and_static_masks() {
    let (_, capture) = capture_of(4);
    let (_, mut test) = capture_of(4);
    test.frames.truncate(2);
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("ns");
    nerfstudio::write(&out, &capture, Some(&test), &Silent).unwrap();
    let list: serde_json::Value = serde_json::from_slice(&std::fs::read(out.join("transforms.json")).unwrap()).unwrap();
    assert_eq!(list["frames"].as_array().unwrap().len(), 6);
    assert_eq!(list["train_filenames"].as_array().unwrap().len(), 4);
    assert_eq!(list["test_filenames"][1], "images/test_00001.png");
    assert_eq!(list["depth_unit_scale_factor"], 0.001);
    // the second and third column of a pose are turned, the first and the place stay
    let own = capture.frames[1].camera.c2w.matrix();
    for i in 0..3 {
        for (j, sign) in [1.0, -1.0, -1.0, 1.0].into_iter().enumerate() {
            let found = list["frames"][1]["transform_matrix"][i][j].as_f64().unwrap();
            assert!((found - sign * own[(i, j)]).abs() < 1e-12);
        }
    }
    let depth = read_depth(&out.join("depths/00002.png"), 0.001).unwrap();
    let own = capture.frames[2].depth.as_ref().unwrap();
    assert!((depth.at(30, 20) - own.at(30, 20)).abs() < 6e-4 && own.at(30, 20) > 0.5);
    let mask = read_mask(&out.join("masks/00002.png")).unwrap();
    let own = capture.frames[2].mask.as_ref().unwrap();
    let (x, y) = own.set_pixels().next().unwrap();
    assert!(!mask.at(x, y) && mask.count() + own.count() == SIZE[0] * SIZE[1]);
    let ply = std::fs::read(out.join("points.ply")).unwrap();
    let header = String::from_utf8_lossy(&ply[..ply.len().min(300)]).into_owned();
    let count: usize = header.split("element vertex ").nth(1).unwrap().lines().next().unwrap().parse().unwrap();
    let start = header.find("end_header\n").unwrap() + "end_header\n".len();
    assert_eq!(ply.len() - start, 15 * count);
}

#[test]
fn captures_without_depth_have_no_points() {
    let (_, mut capture) = capture_of(3);
    capture.frames.iter_mut().for_each(|f| f.depth = None);
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("ns");
    nerfstudio::write(&out, &capture, None, &Silent).unwrap();
    let list = std::fs::read_to_string(out.join("transforms.json")).unwrap();
    assert!(!list.contains("ply_file_path") && !list.contains("depth_file_path"), "{list}");
    assert!(list.contains("mask_path") && !out.join("points.ply").exists());
}

#[test]
fn cancelled_or_failed_exports_leave_no_files() {
    let (_, capture) = capture_of(3);
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    assert!(nerfstudio::write(&out, &capture, None, &Stop).unwrap_err().to_string().contains("stopped"));
    assert!(colmap::write(&out, &capture, &Stop).is_err());
    let mut broken = capture.clone();
    broken.frames[1].camera.c2w.rotation[(0, 0)] = f64::NAN;
    says(&nerfstudio::write(&out, &broken, None, &Silent).unwrap_err(), &["frame 1"]);
    let mut late = capture.clone();
    late.frames[2].t = 9.0;
    says(&nerfstudio::write(&out, &late, None, &Silent).unwrap_err(), &["frame 2", "t = 9"]);
    let mut hollow = capture.clone();
    hollow.frames[0].mask = Some(CompactMask::from_fn(0, 0, |_, _| true));
    says(&colmap::write(&out, &hollow, &Silent).unwrap_err(), &["no pixels"]);
    let empty = Capture { frames: Vec::new(), ..capture };
    let message = colmap::write(&out, &empty, &Silent).unwrap_err();
    assert!(message.to_string().contains("no frames"));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}
