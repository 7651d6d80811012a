//! Poses of held-out cameras: their alignment with the world of a scene whose geometry was
//! estimated from the video alone, and their refinement against the finished scene.
//!
//! ```text
//! pose --render--> image --squared error--> gradient --backward kernels--> twist --Adam--> pose
//! ```
//!
//! RoDyGS, MoSca and others score held-out images after such a refinement, since estimated or
//! aligned poses are slightly off and half a pixel costs a decibel. It improves every score, so
//! refined scores compare only with refined ones. The pose moves by left twists of world to camera
//! (docs/spec/optimiser.md 1.6): rotations in radians, translations as fractions of the median
//! depth in view, so that the result does not depend on the unit of the world. Splats, intrinsics
//! and time are fixed.

use super::protocol::RefineRule;
use crate::error::Error;
use m4_core::nalgebra::{Matrix3, Vector6};
use m4_core::{Camera, Scene, Sim3};
use m4_eval::geometry::placement;
use m4_eval::image::PlanarImage;
use m4_io::trajectory;
use m4_kernels::{Gradients, Renderer, SimdLevel};
use minute4d::Observer;
use minute4d::observer::check_stop;
use minute4d::render::{Painter, view};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Cameras closer than this share of their path's extent are the same cameras.
const SAME_WORLD: f64 = 1e-4;
/// Moments further apart than this are not the same frame, frames.
const SAME_MOMENT: f64 = 0.3;

/// A similarity from the world of a capture to that of a scene, and how well it fits.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Alignment {
    /// Training cameras that it was fitted to.
    pub cameras: usize,
    /// Scene units in one unit of the capture.
    pub scale: f64,
    /// Row by row.
    pub rotation: [[f64; 3]; 3],
    /// Scene units.
    pub translation: [f64; 3],
    /// Root of the mean squared distance of camera centres afterwards, as a share of the length of
    /// the path, per cent.
    pub rmse_percent: f64,
    /// Median angle between camera axes afterwards, degrees.
    pub median_deg: f64,
}

impl Alignment {
    /// As a map of points and poses.
    #[must_use]
    pub fn similarity(&self) -> Sim3 {
        Sim3 {
            scale: self.scale,
            rotation: Matrix3::from_fn(|i, j| self.rotation[i][j]),
            translation: self.translation.into(),
        }
    }

    fn new(map: &Sim3, pairs: &[(Camera, Camera)]) -> Self {
        let moved = |c: &Camera| map.transform_pose(&c.c2w);
        let squared: f64 = pairs
            .iter()
            .map(|(d, s)| (moved(d).translation - s.centre()).norm_squared())
            .sum();
        let length: f64 = pairs
            .windows(2)
            .map(|w| (w[1].1.centre() - w[0].1.centre()).norm())
            .sum();
        let mut angles: Vec<f64> = pairs
            .iter()
            .map(|(d, s)| angle_deg(&s.c2w.rotation, &moved(d).rotation))
            .collect();
        angles.sort_by(f64::total_cmp);
        Self {
            cameras: pairs.len(),
            scale: map.scale,
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| map.rotation[(i, j)])),
            translation: map.translation.into(),
            rmse_percent: 100.0 * (squared / pairs.len() as f64).sqrt()
                / length.max(f64::MIN_POSITIVE),
            median_deg: angles.get(angles.len() / 2).copied().unwrap_or(0.0),
        }
    }
}

/// The similarity from the capture `data` to `scene`; `None` when they share a world, or when that
/// cannot be determined (with a warning).
pub(super) fn between(
    scene: &Scene,
    data: &Path,
    observer: &dyn Observer,
) -> Result<Option<Alignment>, Error> {
    let Some(list) = training_list(data) else {
        observer.warn(
            "the capture lists no training cameras, so it is assumed that its held-out cameras are in the world \
             of the scene",
        );
        return Ok(None);
    };
    let truth = trajectory::read(&list, scene.time_frames)?;
    let pairs = pairs(&truth, scene);
    if same_world(&pairs) {
        return Ok(None);
    }
    let (truth_cameras, own): (Vec<Camera>, Vec<Camera>) = pairs.iter().copied().unzip();
    let Some(map) = placement(&truth_cameras, &own) else {
        observer.warn(&format!(
            "the scene has a world of its own and {} training cameras are not enough to place the held-out cameras in it; \
             the scores mean nothing",
            pairs.len()
        ));
        return Ok(None);
    };
    let alignment = Alignment::new(&map, &pairs);
    observer.warn(&format!(
        "the scene has a world of its own; the held-out cameras were placed by aligning {} training cameras (error {:.2} % \
         of the path, {:.2} degrees), and the scores include the error of that",
        alignment.cameras, alignment.rmse_percent, alignment.median_deg
    ));
    Ok(Some(alignment))
}

fn training_list(data: &Path) -> Option<PathBuf> {
    let folder = if data.is_dir() { data } else { data.parent()? };
    let names = ["transforms_train.json", "transforms.json"];
    names
        .iter()
        .map(|name| folder.join(name))
        .find(|path| path.is_file())
}

