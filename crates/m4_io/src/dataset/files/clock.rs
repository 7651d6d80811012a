//! The times of frames.

use crate::Fault;
use crate::dataset::ImportOptions;
use m4_core::Progress;

/// Frames per second where nothing says it.
pub(crate) const DEFAULT_FPS: f64 = 30.0;

/// Frames per second of the options, checked.
pub(crate) fn fps(options: &ImportOptions) -> Result<Option<f64>, Fault> {
    match options.fps {
        Some(fps) if !(fps.is_finite() && fps > 0.0) => {
            let what = format!("the option fps is {fps}; frames per second, above 0, were expected");
            Err(Fault::bad(what, "give another"))
        }
        fps => Ok(fps),
    }
}

/// Seconds from the first of `frames` frames to the last, at the frames per second of the options, else 30 with a warning.
pub(crate) fn duration_s(frames: usize, options: &ImportOptions, progress: &dyn Progress) -> Option<f64> {
    let fps = options.fps.unwrap_or_else(|| {
        progress.warn(&format!(
            "the source does not state its frame rate; {DEFAULT_FPS} frames per second are assumed (fps)"
        ));
        DEFAULT_FPS
    });
    Some((frames.max(1) - 1) as f64 / fps)
}

/// The same of a clip whose last frame is at `last_s` seconds, where it is known and the options do not say otherwise.
pub(crate) fn duration_of(
    last_s: Option<f64>,
    frames: usize,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Option<f64> {
    match last_s {
        Some(last) if options.fps.is_none() => Some(last),
        _ => duration_s(frames, options, progress),
    }
}

/// Moments of each frame, in order and of any unit, as places in frames `0 ..= n - 1`, and the time from the first to the last.
pub(crate) fn in_frames(moments: &[f64]) -> (Vec<f64>, f64) {
    let (first, last) = (moments.first().copied().unwrap_or(0.0), moments.last().copied().unwrap_or(0.0));
    let (n, span) = (moments.len().max(1) as f64 - 1.0, last - first);
    let passes = span > 0.0;
    if !passes {
        return ((0..moments.len()).map(|i| i as f64).collect(), 0.0);
    }
    let place = |s: &f64| ((s - first) / span * n).clamp(0.0, n);
    (moments.iter().map(place).collect(), span)
}
