//! Errors of training.

use m4_core::ShapeError;

/// What went wrong.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    /// The capture has no frame.
    #[error("the capture has no frames; there is nothing to train on")]
    NoFrames,
    /// There is nothing to optimise.
    #[error("there are no splats to train; initialise them from the capture first")]
    NoSplats,
    /// The first splats hold a value that is not a number.
    #[error("the splats to train contain NaN or infinite values; they cannot be used for training")]
    BadSplats,
    /// A setting is out of range.
    #[error("setting `{field}` is {value}, which is not {expected}")]
    BadSetting {
        /// Path of the field within `TrainConfig`.
        field: &'static str,
        /// Its contents.
        value: String,
        /// The allowed values.
        expected: &'static str,
    },
    /// The loss or a parameter stopped being a number.
    #[error(
        "training diverged: {what} is NaN or infinite at iteration {iteration}; the splats of iteration {good_iteration} are kept. Lower \
         the learning rates, or report the capture"
    )]
    Diverged {
        /// What was not finite.
        what: &'static str,
        /// Where.
        iteration: usize,
        /// The iteration whose state the trainer was set back to.
        good_iteration: usize,
    },
    /// The device failed.
    #[error("{why} (at iteration {iteration}; the splats of iteration {good_iteration} are kept)")]
    Device {
        /// Its message.
        why: String,
        /// Where.
        iteration: usize,
        /// The iteration whose splats the trainer was set back to.
        good_iteration: usize,
    },
    /// A saved state lacks a part.
    #[error(
        "the saved training state has no usable {name:?}; it was written by another version or is damaged; train again from the start"
    )]
    BadState {
        /// The tensor at fault.
        name: String,
    },
    /// A saved state belongs to other splats or another capture.
    #[error("the saved training state does not fit: {0}")]
    Shape(#[from] ShapeError),
}
