//! Errors of the GPU backend.

use m4_core::advice::{CPU, GPU_MEMORY};
use thiserror::Error;

/// Why a GPU could not do what it was asked for.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter answers to that.
    #[error(
        "there is no GPU {wanted}; this machine has {found}. Choose one of them, or {}",
        CPU
    )]
    NoAdapter {
        /// The requested value.
        wanted: String,
        /// The available ones.
        found: String,
    },
    /// The adapter is there and does not start.
    #[error("the GPU {name} does not start: {why}. Update its driver, or {}", CPU)]
    NotStarted {
        /// Its name.
        name: String,
        /// The message of the driver.
        why: String,
    },
    /// A buffer is larger than the adapter allows.
    #[error(
        "{what} needs {needed} MB in one buffer; the GPU {name} allows {limit} MB. Choose fewer splats, smaller images, or {}",
        CPU
    )]
    TooLarge {
        /// The contents of the buffer.
        what: &'static str,
        /// Megabytes.
        needed: usize,
        /// Megabytes.
        limit: usize,
        /// The adapter.
        name: String,
    },
    /// Splats, rows or flags do not fit together.
    #[error("the inputs of the GPU are inconsistent: {0}")]
    Shape(#[from] m4_core::ShapeError),
    /// Training was given no frames.
    #[error("there are no frames to train on. Give at least one")]
    NoFrames,
    /// A frame that was asked for is missing.
    #[error("there is no frame {index}: {count} were given, counted from 0")]
    NoFrame {
        /// The index.
        index: usize,
        /// The number of them.
        count: usize,
    },
    /// The frames of a run differ in size, or have no pixels.
    #[error("frame {index} has {} x {} pixels, the first {} x {}. Frames have pixels, and one size", size.0, size.1, first.0, first.1)]
    FrameSize {
        /// Index of the frame.
        index: usize,
        /// Its width and height, pixels.
        size: (usize, usize),
        /// The size of the first.
        first: (usize, usize),
    },
    /// It takes more memory than it may.
    #[error(
        "{doing} needs {needed} MB on the GPU, above the limit of {limit} MB: {parts}. Choose fewer splats or \
         smaller images, {}, or {}",
        GPU_MEMORY,
        CPU
    )]
    OverLimit {
        /// The operation.
        doing: &'static str,
        /// Megabytes.
        needed: u64,
        /// Megabytes.
        limit: u64,
        /// Every part of it, megabytes.
        parts: String,
    },
    /// The device was lost, is out of memory, or a kernel failed.
    #[error(
        "the GPU failed while {doing}: {why}. The scene before that is kept; try fewer splats, or {}",
        CPU
    )]
    Failed {
        /// The operation.
        doing: &'static str,
        /// The message of the runtime.
        why: String,
    },
}