/// Angle between two orientations, degrees.
fn angle_deg(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
    (((a.transpose() * b).trace() - 1.0) / 2.0)
        .clamp(-1.0, 1.0)
        .acos()
        .to_degrees()
}

/// Cameras of the capture and of the scene that took the same frame.
fn pairs(truth: &[(Camera, f64)], scene: &Scene) -> Vec<(Camera, Camera)> {
    let nearest = |t: f64| {
        let closest = truth
            .iter()
            .min_by(|a, b| (a.1 - t).abs().total_cmp(&(b.1 - t).abs()))?;
        ((closest.1 - t).abs() <= SAME_MOMENT).then_some(closest.0)
    };
    scene
        .source
        .iter()
        .filter_map(|s| Some((nearest(s.t)?, s.camera)))
        .collect()
}

fn same_world(pairs: &[(Camera, Camera)]) -> bool {
    let Some(first) = pairs.first() else {
        return false;
    };
    let extent = pairs
        .iter()
        .map(|(d, _)| (d.centre() - first.0.centre()).norm())
        .fold(0.0, f64::max);
    // A static camera has no extent; a unit of the world serves as well.
    let limit = SAME_WORLD * if extent > 0.0 { extent } else { 1.0 };
    pairs.iter().all(|(d, s)| {
        (d.centre() - s.centre()).norm() <= limit
            && (d.c2w.rotation - s.c2w.rotation).norm() <= SAME_WORLD.sqrt()
    })
}

const BETA1: f64 = 0.9;
const BETA2: f64 = 0.999;
/// Small beside any gradient: a step is as long as the rate whatever the loss is divided by.
const EPSILON: f64 = 1e-15;

/// Correction of a pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Moved {
    /// Angle between the orientations before and after, degrees.
    pub turned_deg: f64,
    /// Distance of the camera's centres before and after, shares of the median depth in view.
    pub shifted: f64,
    /// Mean squared error of the image before and after.
    pub mse: [f64; 2],
}

/// Looks for poses in one scene.
pub(super) struct Refiner<'a> {
    scene: &'a Scene,
    painter: Painter<'a>,
    renderer: Renderer,
    gradients: Gradients,
    gradient: [Vec<f32>; 3],
}

impl<'a> Refiner<'a> {
    pub fn new(scene: &'a Scene, level: SimdLevel) -> Self {
        Self {
            scene,
            painter: Painter::new(scene, level),
            renderer: Renderer::new(level),
            gradients: Gradients::default(),
            gradient: Default::default(),
        }
    }

    /// The camera from which the scene at moment `t` (frames) looks most like `reference`, from
    /// `start` on. The last step counts, as with peers, not the best.
    pub fn refine(
        &mut self,
        start: &Camera,
        t: f64,
        reference: &PlanarImage,
        rule: &RefineRule,
        observer: &dyn Observer,
    ) -> Result<(Camera, Moved), Error> {
        // a view of nothing has no depth, nor a gradient
        let unit = self.painter.median_depth(start, t).unwrap_or(1.0);
        let lr: [f64; 6] = std::array::from_fn(|k| if k < 3 { rule.lr * unit } else { rule.lr });
        let (mut m, mut v) = ([0.0; 6], [0.0; 6]);
        let mut camera = *start;
        let mut before = None;
        for step in 1..=rule.steps {
            check_stop(observer, "eval", false)?;
            let (mse, g) = self.gradient(&camera, t, reference);
            before.get_or_insert(mse);
            let power = i32::try_from(step).unwrap_or(i32::MAX);
            let (bias1, bias2) = (1.0 - BETA1.powi(power), 1.0 - BETA2.powi(power));
            let delta: [f64; 6] = std::array::from_fn(|k| {
                m[k] = BETA1 * m[k] + (1.0 - BETA1) * g[k];
                v[k] = BETA2 * v[k] + (1.0 - BETA2) * g[k] * g[k];
                -lr[k] * (m[k] / bias1) / ((v[k] / bias2).sqrt() + EPSILON)
            });
            camera.c2w = camera
                .w2c()
                .retract(&Vector6::from_row_slice(&delta))
                .inverse();
        }
        let (after, _) = self.gradient(&camera, t, reference);
        let moved = Moved {
            turned_deg: angle_deg(&camera.c2w.rotation, &start.c2w.rotation),
            shifted: (camera.centre() - start.centre()).norm() / unit,
            mse: [before.unwrap_or(after), after],
        };
        Ok((camera, moved))
    }

