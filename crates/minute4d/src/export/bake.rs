//! Bakes the Mip filter into opacities, for viewers without such a filter.

use m4_core::{
    Column, Scene,
    nalgebra::{Matrix3, Vector3, Vector4},
    quat,
};
use m4_io::scene::Loss;
use m4_kernels::pose;
use m4_kernels::project::reference::{Pinhole, project};
use rayon::prelude::*;

/// Cameras that a splat is looked at from.
const CAMERAS: usize = 16;
/// Standard deviations in time after which a splat is not drawn: a marginal of 0.05
/// (docs/spec/optimiser.md 1.3).
const REACH_SD: f64 = 2.447_746_83;
/// Least opacity that is kept apart from nothing.
const LEAST_OPACITY: f64 = 1e-6;

/// The scene for a renderer without Mip filter. Both renderers widen a splat by the same low pass,
/// but the filter also makes it fainter, by the area that it gained (docs/spec/optimiser.md 1.6):
/// by how much depends on where it is seen from. Here that factor, averaged over up to 16 of the
/// source cameras that see the splat while it lives, goes into its opacity. `None` for scenes
/// without filter or without cameras.
pub(super) fn bake(scene: &Scene) -> Option<(Scene, Loss)> {
    if !scene.mip || scene.source.is_empty() {
        return None;
    }
    let mut views: Vec<SourceCamera> = scene.source.iter().map(SourceCamera::new).collect();
    views.sort_by(|a, b| a.t.total_cmp(&b.t));
    let factors: Vec<f64> = (0..scene.splats.n())
        .into_par_iter()
        .map(|row| factor(scene, &views, row))
        .collect();
    let mut baked = scene.clone();
    baked.mip = false;
    for (logit, factor) in baked
        .splats
        .column_mut(Column::Opacity, 0)
        .iter_mut()
        .zip(&factors)
    {
        let opacity = factor / (1.0 + (-f64::from(*logit)).exp());
        let opacity = opacity.clamp(LEAST_OPACITY, 1.0 - LEAST_OPACITY);
        *logit = (opacity / (1.0 - opacity)).ln() as f32;
    }
    let median = m4_core::median(&mut { factors }).unwrap_or(1.0);
    let loss = Loss::Baked(format!(
        "the Mip filter, into the opacities, as the source cameras see it on average (half of the splats keep less than {:.0} % of theirs)",
        100.0 * median
    ));
    Some((baked, loss))
}

struct SourceCamera {
    t: f64,
    camera: Pinhole<f64>,
    size_px: [f64; 2],
}

impl SourceCamera {
    fn new(frame: &m4_core::SourceFrame) -> Self {
        let k = &frame.camera.intrinsics;
        Self {
            t: frame.t,
            camera: Pinhole::new(&frame.camera),
            size_px: [k.width as f64, k.height as f64],
        }
    }
}

/// What the filter leaves of the opacity of a splat, 0..1; 1 where no camera is in front of it.
fn factor(scene: &Scene, views: &[SourceCamera], row: usize) -> f64 {
    let splats = &scene.splats;
    let value = |column, k, i: usize| f64::from(splats.column(column, k)[i]);
    let mean = Vector3::from_fn(|k, _| value(Column::Mean, k, row));
    let covariance = covariance(scene, row);
    if splats.bound().contains(&row) {
        return factor_of_bound(scene, views, row - splats.n_static());
    }
    let life = row.checked_sub(splats.n_static());
    let centre_and_sd = life.map(|d| {
        (
            value(Column::TimeMean, 0, d),
            value(Column::LogTimeSd, 0, d).exp(),
        )
    });
    let velocity = life.map_or(Vector3::zeros(), |d| {
        Vector3::from_fn(|k, _| value(Column::Velocity, k, d))
    });
    match centre_and_sd {
        Some((centre, sd)) => {
            let during = during(views, [centre - REACH_SD * sd, centre + REACH_SD * sd]);
            mean_factor(scene, during, |t| {
                let dt = t - centre;
                (
                    mean + velocity * dt,
                    covariance,
                    (-0.5 * (dt / sd).powi(2)).exp(),
                )
            })
        }
        None => mean_factor(scene, views, |_| (mean, covariance, 1.0)),
    }
}

