//! Times training steps on a synthetic scene, kernel by kernel.

use super::{Counts, SceneKind, scene, useful_evaluations};
use crate::{
    Gradients, Kernel, Renderer, SimdLevel, View,
    adam::cpu::{self as adam, AdamConfig, AdamState},
    loss::cpu::{self as photometric, LossScratch, Target},
    morton_order,
};
use m4_core::{ShapeError, Splats};
use std::time::{Duration, Instant};

/// Weight of SSIM beside L1 (3DGS).
const LAMBDA_SSIM: f32 = 0.2;
/// Learning rate of every column: small, so that the scene stays what it is while it is timed.
const RATE: f32 = 1e-4;

/// What is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SceneConfig {
    /// Gaussians in the scene.
    pub splats: usize,
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
    /// Static or moving.
    pub kind: SceneKind,
}

impl Default for SceneConfig {
    /// 100,000 static splats of one colour each on 480x360 pixels.
    fn default() -> Self {
        Self {
            splats: 100_000,
            width: 480,
            height: 360,
            kind: SceneKind::Static,
        }
    }
}

/// What is optimised, from where it is seen, what it should look like.
#[derive(Debug)]
pub struct BenchScene {
    /// In Morton order.
    pub splats: Splats,
    /// One of a static scene, several instants of a dynamic one.
    pub views: Vec<View>,
    /// The image of every view.
    pub target: Target,
}

impl BenchScene {
    /// The scene of `config`. Fails with [`ShapeError`] if the kernels contradict one another; not
    /// on any `config`.
    pub fn new(config: &SceneConfig) -> Result<Self, ShapeError> {
        let SceneConfig {
            width,
            height,
            kind,
            ..
        } = *config;
        let splats = scene::splats(config.splats, (width, height), kind);
        Ok(Self {
            splats: splats.gather(&morton_order(&splats))?,
            views: scene::views(width, height, kind),
            target: Target::from_bytes(width, height, scene::image(width, height))?,
        })
    }
}

/// Wall-clock time of one step on the threads of rayon's current pool.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Times {
    /// In the order of [`Kernel::ALL`].
    pub kernels: [Duration; Kernel::ALL.len()],
    /// From the first to the last.
    pub step: Duration,
    /// Loss before the step.
    pub loss: f64,
}

/// A scene with all that a training step needs.
#[derive(Debug)]
pub struct Bench {
    scene: BenchScene,
    level: SimdLevel,
    renderer: Renderer,
    scratch: LossScratch,
    gradient: [Vec<f32>; 3],
    gradients: Gradients,
    state: AdamState,
    rates: Vec<f32>,
}

impl Bench {
    /// Ready for the first step. Fails as [`BenchScene::new`].
    pub fn new(level: SimdLevel, config: &SceneConfig) -> Result<Self, ShapeError> {
        let scene = BenchScene::new(config)?;
        Ok(Self {
            state: AdamState::new(&scene.splats),
            rates: vec![RATE; scene.splats.columns().len()],
            renderer: Renderer::new(level),
            scratch: LossScratch::default(),
            gradients: Gradients::default(),
            scene,
            level,
            gradient: Default::default(),
        })
    }

    /// The scene as the steps left it.
    #[must_use]
    pub fn into_scene(self) -> BenchScene {
        self.scene
    }

    /// Views to step or render.
    pub fn views(&self) -> usize {
        self.scene.views.len()
    }

    /// Draws view `view` alone: time a kernel, in the order of [`Kernel::ALL`] (0 for those that do
    /// not draw), and of the whole.
    pub fn render(&mut self, view: usize) -> ([Duration; Kernel::ALL.len()], Duration) {
        let start = Instant::now();
        self.renderer
            .render(&self.scene.splats, &self.scene.views[view]);
        let whole = start.elapsed();
        let stats = self.renderer.stats();
        let of = |kernel| match kernel {
            Kernel::Project => stats.project,
            Kernel::Bin => stats.bin,
            Kernel::Blend => stats.blend,
            _ => Duration::ZERO,
        };
        (Kernel::ALL.map(of), whole)
    }

