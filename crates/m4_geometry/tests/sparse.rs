//! The sparse half on rendered images, and on the shared benchmark where it is present.

use m4_core::{Camera, Intrinsics, Plane, RgbImage, Se3, Silent, Sim3, exp_so3, nalgebra::Vector3};
use m4_geometry::classical::sparse::{SparseConfig, SparseError, track_features};
use m4_geometry::classical::{CameraMotion, Motion, SparseReconstruction};

const FRAMES: usize = 12;

/// Smooth noise in 0..=1 whose detail is some 0.08 units wide.
fn texture(u: f64, v: f64, salt: f64) -> f64 {
    let lattice = |i: f64, j: f64| {
        let h = ((i * 12.9898 + j * 78.233 + salt * 37.719).sin() * 43_758.545_3).fract();
        h.abs()
    };
    let layer = |size: f64| {
        let (x, y) = (u / size, v / size);
        let (i, j) = (x.floor(), y.floor());
        let soft = |t: f64| t * t * (3.0 - 2.0 * t);
        let (a, b) = (soft(x - i), soft(y - j));
        let row = |j: f64| lattice(i, j) * (1.0 - a) + lattice(i + 1.0, j) * a;
        row(j) * (1.0 - b) + row(j + 1.0) * b
    };
    0.6 * layer(0.13) + 0.4 * layer(0.37)
}

/// A corner of a room (back wall at z = 5, floor at y = 1) and a plate at z = 3 that moves with
/// `t`.
fn render(camera: &Camera, t: f64) -> RgbImage {
    let k = camera.intrinsics;
    let origin = camera.centre();
    Plane::from_fn(k.width, k.height, |x, y| {
        let d = camera.unproject(x as f64, y as f64, 1.0) - origin;
        let hit = |distance: f64| origin + d * distance;
        let plate = hit((3.0 - origin.z) / d.z);
        let (u, v) = (
            plate.x + 0.6 - 0.06 * t,
            plate.y + 0.2 + 0.25 * (0.8 * t).sin(),
        );
        let wall = hit((5.0 - origin.z) / d.z);
        let value = if u.abs() < 0.4 && v.abs() < 0.4 {
            texture(u, v, 3.0)
        } else if wall.y > 1.0 {
            let floor = hit((1.0 - origin.y) / d.y);
            texture(floor.x, floor.z, 2.0)
        } else {
            texture(wall.x, wall.y, 1.0)
        };
        [(40.0 + 180.0 * value) as u8; 3]
    })
}

fn cameras(move_by: f64, turn_by: f64) -> Vec<Camera> {
    (0..FRAMES)
        .map(|i| {
            let t = i as f64;
            let bob = (0.5 * t).sin();
            Camera {
                intrinsics: Intrinsics::centred(256, 192, 230.0),
                c2w: Se3 {
                    rotation: exp_so3(&(Vector3::new(0.3 * bob, -t, 0.2 * bob) * turn_by)),
                    translation: Vector3::new(t, 0.5 * bob, 0.2 * t) * move_by,
                },
            }
        })
        .collect()
}

fn render_all(cameras: &[Camera]) -> Vec<RgbImage> {
    (0..)
        .zip(cameras)
        .map(|(i, c)| render(c, f64::from(i)))
        .collect()
}

fn reconstruct(
    images: &[RgbImage],
    config: &SparseConfig,
) -> Result<SparseReconstruction, SparseError> {
    let frames: Vec<&RgbImage> = images.iter().collect();
    let result = track_features(&frames, config, &Silent)?.recover(None, config, &Silent)?;
    Ok(result.sparse)
}

