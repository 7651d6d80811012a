//! A camera that swings around the centre of its view.

use m4_core::{
    Camera, Se3, exp_so3,
    nalgebra::{Matrix3, Vector3},
};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Shape of the swing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SwingConfig {
    /// Greatest turn to either side, degrees. 6: beyond, the dynamic part begins to come apart, since it was seen
    /// from one side alone (ours, judged by eye).
    pub side_deg: f64,
    /// Greatest turn up or down, degrees.
    pub up_deg: f64,
    /// Frames of one swing there and back. 60: two seconds at 30 frames per second.
    pub period_frames: usize,
}

impl Default for SwingConfig {
    fn default() -> Self {
        Self { side_deg: 6.0, up_deg: 2.0, period_frames: 60 }
    }
}

/// `n` cameras that look at the point `distance` in front of `camera` (world units), swinging to both
/// sides on a flat figure of eight; the first is `camera` itself.
#[must_use]
pub fn swing(camera: &Camera, distance: f64, n: usize, config: &SwingConfig) -> Vec<Camera> {
    let pivot = camera.c2w.transform(&Vector3::new(0.0, 0.0, distance));
    let period = config.period_frames.max(2) as f64;
    (0..n)
        .map(|i| {
            let (side, up) = figure_of_eight(TAU * i as f64 / period, config);
            orbit(camera, &pivot, side, up)
        })
        .collect()
}

/// Turns to the side and up, radians, at a phase of the swing, radians.
pub(super) fn figure_of_eight(phase: f64, config: &SwingConfig) -> (f64, f64) {
    let side = config.side_deg.to_radians() * phase.sin();
    let up = config.up_deg.to_radians() * (2.0 * phase).sin();
    (side, up)
}

/// The camera turned about `pivot`: `side` radians about its own vertical, `up` about its horizontal.
pub(super) fn orbit(camera: &Camera, pivot: &Vector3<f64>, side: f64, up: f64) -> Camera {
    let axes = &camera.c2w.rotation;
    let (right, down) = (axes.column(0).into_owned(), axes.column(1).into_owned());
    let turn: Matrix3<f64> = exp_so3(&(down * side)) * exp_so3(&(right * up));
    let about_pivot = Se3 { rotation: turn, translation: pivot - turn * pivot };
    Camera { intrinsics: camera.intrinsics, c2w: about_pivot.compose(&camera.c2w) }
}

#[cfg(test)]
mod tests {
    use super::{SwingConfig, swing};
    use m4_core::{
        Camera, Intrinsics, Se3,
        nalgebra::{Vector3, Vector6},
    };

    #[test]
    fn every_camera_looks_at_the_pivot_from_the_same_distance() {
        let camera = Camera {
            intrinsics: Intrinsics::centred(64, 48, 50.0),
            c2w: Se3::identity().retract(&Vector6::new(1.0, -2.0, 0.5, 0.3, -0.4, 0.2)),
        };
        let pivot = camera.c2w.transform(&Vector3::new(0.0, 0.0, 3.0));
        let config = SwingConfig::default();
        let cameras = swing(&camera, 3.0, 60, &config);
        assert!((cameras[0].c2w.matrix() - camera.c2w.matrix()).norm() < 1e-12);
        for c in &cameras {
            let ([u, v], z) = c.project(&pivot);
            assert!((u - 31.5).abs() < 1e-9 && (v - 23.5).abs() < 1e-9 && (z - 3.0).abs() < 1e-9);
        }
        let angle = |c: &Camera| (c.c2w.rotation.column(2).dot(&camera.c2w.rotation.column(2))).acos().to_degrees();
        let widest = cameras.iter().map(angle).fold(0.0, f64::max);
        assert!((5.9..6.5).contains(&widest), "{widest}");
    }
}