/// The same of bound splat `i`, where nodes carry it.
fn factor_of_bound(scene: &Scene, views: &[SourceCamera], i: usize) -> f64 {
    let splats = &scene.splats;
    let covariance = variances(scene, splats.n_static() + i);
    mean_factor(
        scene,
        during(views, splats.bindings()[i].life.map(f64::from)),
        |t| {
            let at = pose::place(splats, i, t);
            (
                at.mean,
                turned(&covariance, &at.quat),
                pose::presence(splats, i, t),
            )
        },
    )
}

/// The views of a span of time; between two frames, or outside the clip, the next one.
fn during(views: &[SourceCamera], [begin, end]: [f64; 2]) -> &[SourceCamera] {
    let first = views.partition_point(|v| v.t < begin);
    let end = views.partition_point(|v| v.t <= end);
    if first < end {
        &views[first..end]
    } else {
        let one = first.min(views.len() - 1);
        &views[one..=one]
    }
}

/// The mean over up to [`CAMERAS`] of the views; `at` says where a splat is at a moment, its
/// covariance and its weight.
fn mean_factor(
    scene: &Scene,
    views: &[SourceCamera],
    at: impl Fn(f64) -> (Vector3<f64>, Matrix3<f64>, f64),
) -> f64 {
    let count = views.len().min(CAMERAS);
    let [mut inside, mut in_front] = [(0.0, 0.0); 2];
    for k in 0..count {
        let view = &views[(2 * k + 1) * views.len() / (2 * count)];
        let (mean, covariance, weight) = at(view.t);
        let Some(projection) = project(
            &mean,
            &covariance,
            &view.camera,
            f64::from(scene.near),
            true,
        ) else {
            continue;
        };
        // a weight of 0 (far outside the clip) would leave nothing to divide by
        let weight = weight.max(f64::MIN_POSITIVE);
        let add = |sum: &mut (f64, f64)| {
            sum.0 += weight * projection.compensation;
            sum.1 += weight;
        };
        add(&mut in_front);
        if (0..2).all(|k| (-0.5..view.size_px[k] - 0.5).contains(&projection.centre[k])) {
            add(&mut inside);
        }
    }
    let (sum, weight) = if inside.1 > 0.0 { inside } else { in_front };
    let factor = sum / weight;
    if factor.is_finite() {
        factor.clamp(0.0, 1.0)
    } else {
        1.0
    }
}

/// World units squared.
fn covariance(scene: &Scene, row: usize) -> Matrix3<f64> {
    let splats = &scene.splats;
    let scales = variances(scene, row);
    if splats.layout().isotropic {
        return scales;
    }
    turned(
        &scales,
        &Vector4::from_fn(|k, _| f64::from(splats.column(Column::Quat, k)[row])),
    )
}

/// World units squared, along the axes of the splat.
fn variances(scene: &Scene, row: usize) -> Matrix3<f64> {
    let isotropic = scene.splats.layout().isotropic;
    let log_scale = |k| {
        f64::from(
            scene
                .splats
                .column(Column::LogScale, if isotropic { 0 } else { k })[row],
        )
    };
    Matrix3::from_diagonal(&Vector3::from_fn(|k, _| (2.0 * log_scale(k)).exp()))
}

fn turned(scales: &Matrix3<f64>, q: &Vector4<f64>) -> Matrix3<f64> {
    let r = quat::rotation(&(q / q.norm().max(f64::MIN_POSITIVE)));
    r * scales * r.transpose()
}

