//! The whole way from frames to the geometry of all of them.

use super::backend::{Backend, confidence_from_residuals};
use super::correspondence::{Correspondence, TrackerError, check_count};
use super::filler::fill;
use super::frontend::Frontend;
use super::keyframes::{FrameInput, Keyframes};
use super::settings::TrackerSettings;
use crate::dba::{Geometry, Grid, Observability, Pinhole, Robust};
use m4_core::{Progress, Se3};

/// Weight of the depth prior of the probe: 1e-5.
const PROBE_ALPHA: f64 = 1e-5;

/// What a clip looks like to the tracker.
#[derive(Debug, Clone, Copy)]
pub struct Clip<'a> {
    /// Size of all planes.
    pub grid: Grid,
    /// First guess.
    pub lens: Pinhole<f64>,
    /// All frames, in order of time.
    pub frames: &'a [FrameInput],
}

/// The geometry of a clip; lists are `[frames]`.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct Tracked {
    /// World to camera, disparities and lens, in the tracker's conventions ([`crate::dba`]). The first camera is the
    /// origin.
    pub geometry: Geometry<f32>,
    /// Probability that each pixel is static, `[frames][height * width]`, 0..=1.
    pub static_confidence: Vec<Vec<f32>>,
    /// What the keyframes could tell.
    pub observability: Observability,
    /// True if the focal length was adjusted.
    pub focal_adjusted: bool,
    /// Frames that were keyframes.
    pub keyframes: Vec<usize>,
    /// Root mean square of the weighted residuals at the end, pixels of the grid.
    pub rms_px: f64,
}

impl Tracked {
    /// Camera to world, the library's convention.
    #[must_use]
    pub fn c2w(&self) -> Vec<Se3<f64>> {
        self.geometry.poses.iter().map(Se3::inverse).collect()
    }
}

/// Front end, observability probe, back end, filler, final adjustment of all frames.
///
/// A clip with fewer keyframes than the warm-up asks for is initialised with those there are.
///
/// # Errors
///
/// [`TrackerError`] for too few frames, frames out of order, failing correspondences, a useless state, or when the
/// user stops.
pub fn track(
    clip: &Clip<'_>,
    source: &mut dyn Correspondence,
    settings: &TrackerSettings,
    progress: &dyn Progress,
) -> Result<Tracked, TrackerError> {
    check(clip)?;
    let total = clip.frames.len();
    let mut frontend = Frontend::new(clip.grid, clip.lens, *settings);
    for (k, frame) in clip.frames.iter().enumerate() {
        if progress.cancelled() {
            return Err(TrackerError::Cancelled);
        }
        frontend.submit(frame, k + 1 == total, source)?;
        let note = format!("{} keyframes", frontend.keyframes.len());
        progress.update("tracking", k + 1, total, &note);
    }
    if !frontend.is_initialised() {
        frontend.initialise(source)?;
    }
    let mut keyframes = frontend.finish(source)?;
    let observability = probe(&keyframes, source, settings, progress)?;
    let focal_adjusted = settings.optimise_focal && observability.focal_is_seen();
    let alpha = observability.prior_alpha(settings.low_parallax_alpha);
    let mut backend = Backend::new(&keyframes, *settings);
    let updates = settings.backend_updates;
    backend.run(&mut keyframes, source, updates, focal_adjusted, alpha, progress)?;
    backend.finish(source)?;

    let poses = fill(&keyframes, clip.frames, settings, source, progress)?;
    let mut all = everything(&keyframes, clip.frames, &poses);
    let mut backend = Backend::new(&all, *settings);
    let report = backend.run(&mut all, source, settings.final_updates, false, alpha, progress)?;
    let mut static_confidence = backend.static_confidence(&all);
    if settings.robust != Robust::None {
        let residuals =
            confidence_from_residuals(&all.geometry, &backend.graph.active, settings.robust, settings.min_depth);
        for (m, r) in static_confidence.iter_mut().flatten().zip(residuals.iter().flatten()) {
            *m *= r;
        }
    }
    backend.finish(source)?;
    Ok(Tracked {
        geometry: all.geometry,
        static_confidence,
        observability,
        focal_adjusted,
        keyframes: keyframes.frame,
        rms_px: report.rms_px,
    })
}

fn check(clip: &Clip<'_>) -> Result<(), TrackerError> {
    check_count(clip.frames.len())?;
    for pair in clip.frames.windows(2) {
        // written so that a NaN fails
        if !(pair[1].time_s > pair[0].time_s && pair[1].frame > pair[0].frame) {
            return Err(TrackerError::Input(format!(
                "frame {} is at {} s, not after the frame before it; give frames in order of time",
                pair[1].frame, pair[1].time_s
            )));
        }
    }
    Ok(())
}

/// Adjusts a copy with next to no prior and measures what it can tell.
fn probe(
    keyframes: &Keyframes,
    source: &mut dyn Correspondence,
    settings: &TrackerSettings,
    progress: &dyn Progress,
) -> Result<Observability, TrackerError> {
    let mut copy = keyframes.clone();
    let mut backend = Backend::new(&copy, *settings);
    backend.run(&mut copy, source, settings.probe_updates, false, Some(PROBE_ALPHA), progress)?;
    let seen = backend.observability(&copy)?;
    backend.finish(source)?;
    Ok(seen)
}

/// All frames: adjusted depth where there is some, otherwise that of the sensor.
fn everything(keyframes: &Keyframes, frames: &[FrameInput], poses: &[Se3<f64>]) -> Keyframes {
    let mut all = Keyframes::new(keyframes.geometry.grid, keyframes.geometry.lens);
    for (input, pose) in frames.iter().zip(poses) {
        let like = all.len().checked_sub(1);
        all.push(input, *pose, like);
        let at = all.len() - 1;
        if let Some(k) = keyframes.frame.iter().position(|&f| f == input.frame) {
            all.geometry.disparity[at].clone_from(&keyframes.geometry.disparity[k]);
            all.damping[at].clone_from(&keyframes.damping[k]);
        }
    }
    all
}
