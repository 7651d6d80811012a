//! Generated clips of a textured room as folders of images, and data sets in their published
//! layouts.

use super::capture;
use m4_core::nalgebra::{Vector3, Vector6};
use m4_core::{Camera, Capture, CaptureFrame, Intrinsics, Plane, RgbImage, Se3, exp_so3};
use m4_io::image::{write_mask, write_rgb};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use std::sync::LazyLock;

pub const SIZE: (usize, usize) = (160, 120);
pub const FOCAL_PX: f64 = 150.0;

/// Direction, phase and height of a wave.
type Wave = ([f64; 2], f64, f64);

/// How much the walls differ between red, green and blue.
const SHIFTS: [f64; 3] = [0.0, 0.3, 0.6];

/// The brightness of the two boxes and of the back wall, by colour: waves of many lengths, none of
/// which repeats over the image.
static WALLS: LazyLock<[[[Wave; 9]; 3]; 3]> =
    LazyLock::new(|| [1.0, 2.0, 3.0].map(|wall| SHIFTS.map(|shift| waves(wall + shift))));

fn waves(wall: f64) -> [Wave; 9] {
    std::array::from_fn(|k| {
        let turn = 2.4 * k as f64 + wall;
        let frequency = 2.0 * 1.35_f64.powi(k as i32);
        (
            [turn.cos() * frequency, turn.sin() * frequency],
            1.7 * k as f64 * wall,
            1.0 / 1.1_f64.powi(k as i32),
        )
    })
}

/// z-depth of what pixel `(u, v)` of `camera` sees: a back wall at 6 and two boxes before it.
pub fn see(camera: &Camera, u: f64, v: f64) -> ([u8; 3], f64) {
    let centre = camera.centre();
    let ray = camera.unproject(u, v, 1.0) - centre;
    let walls = [(3.0, -1.6, -0.2), (4.0, 0.3, 1.6)];
    let hit = |z: f64| centre + ray * ((z - centre.z) / ray.z);
    for (wall, (z, from, to)) in walls.iter().enumerate() {
        let p = hit(*z);
        if p.x > *from && p.x < *to && p.y > -0.3 {
            return (colour(&p, wall), z - centre.z);
        }
    }
    (colour(&hit(6.0), 2), 6.0 - centre.z)
}

fn colour(p: &Vector3<f64>, wall: usize) -> [u8; 3] {
    [0, 1, 2].map(|channel| {
        let x = p.x + 0.1 * SHIFTS[channel];
        let wave = |(direction, phase, height): &Wave| {
            height * (x * direction[0] + p.y * direction[1] + phase).sin()
        };
        let brightness: f64 = WALLS[wall][channel].iter().map(wave).sum();
        (128.0 + 26.0 * brightness).clamp(0.0, 255.0) as u8
    })
}

/// A camera that moved by `shift` to the right, turned by `turn` radians to the right, with a focal
/// length of `focal_px`.
pub fn camera(shift: f64, turn: f64, focal_px: f64) -> Camera {
    Camera {
        intrinsics: Intrinsics::centred(SIZE.0, SIZE.1, focal_px),
        c2w: Se3 {
            rotation: exp_so3(&Vector3::new(0.0, turn, 0.0)),
            translation: Vector3::new(shift, 0.05 * shift, 0.1 * shift),
        },
    }
}

/// A walk to the right that looks back a little.
pub fn walk(n: usize) -> Vec<Camera> {
    let share = |i: usize| i as f64 / (n.max(2) - 1) as f64;
    (0..n)
        .map(|i| {
            let bob = Vector6::new(
                0.0,
                0.03 * (9.0 * share(i)).sin(),
                0.0,
                0.0,
                0.0,
                0.01 * (7.0 * share(i)).sin(),
            );
            let mut camera = camera(1.2 * share(i) - 0.6, 0.15 * (0.5 - share(i)), FOCAL_PX);
            camera.c2w = camera.c2w.retract(&bob);
            camera
        })
        .collect()
}

pub fn frame_image(camera: &Camera) -> RgbImage {
    Plane::from_fn(camera.intrinsics.width, camera.intrinsics.height, |x, y| {
        see(camera, x as f64, y as f64).0
    })
}

/// Writes images as `00000.png`...
pub fn write(folder: &Path, images: impl IntoIterator<Item = RgbImage>) {
    fs::create_dir_all(folder).unwrap();
    for (i, frame_image) in images.into_iter().enumerate() {
        write_rgb(&folder.join(format!("{i:05}.png")), &frame_image).unwrap();
    }
}

/// Numbers as numpy saves them, `<f4` or `<f8`.
pub fn write_npy(path: &Path, shape: &[usize], values: &[f64], double: bool) {
    let (name, shape) = (
        if double { "<f8" } else { "<f4" },
        format!("{shape:?}").replace(['[', ']'], ""),
    );
    let mut header =
        format!("{{'descr': '{name}', 'fortran_order': False, 'shape': ({shape},), }}");
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
    let orientation: Vec<Vec<f64>> = (0..3)
        .map(|i| (0..3).map(|j| r[(j, i)]).collect())
        .collect();
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

/// A scene as DyCheck publishes it: `n` frames of camera 0 with depth, every fourth moment from
/// camera 1 with a mask of co-visibility.
pub fn write_dycheck(root: &Path, n: usize, with_masks: bool) {
    write_dycheck_of(root, [capture(n, false), capture(n, true)], with_masks);
}

/// The same of training frames and views.
pub fn write_dycheck_of(root: &Path, [train, test]: [Capture; 2], with_masks: bool) {
    for folder in ["camera", "rgb/2x", "depth/2x", "splits", "covisible/2x/val"] {
        fs::create_dir_all(root.join(folder)).unwrap();
    }
    let put = |frame: &CaptureFrame, camera: usize, i: usize| {
        let id = format!("{camera}_{i:05}");
        dycheck_camera(&root.join(format!("camera/{id}.json")), &frame.camera);
        write_rgb(&root.join(format!("rgb/2x/{id}.png")), &frame.rgb).unwrap();
        id
    };
    let mut train_ids = Vec::new();
    for (i, frame) in train.frames.iter().enumerate() {
        let id = put(frame, 0, i);
        let depth = frame.depth.as_ref().unwrap().to_map();
        let values: Vec<f64> = depth.data().iter().map(|&z| f64::from(z)).collect();
        let shape = [depth.height(), depth.width(), 1];
        write_npy(
            &root.join(format!("depth/2x/{id}.npy")),
            &shape,
            &values,
            false,
        );
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
    put(
        "dataset.json",
        &json!({"count": train_ids.len() + val_ids.len()}),
    );
    put(
        "scene.json",
        &json!({"center": [0.0, 0.0, 3.0], "scale": 1.0, "near": 2.0, "far": 6.0}),
    );
    put(
        "extra.json",
        &json!({"factor": 2, "fps": 10, "lookat": [0.0, 0.0, 4.0], "up": [0.0, -1.0, 0.0]}),
    );
}
