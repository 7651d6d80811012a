//! Why a network gives no result.

use burn_core::tensor::{DType, Tensor};
use m4_core::RgbImage;
use std::error::Error;

/// What the source of a clip says when it cannot give a frame.
pub type ClipError = Box<dyn Error + Send + Sync>;

/// Gives the image of a frame, by its number in the clip.
pub type ImageReader<'a> = Box<dyn Fn(usize) -> Result<RgbImage, ClipError> + Send + 'a>;

/// Why a network gives no result.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NetError {
    /// The network cannot take this image, prompt or option: what is wrong, and what helps.
    #[error("{0}")]
    Input(String),
    /// No depth can be recovered from the image: why.
    #[error("{0}")]
    NoDepth(&'static str),
    /// The clip cannot give a frame.
    #[error("frame {frame} is not available: {reason}")]
    Frame {
        /// The frame.
        frame: usize,
        /// What the source of the clip says.
        reason: ClipError,
    },
    /// The clip has no such frame.
    #[error("frame {frame} was requested in a clip of {frames} frames, counted from 0")]
    NoSuchFrame {
        /// The frame.
        frame: usize,
        /// Number of frames of the clip.
        frames: usize,
    },
    /// An object without a prompt.
    #[error("object {0} is unknown; prompt it in a frame first")]
    UnknownObject(u32),
    /// The caller cancelled it.
    #[error("tracking was stopped")]
    Cancelled,
    /// The device failed, for example for lack of memory.
    #[error("the device that runs the network failed: {0}")]
    Device(String),
}

/// [`NetError::Input`] with this message.
pub(crate) fn refuse<T>(message: impl Into<String>) -> Result<T, NetError> {
    Err(NetError::Input(message.into()))
}

/// The numbers of a tensor, in 32 bits.
pub(crate) fn numbers<const D: usize>(x: Tensor<D>) -> Result<Vec<f32>, NetError> {
    x.cast(DType::F32)
        .try_into_vec_as()
        .map_err(|error| NetError::Device(error.to_string()))
}
