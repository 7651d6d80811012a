//! The region in which a camera may move: the view of its start, and the positions of the source
//! camera.

use super::Painter;
use m4_core::{Column, Scene, SourceFrame, nalgebra::Vector3};
use m4_kernels::pose;

/// Share of the source cameras that counts as the reach of the source.
const REACH_SHARE: f64 = 0.8;
/// Opacity, faded by time, from which a dynamic splat counts.
const SEEN_OPACITY: f64 = 0.2;
/// Fewest splats that make something that moves.
const LEAST_MOVING: usize = 50;

/// The surroundings of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// The start of a path.
    pub stop: SourceFrame,
    /// Median z-depth of dynamic regions in the image, or of the whole image where nothing does;
    /// world units.
    pub distance: f64,
    /// Sideways distance of the source cameras, world units.
    pub reach: f64,
}

impl Region {
    /// The surroundings of a camera of the scene. Where it sees nothing, the distance is one unit.
    pub fn of(scene: &Scene, painter: &mut Painter<'_>, stop: SourceFrame) -> Self {
        let all = painter.median_depth(&stop.camera, stop.t).unwrap_or(1.0);
        // The dynamic part is what one looks at, and what bears a turn of the camera least: the
        // turn is about it.
        let distance = moving_depth(scene, &stop).unwrap_or(all);
        let centres: Vec<Vector3<f64>> = scene.source.iter().map(|s| s.camera.centre()).collect();
        Self {
            stop,
            distance,
            reach: reach(&stop, &centres),
        }
    }

    /// Returns the point that the camera looks at.
    pub fn pivot(&self) -> Vector3<f64> {
        self.stop
            .camera
            .c2w
            .transform(&Vector3::new(0.0, 0.0, self.distance))
    }
}

/// Median z-depth of the dynamic splats that the camera sees; `None` where there are next to none.
fn moving_depth(scene: &Scene, stop: &SourceFrame) -> Option<f64> {
    let splats = &scene.splats;
    let n_static = splats.n_static();
    let column = |column, offset| splats.column(column, offset);
    let (life, log_sd) = (column(Column::TimeMean, 0), column(Column::LogTimeSd, 0));
    let means: [&[f32]; 3] = std::array::from_fn(|k| column(Column::Mean, k));
    let velocities: [&[f32]; 3] = std::array::from_fn(|k| column(Column::Velocity, k));
    let opacity = column(Column::Opacity, 0);
    let size = &stop.camera.intrinsics;
    let (w, h) = (size.width as f64, size.height as f64);
    let w2c = stop.camera.w2c();
    let bound = splats.bindings().len();
    let mut depths: Vec<f64> = (0..splats.n_dynamic())
        .filter_map(|d| {
            let row = n_static + d;
            let dt = stop.t - f64::from(life[d]);
            let marginal = if d < bound {
                pose::presence(splats, d, stop.t)
            } else {
                (-0.5 * (dt / f64::from(log_sd[d]).exp()).powi(2)).exp()
            };
            if marginal / (1.0 + (-f64::from(opacity[row])).exp()) < SEEN_OPACITY {
                return None;
            }
            let mean = if d < bound {
                pose::place(splats, d, stop.t).mean
            } else {
                Vector3::from_fn(|k, _| f64::from(means[k][row]) + f64::from(velocities[k][d]) * dt)
            };
            let p = w2c.transform(&mean);
            let (x, y) = (size.fx * p.x / p.z + size.cx, size.fy * p.y / p.z + size.cy);
            (p.z > 0.0 && (0.0..w).contains(&x) && (0.0..h).contains(&y)).then_some(p.z)
        })
        .collect();
    if depths.len() < LEAST_MOVING {
        return None;
    }
    m4_core::median(&mut depths)
}

fn reach(stop: &SourceFrame, centres: &[Vector3<f64>]) -> f64 {
    let side = stop.camera.c2w.rotation.column(0);
    let mut ways: Vec<f64> = centres
        .iter()
        .map(|c| side.dot(&(c - stop.camera.centre())).abs())
        .collect();
    ways.sort_by(f64::total_cmp);
    let last = ways.len().saturating_sub(1);
    ways.get((REACH_SHARE * last as f64).round() as usize)
        .copied()
        .unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::moving_depth;
    use m4_core::SourceFrame;
    use m4_core::{
        Binding, Camera, Column, Exposure, Intrinsics, Pose, Se3, SplatLayout, Splats, Window,
    };
    use std::sync::Arc;

    #[test]
    fn depth_is_that_of_visible_dynamic_splats() {
        let layout = SplatLayout {
            isotropic: true,
            sh_degree: 0,
            time_degree: 0,
        };
        // 100 static splats at 9; 60 dynamic ones at 4 in frame 10; 60 beside the image; 60 of
        // frame 30.
        let mut splats = Splats::zeros(layout, 100, 180);
        splats.column_mut(Column::Opacity, 0).fill(3.0);
        let z = splats.column_mut(Column::Mean, 2);
        z.fill(9.0);
        z[100..160].fill(3.0);
        z[160..220].fill(1.0);
        z[220..].fill(2.0);
        splats.column_mut(Column::Mean, 0)[160..220].fill(5.0);
        splats.column_mut(Column::TimeMean, 0)[..120].fill(8.0);
        splats.column_mut(Column::TimeMean, 0)[120..].fill(30.0);
        splats.column_mut(Column::LogTimeSd, 0).fill(1.0);
        splats.column_mut(Column::Velocity, 2)[..60].fill(0.5);
        let mut scene = m4_testkit::bare_scene(splats, 31);
        let stop = SourceFrame {
            camera: Camera {
                intrinsics: Intrinsics::centred(64, 48, 50.0),
                c2w: Se3::identity(),
            },
            t: 10.0,
            exposure: Exposure::IDENTITY,
            distance_sigma: None,
        };
        assert_eq!(moving_depth(&scene, &stop), Some(4.0));
        let later = SourceFrame { t: 30.0, ..stop };
        assert_eq!(moving_depth(&scene, &later), Some(2.0));
        // bound splats are where nodes carry them, while they live
        let pose = Pose {
            position: [0.0, 0.0, 2.5],
            rotation: [1.0, 0.0, 0.0, 0.0],
        };
        let window = Window::new(vec![10.0], vec![[0.0; 3]], vec![pose]).unwrap();
        let binding = Binding {
            window: 0,
            nodes: [0; 4],
            weights: [0.25; 4],
            life: [9.0, 12.0],
        };
        scene.splats.column_mut(Column::Velocity, 2).fill(0.0);
        scene
            .splats
            .bind(Arc::new(vec![window]), vec![binding; 60])
            .unwrap();
        assert_eq!(moving_depth(&scene, &stop), Some(5.5));
        assert_eq!(moving_depth(&scene, &SourceFrame { t: 15.0, ..stop }), None);
        scene.splats.column_mut(Column::Opacity, 0).fill(-6.0);
        assert_eq!(moving_depth(&scene, &stop), None, "nothing can be seen");
    }
}
