//! From a video to a capture on disk.

use super::between::Between;
use super::classical;
use super::clip::Clip;
#[cfg(feature = "nets")]
use super::frontend::Cameras;
use super::methods::Context;
use crate::record::GeometrySummary;
use crate::{Error, enhance};
use m4_core::Capture;
use std::path::Path;

/// Reads the clip, finds its geometry, refines masks and tracks points as planned, and writes the capture into `folder`.
///
/// # Errors
///
/// [`Error`]: the clip cannot be read, nothing can be reconstructed, the folder cannot be written, or the user stops.
pub(super) fn compute(input: &Path, folder: &Path, context: &Context<'_>) -> Result<GeometrySummary, Error> {
    let observer = context.observer();
    let between = Between::of(context.settings, &context.methods.frontend);
    let clip = Clip::read(input, between, context)?;
    let (capture, mut found) = reconstruct(clip, context)?;
    let capture = between.keep(capture, observer)?;
    found.frames = capture.frames.len();
    let plan = &context.methods.enhance;
    let (capture, report) = enhance::apply(capture, plan, context.settings, &context.methods.device, context.steps)?;
    enhance::write(folder, &capture, report.as_ref(), observer)?;
    found.networks.extend(plan.used.iter().cloned());
    if report.is_some() {
        plan.segmenter().clone_into(&mut found.segmenter);
        found.moving_share = enhance::moving_share(&capture).unwrap_or(0.0);
    }
    if let Some(tracks) = &capture.tracks {
        found.moving_tracks = tracks.count();
    }
    Ok(found)
}

fn reconstruct(clip: Clip, context: &Context<'_>) -> Result<(Capture, GeometrySummary), Error> {
    #[cfg(feature = "nets")]
    if context.methods.frontend.cameras == Cameras::Megasam {
        return super::megasam::compute(clip, context);
    }
    classical::compute(clip, context)
}
