//! The interface of devices that take training steps instead of the CPU.
//!
//! A [`Device`] holds splats, the optimiser's state and the frames, and takes whole steps; the trainer
//! ([`crate::Trainer::use_device`]) picks frames and keeps the schedules. Steps return before they are done: what they
//! found is asked for now and then ([`Device::found`]), never in between. Who is densified and pruned a device may
//! decide by itself ([`Device::densify`]); for one that does not the trainer does.

use crate::{
    config::ErrorRange,
    density::{Rules, Scores},
};
use m4_core::{Exposure, Splats};
use m4_kernels::adam::cpu::{AdamConfig, AdamState};
use m4_kernels::loss::cpu::Target;
use m4_kernels::{CameraGradient, View};

/// Why a device cannot continue, in its own words.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct DeviceError(pub String);

/// Makes a device; trial steps take one of their own.
pub type DeviceMaker<'a> = &'a dyn Fn() -> Result<Box<dyn Device>, DeviceError>;

/// A frame of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DeviceLook<'a> {
    /// Its number.
    pub frame: usize,
    /// The view that it is rendered with.
    pub view: &'a View,
    /// Also take the gradient of the camera, for [`DeviceFound::cameras`].
    pub camera: bool,
    /// Also take the gradient of the frame's exposure, for [`DeviceFound::exposures`].
    pub exposure: bool,
}

/// What a step depends on besides splats and frames.
#[derive(Debug, Clone, Copy)]
pub struct DeviceStep<'a> {
    /// Share of SSIM in the loss, 0..=1.
    pub lambda_ssim: f32,
    /// One learning rate a column of the splats.
    pub rates: &'a [f32],
    /// The optimiser.
    pub adam: AdamConfig,
}

/// What steps found since they were asked the last time.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DeviceFound {
    /// Steps; the rest is anything where there were none.
    pub steps: usize,
    /// Frames looked at: as many a step as a batch has.
    pub looks: usize,
    /// Mean of the absolute differences over channels, pixels and frames; not finite if an image was not.
    pub l1: f64,
    /// Mean structural similarity.
    pub ssim: f64,
    /// PSNR of the frame drawn last, dB, colours clamped to 0..1, at most 100.
    pub psnr: f64,
    /// Splats that a step moved, mean.
    pub touched: f64,
    /// Gradients of the cameras that were asked for, in the order of the looks, each with the number of its frame.
    pub cameras: Vec<(usize, CameraGradient)>,
    /// Gradients of the exposures that were asked for, likewise: rows of the matrix, each followed by its offset.
    pub exposures: Vec<(usize, [f64; 12])>,
    /// Every parameter that a step moved is finite.
    pub splats_are_finite: bool,
}

/// Which errors of a frame count, and for how much.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScoreSettings {
    /// Share of SSIM in the loss that weights a frame for pruning.
    pub lambda_ssim: f32,
    /// As [`crate::DensityConfig::error_threshold`].
    pub threshold: f32,
    /// As [`crate::DensityConfig::error_range`].
    pub range: ErrorRange,
}

/// Sums over the pixels of some frames, for the least-squares fit of colours: derivatives with respect to the constant
/// coefficient of each colour, `[channel][n]`, 0 where a splat was not seen.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ColourGradient {
    /// Of blending weight times image minus target.
    pub residual: [Vec<f32>; 3],
    /// Of blending weights; empty unless they were asked for.
    pub weight: [Vec<f32>; 3],
    /// Sum of squared differences between images and targets, over channels and pixels.
    pub squares: f64,
}

/// A round of density control.
#[derive(Debug, Clone, Copy)]
pub struct DeviceRound<'a> {
    /// Frames that say who is wrong; none where nothing is due that asks for scores.
    pub looks: &'a [(usize, View)],
    /// How errors count.
    pub scores: ScoreSettings,
    /// The plan follows from these: [`Rules::plan`] says how. Halves are never drawn at random.
    pub rules: Rules<'a>,
}

/// What a round of density control did on a device.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DensifyStats {
    /// Splats that were cloned.
    pub cloned: usize,
    /// Splats that were split.
    pub split: usize,
    /// Splats that were pruned.
    pub pruned: usize,
    /// Static splats now.
    pub n_static: usize,
    /// Dynamic splats now.
    pub n_dynamic: usize,
}