    /// One training step on view `view`.
    pub fn step(&mut self, view: usize) -> Times {
        let start = Instant::now();
        let frame = self
            .renderer
            .render(&self.scene.splats, &self.scene.views[view]);
        let drawn = Instant::now();
        let (target, gradient) = (&self.scene.target, &mut self.gradient);
        let loss = photometric::loss(
            self.level,
            target,
            &frame.rgb,
            LAMBDA_SSIM,
            &mut self.scratch,
            gradient,
        );
        let photo = drawn.elapsed();
        self.renderer.backward(
            &self.scene.splats,
            &self.gradient,
            false,
            &mut self.gradients,
        );
        let backward = Instant::now();
        adam::step(
            self.level,
            &mut self.scene.splats,
            &self.gradients,
            &mut self.state,
            &AdamConfig::default(),
            &self.rates,
        );
        let (adam, step) = (backward.elapsed(), start.elapsed());
        let stats = self.renderer.stats();
        let of = |kernel| match kernel {
            Kernel::Project => stats.project,
            Kernel::Bin => stats.bin,
            Kernel::Blend => stats.blend,
            Kernel::Photo => photo,
            Kernel::BlendBackward => stats.blend_backward,
            Kernel::ProjectBackward => stats.project_backward,
            Kernel::Adam => adam,
        };
        Times {
            kernels: Kernel::ALL.map(of),
            step,
            loss: loss.total,
        }
    }

    /// What a step on view `view` has to do; draws it, and counts slowly.
    pub fn count(&mut self, view: usize) -> Counts {
        let view = &self.scene.views[view];
        let splats = &self.scene.splats;
        let frame = self.renderer.render(splats, view);
        let pixels = frame.width * frame.height;
        photometric::loss(
            self.level,
            &self.scene.target,
            &frame.rgb,
            LAMBDA_SSIM,
            &mut self.scratch,
            &mut self.gradient,
        );
        self.renderer
            .backward(splats, &self.gradient, false, &mut self.gradients);
        let stats = self.renderer.stats();
        let (first, rest) = self.gradients.touched.split_at(splats.n_static());
        Counts {
            pixels,
            splats: splats.n(),
            alive: [splats.n_static(), super::work::alive(splats, view.t)],
            visible: stats.visible,
            touched: [first, rest].map(|part| part.iter().filter(|&&t| t != 0).count()),
            pairs: stats.pairs,
            used: stats.used,
            useful: useful_evaluations(splats, view),
            shared_columns: splats.layout().shared_columns(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Bench, SceneConfig};
    use crate::{Kernel, SimdLevel, bench::SceneKind};

    #[test]
    fn steps_are_timed_and_lower_the_loss() {
        for kind in [SceneKind::Static, SceneKind::FourD] {
            let config = SceneConfig {
                splats: 4000,
                width: 96,
                height: 72,
                kind,
            };
            let mut bench = Bench::new(SimdLevel::best(), &config).unwrap();
            let counts = bench.count(0);
            assert!(
                counts.pairs >= counts.used && counts.used > counts.visible / 2,
                "{counts:?}"
            );
            assert!(counts.useful as usize > 3 * counts.pixels, "{counts:?}");
            assert!((0.01..1.0).contains(&counts.useful_share()), "{counts:?}");
            let [_, alive] = counts.alive;
            assert!(
                alive < 4000 / 20,
                "most dynamic splats are not there: {alive}"
            );
            let first = bench.step(0);
            let last = (0..10).map(|_| bench.step(0)).last().unwrap();
            assert!(
                last.step > last.kernels[0] && last.loss < first.loss,
                "{first:?} {last:?}"
            );
            for kernel in Kernel::ALL {
                let work = kernel.work(&counts);
                assert!(work.bytes > 0.0, "{}", kernel.name());
            }
        }
    }
}
