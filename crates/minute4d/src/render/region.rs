//! Where a camera may go: what it sees from where it stands, and where the source camera was.

use super::Painter;
use super::Stop;
use m4_math::nalgebra::Vector3;
use m4_scene::Scene;

/// Share of the source cameras that counts as the reach of the source.
const REACH_SHARE: f64 = 0.8;
/// What share of the picture is nearer than the nearest things that a path must not enter.
const NEAR_SHARE: f64 = 0.03;

/// The surroundings of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// Where a path starts.
    pub stop: Stop,
    /// Median z-depth of what it sees, world units.
    pub distance: f64,
    /// Z-depth of the nearest things that it sees, world units.
    pub near: f64,
    /// How far the source cameras are to the side, up or down, and ahead or behind, world units.
    pub reach: [f64; 3],
}

impl Region {
    /// The surroundings of a camera of the scene. Where it sees nothing, the distance is one unit.
    #[must_use]
    pub fn of(scene: &Scene, painter: &mut Painter<'_>, stop: Stop) -> Self {
        let depths = painter.depth_quantiles(&stop.camera, stop.t, [NEAR_SHARE, 0.5]);
        let [near, distance] = depths.unwrap_or([1.0, 1.0]);
        let centres: Vec<Vector3<f64>> = scene.source.iter().map(|s| s.camera.centre()).collect();
        Self {
            stop,
            distance,
            near,
            reach: reach(&stop, &centres),
        }
    }

    /// What the camera looks at.
    #[must_use]
    pub fn pivot(&self) -> Vector3<f64> {
        self.stop.camera.c2w.transform(&Vector3::new(0.0, 0.0, self.distance))
    }

    /// The reach in a direction (0 across, 1 up, 2 ahead) as a share of the distance, within limits.
    #[must_use]
    pub fn share(&self, axis: usize, [least, most]: [f64; 2]) -> f64 {
        (self.reach[axis] / self.distance).clamp(least, most.max(least))
    }
}

fn reach(stop: &Stop, centres: &[Vector3<f64>]) -> [f64; 3] {
    let axes = &stop.camera.c2w.rotation;
    std::array::from_fn(|axis| {
        let direction = axes.column(axis);
        let mut ways: Vec<f64> = centres
            .iter()
            .map(|c| direction.dot(&(c - stop.camera.centre())).abs())
            .collect();
        ways.sort_by(f64::total_cmp);
        let last = ways.len().saturating_sub(1);
        ways.get((REACH_SHARE * last as f64).round() as usize)
            .copied()
            .unwrap_or(0.0)
    })
}
