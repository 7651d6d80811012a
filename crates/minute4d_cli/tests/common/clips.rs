//! Generated clips of a textured room, as folders of images.

use minute4d::core::{
    Camera, Intrinsics, Plane, RgbImage, Se3, exp_so3,
    nalgebra::{Vector3, Vector6},
};
use minute4d::io::image::write_rgb;
use std::path::Path;

/// Size of the images.
pub const SIZE: (usize, usize) = (160, 120);
/// Focal length, pixels.
pub const FOCAL_PX: f64 = 150.0;

/// Brightness of a wall: waves of many lengths, none of which repeats over the image.
fn texture(x: f64, y: f64, wall: f64) -> f64 {
    let wave = |k: i32| {
        let turn = 2.4 * f64::from(k) + wall;
        let frequency = 2.0 * 1.35_f64.powi(k);
        let phase = (x * turn.cos() + y * turn.sin()) * frequency;
        (phase + 1.7 * f64::from(k) * wall).sin() / 1.1_f64.powi(k)
    };
    (0..9).map(wave).sum::<f64>()
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
            return (colour(&p, 1.0 + wall as f64), z - centre.z);
        }
    }
    (colour(&hit(6.0), 3.0), 6.0 - centre.z)
}

fn colour(p: &Vector3<f64>, wall: f64) -> [u8; 3] {
    [0.0, 0.3, 0.6].map(|shift| (128.0 + 26.0 * texture(p.x + 0.1 * shift, p.y, wall + shift)).clamp(0.0, 255.0) as u8)
}

/// A camera that moved by `shift` to the right, turned by `turn` radians to the right, with a focal length of `focal_px`.
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
            let bob = Vector6::new(0.0, 0.03 * (9.0 * share(i)).sin(), 0.0, 0.0, 0.0, 0.01 * (7.0 * share(i)).sin());
            let mut camera = camera(1.2 * share(i) - 0.6, 0.15 * (0.5 - share(i)), FOCAL_PX);
            camera.c2w = camera.c2w.retract(&bob);
            camera
        })
        .collect()
}

/// What a camera sees.
pub fn frame_image(camera: &Camera) -> RgbImage {
    Plane::from_fn(camera.intrinsics.width, camera.intrinsics.height, |x, y| see(camera, x as f64, y as f64).0)
}

/// Writes images as `00000.png`...
pub fn write(folder: &Path, images: impl IntoIterator<Item = RgbImage>) {
    std::fs::create_dir_all(folder).unwrap();
    for (i, frame_image) in images.into_iter().enumerate() {
        write_rgb(&folder.join(format!("{i:05}.png")), &frame_image).unwrap();
    }
}
