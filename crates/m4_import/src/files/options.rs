//! Options that several formats read, checked.

use crate::core::{ImportOptions, SourceFault};

/// Largest unit of depth.
const MAX_UNIT: f64 = 1e6;

/// Scene units a step of 16-bit depth: what the options say, else `default`.
pub(crate) fn depth_unit(options: &ImportOptions, default: f64) -> Result<f64, SourceFault> {
    let unit = options.depth_unit.unwrap_or(default);
    if unit > 0.0 && unit <= MAX_UNIT {
        return Ok(unit);
    }
    let what = format!("the option depth_unit is {unit}; scene units a step, above 0, were expected");
    Err(SourceFault::bad(what, "give another"))
}

/// Frames a second, where the options say so.
pub(crate) fn fps(options: &ImportOptions) -> Result<Option<f64>, SourceFault> {
    match options.fps {
        Some(fps) if !(fps.is_finite() && fps > 0.0) => {
            let what = format!("the option fps is {fps}; frames a second, above 0, were expected");
            Err(SourceFault::bad(what, "give another"))
        }
        fps => Ok(fps),
    }
}
