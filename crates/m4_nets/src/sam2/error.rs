//! What can go wrong.

use std::error::Error;

/// Why there is no mask.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Sam2Error {
    /// The network cannot take images of this side.
    #[error("the side of the image that SAM 2 takes is a multiple of 32 from 64 to 2048, not {0}")]
    Side(usize),
    /// An image has no pixels.
    #[error("{what} has no pixels: it is {width} x {height}")]
    NoPixels {
        /// The kind.
        what: &'static str,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A clip without frames.
    #[error("a clip without frames has no masks")]
    NoFrames,
    /// A frame that the clip has not.
    #[error("frame {frame} was requested in a clip of {frames} frames, counted from 0")]
    NoSuchFrame {
        /// The frame.
        frame: usize,
        /// Frames of the clip.
        frames: usize,
    },
    /// An object that was never shown.
    #[error("object {0} is unknown; prompt it in a frame first")]
    UnknownObject(u32),
    /// There is no object to follow.
    #[error("there is no object to track; prompt one in a frame first")]
    NoObjects,
    /// The prompt is empty.
    #[error("a prompt needs a point, a box or a mask")]
    NothingAsked,
    /// A point or a corner of the prompt is not in the image.
    #[error("the prompt has a point at column {}, row {} of an image of {width} x {height} pixels", at_px[0], at_px[1])]
    Outside {
        /// Column and row, in pixels.
        at_px: [f32; 2],
        /// Columns of the image.
        width: usize,
        /// Rows of the image.
        height: usize,
    },
    /// The box of the prompt ends before it begins.
    #[error("the box of a prompt must be first column and row, then last column and row, not {0:?}")]
    Reversed([f32; 4]),
    /// The prompt's mask has numbers that are infinite or none.
    #[error("the mask of a prompt has NaN or infinite values")]
    NotFinite,
    /// The prompt's mask has another size.
    #[error(
        "the mask of a prompt has {expected} x {expected} pixels, as the logits of a prediction, not {width} x {height}"
    )]
    MaskSize {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Columns and rows that it should have.
        expected: usize,
    },
    /// A frame's image could not be had.
    #[error("the image of frame {frame} is not available: {reason}")]
    Image {
        /// The frame.
        frame: usize,
        /// What its source says.
        reason: Box<dyn Error + Send + Sync>,
    },
    /// The user asked to stop.
    #[error("tracking objects was stopped")]
    Cancelled,
    /// The device failed, for one for lack of memory.
    #[error("the device that computes masks failed: {0}")]
    Device(String),
}
