//! Where training steps are taken: on the CPU, or on a GPU (feature `gpu`).
//!
//! A [`Backend`] holds splats, the optimiser's state and the frames, and takes whole steps; the
//! trainer picks frames and keeps schedules, corrections of cameras and exposures, and checkpoints.
//! Steps may return before they are done: their statistics are read now and then
//! ([`Backend::stats`]). Both backends compute the same definitions; last digits differ.

mod cpu;
#[cfg(feature = "gpu")]
pub mod gpu;

pub use cpu::CpuBackend;

use crate::density::{DensityRound, DensityStats};
use m4_core::{Exposure, Splats};
use m4_kernels::adam::{
    cpu::{AdamConfig, AdamState},
    nodes::NodeRates,
};
use m4_kernels::loss::cpu::Target;
use m4_kernels::{StepStats, View};

/// Why a backend cannot continue, in its own words.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct BackendError(pub String);

/// Makes a backend; trial steps take one of their own.
pub type BackendMaker<'a> = &'a dyn Fn() -> Result<Box<dyn Backend>, BackendError>;

/// A frame of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepView<'a> {
    /// Its number.
    pub frame: usize,
    /// The view that it is rendered with.
    pub view: &'a View,
    /// Also take the gradient of the camera, for [`StepStats::cameras`].
    pub camera: bool,
    /// Also take the gradient of the frame's [exposure](Backend::set_exposures), for
    /// [`StepStats::exposures`]; nothing for a frame without.
    pub exposure: bool,
}

impl<'a> StepView<'a> {
    /// The gradient of the splats alone.
    pub fn new(frame: usize, view: &'a View) -> Self {
        Self {
            frame,
            view,
            camera: false,
            exposure: false,
        }
    }
}

/// Pixels of a view.
fn pixels(view: &View) -> f32 {
    let lens = &view.camera.intrinsics;
    (lens.width * lens.height) as f32
}

/// What a step depends on besides splats and frames.
#[derive(Debug, Clone, Copy)]
pub struct StepSettings<'a> {
    /// Share of SSIM in the loss, 0..=1.
    pub lambda_ssim: f32,
    /// Weight of [`m4_kernels::cover`], per pixel of a frame; 0 for none.
    pub cover: f32,
    /// One learning rate per column of the splats.
    pub rates: &'a [f32],
    /// Of the nodes that carry bound splats.
    pub nodes: NodeRates,
    /// The optimiser.
    pub adam: AdamConfig,
    /// [`StepStats::psnr`] will be read; a backend may measure it in any case.
    pub psnr: bool,
}

/// Sums over the pixels of some frames, for the least-squares fit of colours: derivatives with
/// respect to the constant coefficient of each colour, `[channel][n]`, 0 where a splat was not
/// seen.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ColourSums {
    /// Of blending weight times image minus target.
    pub residual: [Vec<f32>; 3],
    /// Of blending weights; empty unless requested.
    pub weight: [Vec<f32>; 3],
}

/// Holds splats and takes training steps.
///
/// Every method may fail with what the device says; after that only [`upload`](Self::upload) may be
/// called. `n` rows are those of the splats uploaded last; views have the size of the frames.
pub trait Backend: std::fmt::Debug {
    /// What it is called.
    fn name(&self) -> String;

    /// True if steps are done when they return, so that reading statistics and splats costs no
    /// waiting.
    fn is_synchronous(&self) -> bool;

    /// Takes all frames, of one size: once, before the first splats. Fails with [`BackendError`].
    fn set_frames(&mut self, frames: Vec<Target>) -> Result<(), BackendError>;

    /// Takes the correction of every frame's colours: from here on `matrix rgb + offset` is
    /// compared with the frame. Without a call nothing is corrected. Fails with [`BackendError`].
    fn set_exposures(&mut self, exposures: &[Exposure]) -> Result<(), BackendError>;

    /// Takes splats and the optimiser's state. Fails with [`BackendError`].
    fn upload(&mut self, splats: &Splats, adam: AdamState) -> Result<(), BackendError>;

    /// Gives splats and the optimiser's state back, as they are after all steps; an
    /// [`upload`](Self::upload) comes before the next step. Fails with [`BackendError`].
    fn take(&mut self) -> Result<(Splats, AdamState), BackendError>;

    /// A copy of the splats as they are after all steps. Fails with [`BackendError`].
    fn splats(&mut self) -> Result<Splats, BackendError>;

    /// Takes other values for the same rows; the optimiser's state stays. Fails with
    /// [`BackendError`].
    fn set_splats(&mut self, splats: &Splats) -> Result<(), BackendError>;

    /// Lays splats and the optimiser's state out as [`m4_kernels::morton_order`] does, or nearly
    /// so. Fails with [`BackendError`].
    fn reorder(&mut self) -> Result<(), BackendError>;

    /// Renders and compares each frame, and moves every splat that was seen along the sum of the
    /// gradients. May return before it is done. Fails with [`BackendError`].
    fn step(
        &mut self,
        views: &[StepView<'_>],
        settings: &StepSettings<'_>,
    ) -> Result<(), BackendError>;

    /// Waits for all steps and returns their statistics since the last call. Fails with
    /// [`BackendError`].
    fn stats(&mut self) -> Result<StepStats, BackendError>;

    /// Collects the gradients with respect to the centres of splats in the image from here on,
    /// which take the place of the scores where [`crate::DensityConfig::loss_guided`] is off.
    fn collect_image_gradients(&mut self);

    /// A whole round of density control, as [`crate::density::apply`] of the round's plan does it;
    /// scores of [fixed](m4_kernels::adam::FIXED) splats are 0. Where nothing would be left,
    /// nothing changes. Fails with [`BackendError`].
    fn densify(&mut self, round: &DensityRound<'_>) -> Result<DensityStats, BackendError>;

    /// Sums for the fit of colours over some frames; nothing for [fixed](m4_kernels::adam::FIXED)
    /// splats. Ends where `stop`, which is asked before each frame, says so: the sums are then of
    /// no use. Fails with [`BackendError`].
    fn colour_sums(
        &mut self,
        views: &[(usize, View)],
        with_weight: bool,
        stop: &dyn Fn() -> bool,
    ) -> Result<ColourSums, BackendError>;
}
