//! Refines the pose of a test image by optimisation against the finished scene.
//!
//! ```text
//! pose --render--> image --squared error--> gradient --backward kernels--> twist --Adam--> pose
//! ```
//!
//! RoDyGS, MoSca and others score held-out images after such a refinement, since estimated or aligned poses are slightly off and
//! half a pixel costs a decibel. It improves every score, so refined scores compare only with refined ones. The pose moves by left twists
//! of world to camera (docs/spec/optimiser.md 1.6): rotations in radians, translations as fractions of the median depth in view, so that the
//! result does not depend on the unit of the world. Splats, intrinsics and time are fixed.

use super::protocol::RefineRule;
use crate::render::{Painter, view};
use crate::{Error, Observer};
use m4_core::{Camera, Scene, nalgebra::Vector6};
use m4_eval::image::PlanarImage;
use m4_kernels::{FrameGradient, Gradients, Renderer, SimdLevel};
use serde::Serialize;

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
    gradient: FrameGradient,
}

impl<'a> Refiner<'a> {
    pub fn new(scene: &'a Scene, level: SimdLevel) -> Self {
        Self {
            scene,
            painter: Painter::new(scene, level),
            renderer: Renderer::new(level),
            gradients: Gradients::default(),
            gradient: FrameGradient::default(),
        }
    }

    /// The camera from which the scene at moment `t` (frames) looks most like `reference`, from `start` on. The last step counts, as with
    /// peers, not the best.
    ///
    /// # Errors
    ///
    /// [`Error::Stopped`] if the caller asked to.
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
            if observer.cancelled() {
                return Err(Error::Stopped { stage: "eval", saved: false });
            }
            let (mse, g) = self.gradient(&camera, t, reference);
            before.get_or_insert(mse);
            let power = i32::try_from(step).unwrap_or(i32::MAX);
            let (bias1, bias2) = (1.0 - BETA1.powi(power), 1.0 - BETA2.powi(power));
            let delta: [f64; 6] = std::array::from_fn(|k| {
                m[k] = BETA1 * m[k] + (1.0 - BETA1) * g[k];
                v[k] = BETA2 * v[k] + (1.0 - BETA2) * g[k] * g[k];
                -lr[k] * (m[k] / bias1) / ((v[k] / bias2).sqrt() + EPSILON)
            });
            camera.c2w = camera.w2c().retract(&Vector6::from_row_slice(&delta)).inverse();
        }
        let (after, _) = self.gradient(&camera, t, reference);
        let turn = camera.c2w.rotation.transpose() * start.c2w.rotation;
        let moved = Moved {
            turned_deg: ((turn.trace() - 1.0) / 2.0).clamp(-1.0, 1.0).acos().to_degrees(),
            shifted: (camera.centre() - start.centre()).norm() / unit,
            mse: [before.unwrap_or(after), after],
        };
        Ok((camera, moved))
    }

    /// Mean squared error of what `camera` sees, and its gradient with respect to the twist (translation, then rotation).
    fn gradient(&mut self, camera: &Camera, t: f64, reference: &PlanarImage) -> (f64, [f64; 6]) {
        let splats = &self.scene.splats;
        let frame = self.renderer.render(splats, &view(self.scene, camera, t));
        let (width, height) = reference.size();
        let share = 1.0 / (3 * width * height).max(1) as f64;
        let mut sum = 0.0;
        for (out, (drawn, wanted)) in self.gradient.rgb.iter_mut().zip(frame.rgb.iter().zip(reference.planes())) {
            out.clear();
            out.extend(drawn.iter().zip(wanted).map(|(&a, &b)| {
                let off = f64::from(a - b);
                sum += off * off;
                (2.0 * share * off) as f32
            }));
        }
        self.renderer.backward(splats, &self.gradient, true, &mut self.gradients);
        let c = &self.gradients.camera;
        let [a, b, d] = c.tau;
        let [e, f, g] = c.omega;
        (sum * share, [a, b, d, e, f, g])
    }
}

#[cfg(test)]
mod tests {
    use super::Refiner;
    use crate::Silent;
    use crate::evaluate::protocol::{RefineRule, StartPose};
    use crate::render::Painter;
    use m4_core::{Camera, nalgebra::Vector6};
    use m4_eval::image::PlanarImage;
    use m4_kernels::SimdLevel;
    use m4_testkit::{SceneSpec, random_scene};

    #[test]
    fn perturbed_pose_is_recovered() {
        let scene = random_scene(&SceneSpec::default());
        let level = SimdLevel::detect().unwrap();
        let (truth, t) = (scene.source[4].camera, 4.0);
        let mut painter = Painter::new(&scene, level);
        let unit = painter.median_depth(&truth, t).unwrap();
        let frame = painter.frame(&truth, t, false).clone();
        let planes = [0, 1, 2].map(|k| frame.rgb[k].as_slice());
        let reference = PlanarImage::from_planes_unclamped(frame.width, frame.height, planes).unwrap();
        let off = Vector6::new(0.01 * unit, -0.008 * unit, 0.01 * unit, 0.006, -0.01, 0.008);
        let start = Camera { c2w: truth.w2c().retract(&off).inverse(), ..truth };
        let rule = RefineRule { steps: 150, lr: 5e-4, start: StartPose::Given };
        let (found, moved) = Refiner::new(&scene, level).refine(&start, t, &reference, &rule, &Silent).unwrap();
        let apart = |c: &Camera| {
            let turn = (c.c2w.rotation - truth.c2w.rotation).norm();
            (turn, (c.centre() - truth.centre()).norm() / unit)
        };
        let ((turn0, shift0), (turn1, shift1)) = (apart(&start), apart(&found));
        assert!(turn0 > 0.015 && shift0 > 0.01, "{turn0} {shift0}");
        assert!(turn1 < 0.2 * turn0 && shift1 < 0.3 * shift0, "{turn1} of {turn0}, {shift1} of {shift0}");
        assert!(moved.mse[0] > 1e-5 && moved.mse[1] < 0.02 * moved.mse[0], "{moved:?}");
        // without a step nothing moves
        let none = RefineRule { steps: 0, ..rule };
        let (same, moved) = Refiner::new(&scene, level).refine(&start, t, &reference, &none, &Silent).unwrap();
        assert_eq!((same, moved.shifted), (start, 0.0));
    }
}