#[test]
fn a_rendered_room_is_reconstructed() {
    let truth = cameras(0.06, 0.008);
    let reconstruction =
        reconstruct(&render_all(&truth), &SparseConfig::default()).expect("a reconstruction");
    assert_eq!(
        reconstruction.camera_motion,
        CameraMotion::Parallax,
        "{:?}",
        reconstruction.warnings
    );
    let centres = |cameras: &[Camera]| cameras.iter().map(Camera::centre).collect::<Vec<_>>();
    let (ours, want) = (centres(&reconstruction.cameras), centres(&truth));
    let fit = Sim3::umeyama(&ours, &want).expect("a trajectory");
    let worst = ours
        .iter()
        .zip(&want)
        .map(|(a, b)| (fit.transform(a) - b).norm())
        .fold(0.0, f64::max);
    let path: f64 = want.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    assert!(worst < 0.02 * path, "off by {worst} on a path of {path}");
    let focal = reconstruction.cameras[0].intrinsics.fx;
    assert!((focal / 230.0 - 1.0).abs() < 0.08, "focal {focal}");
    // Tracks that begin on the plate move, those that stay clear of it do not.
    let (mut on, mut on_moves, mut off, mut off_moves) = (0, 0, 0, 0);
    for t in reconstruction
        .tracks
        .iter()
        .filter(|t| t.motion != Motion::Unknown)
    {
        let inside = t
            .observations
            .iter()
            .zip(t.first_frame..)
            .filter(|(p, frame)| {
                let camera = &truth[*frame];
                let d = camera.unproject(f64::from(p[0]), f64::from(p[1]), 1.0) - camera.centre();
                let x = camera.centre() + d * ((3.0 - camera.centre().z) / d.z);
                let time = *frame as f64;
                let (u, v) = (
                    x.x + 0.6 - 0.06 * time,
                    x.y + 0.2 + 0.25 * (0.8 * time).sin(),
                );
                u.abs() < 0.36 && v.abs() < 0.36
            });
        let inside = inside.count();
        let moves = usize::from(t.motion == Motion::Dynamic);
        if inside == t.observations.len() {
            (on, on_moves) = (on + 1, on_moves + moves);
        } else if inside == 0 {
            (off, off_moves) = (off + 1, off_moves + moves);
        }
    }
    assert!(
        on >= 10 && 4 * on_moves >= 3 * on,
        "{on_moves} of {on} tracks on the plate move"
    );
    assert!(
        off > 100 && 10 * off_moves <= off,
        "{off_moves} of {off} tracks beside the plate move"
    );
}

#[test]
fn static_and_turning_cameras_are_distinguished() {
    for (turn, motion) in [
        (0.0, CameraMotion::Static),
        (0.01, CameraMotion::RotationOnly),
    ] {
        let images = render_all(&cameras(0.0, turn));
        let reconstruction = reconstruct(&images, &SparseConfig::default()).expect("poses");
        assert_eq!(
            reconstruction.camera_motion, motion,
            "{:?}",
            reconstruction.warnings
        );
        assert!(!reconstruction.warnings.is_empty());
    }
}

#[test]
fn bad_input_is_refused() {
    let run = |images: &[RgbImage]| {
        reconstruct(images, &SparseConfig::default())
            .unwrap_err()
            .to_string()
    };
    let plain = |w, h| Plane::filled(w, h, [90_u8; 3]);
    for (frames, reason) in [
        (vec![], "the clip has 0 frame(s)"),
        (vec![plain(100, 80)], "the clip has 1 frame(s)"),
        (
            vec![plain(100, 80), plain(100, 81)],
            "frame 1 is (100, 81) pixels",
        ),
        (vec![plain(60, 80), plain(60, 80)], "frames of 60x80 pixels"),
        (
            vec![plain(100, 80), plain(100, 80)],
            "only 0 points could be tracked from frame 0",
        ),
    ] {
        assert!(run(&frames).contains(reason), "{}", run(&frames));
    }
    let config = SparseConfig {
        fov_deg: Some(f64::NAN),
        ..SparseConfig::default()
    };
    let got = reconstruct(&[plain(100, 80), plain(100, 80)], &config).map(|_| ());
    assert!(
        matches!(
            got,
            Err(SparseError::Setting {
                name: "fov_deg",
                ..
            })
        ),
        "{got:?}"
    );
}
