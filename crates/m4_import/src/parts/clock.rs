//! When frames were taken.

use crate::core::{ImportOptions, SourceFault};
use m4_scene::Progress;

/// Frames a second where nothing says it.
const DEFAULT_FPS: f64 = 30.0;

/// Checks the frames a second of the options.
pub(crate) fn check(options: &ImportOptions) -> Result<(), SourceFault> {
    match options.fps {
        Some(fps) if !(fps.is_finite() && fps > 0.0) => Err(SourceFault::bad(
            format!("the option fps is {fps}"),
            "give frames a second, above 0",
        )),
        _ => Ok(()),
    }
}

/// Seconds from the first of `frames` frames to the last, at the frames a second of the options, else 30, which is said.
pub(crate) fn duration_s(frames: usize, options: &ImportOptions, progress: &dyn Progress) -> Option<f64> {
    let fps = options.fps.unwrap_or_else(|| {
        progress.warn(&format!(
            "the source does not say how many frames a second it has; {DEFAULT_FPS} were assumed (fps)"
        ));
        DEFAULT_FPS
    });
    Some((frames.max(1) - 1) as f64 / fps)
}

/// Seconds of each frame, in order, as places in frames `0 ..= n - 1`, and the seconds from the first to the last.
pub(crate) fn in_frames(seconds: &[f64]) -> (Vec<f64>, f64) {
    let (first, last) = (
        seconds.first().copied().unwrap_or(0.0),
        seconds.last().copied().unwrap_or(0.0),
    );
    let (n, span) = (seconds.len().max(1) as f64 - 1.0, last - first);
    if span.partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater) {
        return ((0..seconds.len()).map(|i| i as f64).collect(), 0.0);
    }
    let place = |s: &f64| ((s - first) / span * n).clamp(0.0, n);
    (seconds.iter().map(place).collect(), span)
}