impl DensifyStats {
    /// True when the splats are what they were.
    #[must_use]
    pub fn changes_nothing(&self) -> bool {
        self.cloned + self.split + self.pruned == 0
    }
}

/// What becomes of the splats on a device: where each row comes from, and those that are not what they were.
#[derive(Debug, Clone, Copy)]
pub struct DensifyPlan<'a> {
    /// Row `i` of the next splats is row `rows[i]` of those there are; static rows come from static ones, dynamic from
    /// dynamic.
    pub rows: &'a [u32],
    /// Of the next splats, how many are static.
    pub n_static: usize,
    /// Where the optimiser's state starts from nothing, one flag per row.
    pub is_new: &'a [bool],
    /// Rows that are other than the row they come from, static ones first.
    pub changed: &'a [u32],
    /// What they are: as many splats as `changed`, in that order.
    pub values: &'a Splats,
}

/// A place where splats live and steps are taken: a GPU.
///
/// Every method may fail with what the device says; after that nothing on it is relied on. `n` rows are those of the
/// splats uploaded last; views have the size of the frames.
pub trait Device: std::fmt::Debug {
    /// What it is called.
    fn name(&self) -> String;

    /// Takes all frames, of one size: once, before the first splats.
    ///
    /// # Errors
    ///
    /// [`DeviceError`].
    fn set_frames(&mut self, frames: Vec<Target>) -> Result<(), DeviceError>;

    /// Takes the correction of every frame's colours: from here on `matrix rgb + offset` is what is compared with the
    /// frame. Without a call nothing is corrected.
    ///
    /// # Errors
    ///
    /// [`DeviceError`].
    fn set_exposures(&mut self, exposures: &[Exposure]) -> Result<(), DeviceError>;

    /// Takes splats and the optimiser's state.
    ///
    /// # Errors
    ///
    /// [`DeviceError`].
    fn upload(&mut self, splats: &Splats, adam: &AdamState) -> Result<(), DeviceError>;

    /// Goes on with other splats, and the optimiser's state of the rows that they come from.
    ///
    /// # Errors
    ///
    /// [`DeviceError`].
    fn regrow(&mut self, next: &DensifyPlan<'_>) -> Result<(), DeviceError>;

    /// Lays splats and the optimiser's state out as [`m4_kernels::morton_order`] does, or nearly so.
    ///
    /// # Errors
    ///
    /// [`DeviceError`].
    fn reorder(&mut self) -> Result<(), DeviceError>;

    /// The splats as they are after all steps.
    ///
    /// # Errors
    ///
    /// [`DeviceError`].
    fn splats(&mut self) -> Result<Splats, DeviceError>;

    /// The optimiser's state after all steps.
    ///
    /// # Errors
    ///
    /// [`DeviceError`].
    fn adam(&mut self) -> Result<AdamState, DeviceError>;

    /// Draws and compares each frame, and moves every splat that was seen along the sum of the gradients. May return
    /// before it is done.
    ///
    /// # Errors
    ///
    /// [`DeviceError`].
    fn step(&mut self, looks: &[DeviceLook<'_>], settings: &DeviceStep<'_>) -> Result<(), DeviceError>;

    /// Waits for all steps and says what they found since the last call.
    ///
    /// # Errors
    ///
    /// [`DeviceError`].
    fn found(&mut self) -> Result<DeviceFound, DeviceError>;

    /// Both scores of every splat over some frames, as [`crate::density`] defines them.
    ///
    /// # Errors
    ///
    /// [`DeviceError`].
    fn score(&mut self, looks: &[(usize, View)], settings: &ScoreSettings) -> Result<Scores, DeviceError>;

    /// A whole round of density control, as [`crate::density::apply`] of the round's plan does it. Where nothing would be
    /// left, nothing changes. `None` from a device that does not do this: the trainer then asks for scores and decides.
    ///
    /// # Errors
    ///
    /// [`DeviceError`].
    fn densify(&mut self, round: &DeviceRound<'_>) -> Result<Option<DensifyStats>, DeviceError>;

    /// Sums for the fit of colours over some frames.
    ///
    /// # Errors
    ///
    /// [`DeviceError`].
    fn colour_gradient(&mut self, looks: &[(usize, View)], with_weight: bool) -> Result<ColourGradient, DeviceError>;
}