    /// Mean squared error of what `camera` sees, and its gradient with respect to the twist
    /// (translation, then rotation).
    fn gradient(&mut self, camera: &Camera, t: f64, reference: &PlanarImage) -> (f64, [f64; 6]) {
        let splats = &self.scene.splats;
        let frame = self.renderer.render(splats, &view(self.scene, camera, t));
        let (width, height) = reference.size();
        let share = 1.0 / (3 * width * height).max(1) as f64;
        let mut sum = 0.0;
        for (out, (drawn, wanted)) in self
            .gradient
            .iter_mut()
            .zip(frame.rgb.iter().zip(reference.planes()))
        {
            out.clear();
            out.extend(drawn.iter().zip(wanted).map(|(&a, &b)| {
                let off = f64::from(a - b);
                sum += off * off;
                (2.0 * share * off) as f32
            }));
        }
        self.renderer
            .backward(splats, &self.gradient, true, &mut self.gradients);
        let (tau, omega) = (self.gradients.camera.tau, self.gradients.camera.omega);
        (
            sum * share,
            std::array::from_fn(|k| if k < 3 { tau[k] } else { omega[k - 3] }),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::{Alignment, Refiner, placement, same_world};
    use crate::protocol::{RefineRule, StartPose};
    use m4_core::nalgebra::{Vector3, Vector6};
    use m4_core::{Camera, Intrinsics, Se3, Sim3, exp_so3};
    use m4_eval::image::PlanarImage;
    use m4_kernels::SimdLevel;
    use m4_testkit::{SceneSpec, random_scene};
    use minute4d::Silent;
    use minute4d::render::Painter;

    fn camera(i: usize) -> Camera {
        let a = i as f64 * 0.1;
        Camera {
            intrinsics: Intrinsics::centred(16, 12, 15.0),
            // On a line: the centres alone would leave a rotation open.
            c2w: Se3::identity().retract(&Vector6::new(2.0 * a, a, 0.0, 0.1 * a, 0.3 * a, 0.0)),
        }
    }

    #[test]
    fn a_similarity_is_found_even_on_a_straight_path() {
        let map = Sim3 {
            scale: 2.5,
            rotation: exp_so3(&Vector3::new(0.3, -0.8, 0.4)),
            translation: Vector3::new(1.0, -2.0, 0.5),
        };
        let moved = |c: Camera| Camera {
            c2w: map.transform_pose(&c.c2w),
            ..c
        };
        let pairs: Vec<(Camera, Camera)> = (0..8).map(|i| (camera(i), moved(camera(i)))).collect();
        let (from, to): (Vec<Camera>, Vec<Camera>) = pairs.iter().copied().unzip();
        let estimate = placement(&from, &to).unwrap();
        assert!(
            (estimate.scale - 2.5).abs() < 1e-9 && (estimate.rotation - map.rotation).norm() < 1e-9
        );
        assert!((estimate.translation - map.translation).norm() < 1e-9);
        let alignment = Alignment::new(&estimate, &pairs);
        assert!(alignment.rmse_percent < 1e-6 && alignment.median_deg < 1e-4);
        assert_eq!(alignment.similarity(), estimate);
        assert!(!same_world(&pairs));
    }

    #[test]
    fn common_world_is_detected_and_static_camera_cannot_be_aligned() {
        let same: Vec<(Camera, Camera)> = (0..4).map(|i| (camera(i), camera(i))).collect();
        assert!(same_world(&same));
        let still: Vec<(Camera, Camera)> = (0..4).map(|i| (camera(0), camera(i))).collect();
        let (one, many): (Vec<Camera>, Vec<Camera>) = still.into_iter().unzip();
        assert!(placement(&one, &many).is_none() && placement(&many[..2], &many[..2]).is_none());
    }

    #[test]
    fn perturbed_pose_is_recovered() {
        let scene = random_scene(&SceneSpec::default());
        let level = SimdLevel::detect().unwrap();
        let (truth, t) = (scene.source[4].camera, 4.0);
        let mut painter = Painter::new(&scene, level);
        let unit = painter.median_depth(&truth, t).unwrap();
        let frame = painter.frame(&truth, t, false).clone();
        let planes = [0, 1, 2].map(|k| frame.rgb[k].as_slice());
        let reference =
            PlanarImage::from_planes_unclamped(frame.width, frame.height, planes).unwrap();
        let off = Vector6::new(0.01 * unit, -0.008 * unit, 0.01 * unit, 0.006, -0.01, 0.008);
        let start = Camera {
            c2w: truth.w2c().retract(&off).inverse(),
            ..truth
        };
        let rule = RefineRule {
            steps: 150,
            lr: 5e-4,
            start: StartPose::Given,
        };
        let (estimate, moved) = Refiner::new(&scene, level)
            .refine(&start, t, &reference, &rule, &Silent)
            .unwrap();
        let apart = |c: &Camera| {
            let turn = (c.c2w.rotation - truth.c2w.rotation).norm();
            (turn, (c.centre() - truth.centre()).norm() / unit)
        };
        let ((turn0, shift0), (turn1, shift1)) = (apart(&start), apart(&estimate));
        assert!(turn0 > 0.015 && shift0 > 0.01, "{turn0} {shift0}");
        assert!(
            turn1 < 0.2 * turn0 && shift1 < 0.3 * shift0,
            "{turn1} of {turn0}, {shift1} of {shift0}"
        );
        assert!(
            moved.mse[0] > 1e-5 && moved.mse[1] < 0.02 * moved.mse[0],
            "{moved:?}"
        );
        // without a step nothing moves
        let none = RefineRule { steps: 0, ..rule };
        let (same, moved) = Refiner::new(&scene, level)
            .refine(&start, t, &reference, &none, &Silent)
            .unwrap();
        assert_eq!((same, moved.shifted), (start, 0.0));
    }
}
