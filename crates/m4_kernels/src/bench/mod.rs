//! Times every kernel on a synthetic scene, for `minute4d bench` and for people who tune kernels.

mod scene;

use crate::{
    FrameGradient, Gradients, Renderer, SimdLevel, View,
    adam::cpu::{self as adam, AdamConfig, AdamState},
    morton_order,
    photo::cpu::{self as photo, PhotoScratch, Target},
};
use m4_scene::{ShapeError, Splats};
use std::time::Instant;

/// What to time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BenchConfig {
    /// Gaussians in the scene.
    pub splats: usize,
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
    /// Degree of the spatial harmonics of the colour, 0..=3.
    pub sh_degree: usize,
    /// Share of the splats that is dynamic, 0..1.
    pub dynamic: f64,
    /// Steps that are timed; the fastest of each kernel counts.
    pub steps: usize,
}

impl Default for BenchConfig {
    /// 100,000 static splats of one colour each on 480x360 pixels, 20 steps.
    fn default() -> Self {
        Self {
            splats: 100_000,
            width: 480,
            height: 360,
            sh_degree: 0,
            dynamic: 0.0,
            steps: 20,
        }
    }
}

/// Wall-clock milliseconds a step, on the threads of rayon's current pool; the fastest of all steps,
/// kernel by kernel.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct BenchReport {
    /// Splats that reached the image.
    pub visible: usize,
    /// Entries of the tile lists.
    pub pairs: usize,
    /// Slice, project and shade.
    pub project_ms: f64,
    /// Depth order and tile lists.
    pub bin_ms: f64,
    /// Tile lists to the image.
    pub blend_ms: f64,
    /// L1 + SSIM and its gradient.
    pub photo_ms: f64,
    /// Image gradient to ellipse gradients.
    pub blend_backward_ms: f64,
    /// Ellipse gradients to parameter gradients.
    pub project_backward_ms: f64,
    /// The optimiser.
    pub adam_ms: f64,
    /// The whole step, of the fastest step.
    pub step_ms: f64,
    /// Loss of the first and of the last step: they show that the steps do what they should.
    pub loss: [f64; 2],
}

/// Everything that one training step touches.
#[derive(Debug)]
pub struct BenchScene {
    /// What is optimised.
    pub splats: Splats,
    /// What is drawn.
    pub view: View,
    /// What it should look like.
    pub target: Target,
}

impl BenchScene {
    /// The scene of `config`, in Morton order.
    ///
    /// # Errors
    ///
    /// [`ShapeError`] if the kernels contradict one another; not on any `config`.
    pub fn new(config: &BenchConfig) -> Result<Self, ShapeError> {
        let camera = scene::camera(config.width, config.height);
        let t = 10.0;
        let n_dynamic = (config.splats as f64 * config.dynamic.clamp(0.0, 1.0)) as usize;
        let splats = scene::splats(config.splats, n_dynamic, &camera, config.sh_degree.min(3), t);
        Ok(Self {
            splats: splats.gather(&morton_order(&splats))?,
            view: View {
                camera,
                t,
                background: [0.0; 3],
                near: 0.05,
                mip: false,
                period: 30.0,
                with_depth: false,
            },
            target: Target::new(config.width, config.height, scene::picture(&camera))?,
        })
    }
}

/// Times `config.steps` training steps.
///
/// # Errors
///
/// As [`BenchScene::new`].
pub fn run(level: SimdLevel, config: &BenchConfig) -> Result<BenchReport, ShapeError> {
    let BenchScene {
        mut splats,
        view,
        target,
    } = BenchScene::new(config)?;
    let mut renderer = Renderer::new(level);
    let (mut scratch, mut gradient) = (PhotoScratch::default(), FrameGradient::default());
    let mut gradients = Gradients::default();
    let mut state = AdamState::new(&splats);
    let rates = vec![1e-4; splats.columns().len()];
    let mut best: Option<BenchReport> = None;
    for _ in 0..config.steps.max(1) {
        let start = Instant::now();
        let frame = renderer.render(&splats, &view);
        let drawn = Instant::now();
        let loss = photo::loss(level, &target, &frame.rgb, 0.2, &mut scratch, &mut gradient.rgb);
        let photo = drawn.elapsed();
        renderer.backward(&splats, &gradient, &mut gradients);
        let backward = Instant::now();
        adam::step(
            level,
            &mut splats,
            &gradients,
            &mut state,
            &AdamConfig::default(),
            &rates,
        );
        let (adam, step) = (backward.elapsed(), start.elapsed());
        let stats = renderer.stats();
        let ms = |d: std::time::Duration| d.as_secs_f64() * 1e3;
        let now = BenchReport {
            visible: stats.visible,
            pairs: stats.pairs,
            project_ms: ms(stats.project),
            bin_ms: ms(stats.bin),
            blend_ms: ms(stats.blend),
            photo_ms: ms(photo),
            blend_backward_ms: ms(stats.blend_backward),
            project_backward_ms: ms(stats.project_backward),
            adam_ms: ms(adam),
            step_ms: ms(step),
            loss: [loss.total; 2],
        };
        best = Some(best.map_or(now, |b| b.fastest(&now)));
    }
    Ok(best.unwrap_or_default())
}

impl BenchReport {
    /// Kernel by kernel the faster of two reports, of which `later` is the later.
    fn fastest(&self, later: &Self) -> Self {
        Self {
            visible: later.visible,
            pairs: later.pairs,
            project_ms: self.project_ms.min(later.project_ms),
            bin_ms: self.bin_ms.min(later.bin_ms),
            blend_ms: self.blend_ms.min(later.blend_ms),
            photo_ms: self.photo_ms.min(later.photo_ms),
            blend_backward_ms: self.blend_backward_ms.min(later.blend_backward_ms),
            project_backward_ms: self.project_backward_ms.min(later.project_backward_ms),
            adam_ms: self.adam_ms.min(later.adam_ms),
            step_ms: self.step_ms.min(later.step_ms),
            loss: [self.loss[0], later.loss[1]],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{BenchConfig, run};
    use crate::SimdLevel;

    #[test]
    fn steps_are_timed_and_lower_the_loss() {
        let config = BenchConfig {
            splats: 2000,
            width: 96,
            height: 72,
            sh_degree: 1,
            dynamic: 0.25,
            steps: 10,
        };
        let report = run(SimdLevel::best(), &config).unwrap();
        assert!(report.visible > 1000 && report.pairs > report.visible);
        assert!(report.step_ms > 0.0 && report.loss[1] < report.loss[0], "{report:?}");
    }
}