#[cfg(test)]
mod tests {
    use super::bake;
    use m4_core::{
        Binding, Camera, Column, Exposure, Intrinsics, Pose, Scene, Se3, SourceFrame, SplatLayout,
        Splats, Window,
    };
    use std::sync::Arc;

    /// A splat of a pixel wide and one that lives while the camera is twice as near.
    fn scene() -> Scene {
        let layout = SplatLayout {
            isotropic: true,
            sh_degree: 0,
            time_degree: 0,
        };
        let mut splats = Splats::zeros(layout, 1, 1);
        splats.column_mut(Column::Mean, 2).fill(10.0);
        splats.column_mut(Column::LogScale, 0).fill(0.1f32.ln());
        splats.column_mut(Column::TimeMean, 0)[0] = 1.0;
        splats.column_mut(Column::LogTimeSd, 0)[0] = 0.1f32.ln();
        let frame = |t: f64| SourceFrame {
            camera: Camera {
                intrinsics: Intrinsics::centred(64, 48, 100.0),
                c2w: Se3 {
                    translation: m4_core::nalgebra::Vector3::new(0.0, 0.0, 5.0 * t),
                    ..Se3::identity()
                },
            },
            t,
            exposure: Exposure::IDENTITY,
            distance_sigma: None,
        };
        Scene {
            mip: true,
            source: vec![frame(1.0), frame(0.0)],
            ..m4_testkit::bare_scene(splats, 2)
        }
    }

    #[test]
    fn opacities_are_those_that_the_cameras_see() {
        let (baked, _) = bake(&scene()).unwrap();
        assert!(!baked.mip);
        let opacity =
            |i: usize| 1.0 / (1.0 + (-f64::from(baked.splats.column(Column::Opacity, 0)[i])).exp());
        // variances of 1 and 4 pixels and the low pass of 0.3; both opacities were 1/2
        let (far, near) = (1.0 / 1.3, 4.0 / 4.3);
        assert!(
            (opacity(0) - 0.5 * (far + near) / 2.0).abs() < 1e-6,
            "{}",
            opacity(0)
        );
        assert!((opacity(1) - 0.5 * near).abs() < 1e-6, "{}", opacity(1));
    }

    #[test]
    fn a_bound_splat_is_looked_at_where_nodes_carry_it() {
        let mut scene = scene();
        // the second splat is bound, and carried 5 units away from the camera of frame 0 that alone
        // sees it
        let pose = |z: f32| Pose {
            position: [0.0, 0.0, z],
            rotation: [1.0, 0.0, 0.0, 0.0],
        };
        let window =
            Window::new(vec![0.0, 1.0], vec![[0.0; 3]], vec![pose(10.0), pose(0.0)]).unwrap();
        let binding = Binding {
            window: 0,
            nodes: [0; 4],
            weights: [0.25; 4],
            life: [f32::NEG_INFINITY, 0.4],
        };
        scene
            .splats
            .bind(Arc::new(vec![window]), vec![binding])
            .unwrap();
        scene.splats.column_mut(Column::TimeMean, 0)[0] = 0.0;
        let (baked, _) = bake(&scene).unwrap();
        let opacity = 1.0 / (1.0 + (-f64::from(baked.splats.column(Column::Opacity, 0)[1])).exp());
        // at depth 20 a variance of a quarter of a pixel
        assert!((opacity - 0.5 * 0.25 / 0.55).abs() < 1e-6, "{opacity}");
    }

    #[test]
    fn scenes_without_the_filter_stay() {
        let mut plain = scene();
        plain.mip = false;
        assert!(bake(&plain).is_none());
        let mut blind = scene();
        blind.source.clear();
        assert!(bake(&blind).is_none());
        let mut behind = scene();
        for frame in &mut behind.source {
            frame.camera.c2w.translation.z = 20.0;
        }
        let (baked, _) = bake(&behind).unwrap();
        assert_eq!(baked.splats, behind.splats, "nobody sees them");
    }
}
