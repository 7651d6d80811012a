//! Errors of networks for optical flow.

/// Why there is no flow.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FlowError {
    /// The images differ in size.
    #[error("flow needs two images of one size, these have {} x {} and {} x {} pixels", a.0, a.1, b.0, b.1)]
    Sizes {
        /// Width and height of the first.
        a: (usize, usize),
        /// Width and height of the second.
        b: (usize, usize),
    },
    /// An image has no pixels.
    #[error("flow needs images with pixels")]
    Empty,
    /// A network that improves its flow step by step was given no step.
    #[error("flow needs at least one iteration; 22 are usual")]
    NoIterations,
    /// The flow to start from is not of these images.
    #[error(
        "the flow to start from has {} x {} pixels ({numbers} numbers), these images need {} x {}: start from that of \
         another pair of images of the same size",
        found.0, found.1, needed.0, needed.1
    )]
    Start {
        /// Its width and height.
        found: (usize, usize),
        /// The fewer of its numbers to the right and down.
        numbers: usize,
        /// Width and height of an eighth of the padded images.
        needed: (usize, usize),
    },
    /// The device failed, for one for lack of memory.
    #[error("the device that computes flow failed: {0}")]
    Device(String),
}

/// # Errors
///
/// [`FlowError::Sizes`] unless both are one size.
pub(crate) fn same_size(a: (usize, usize), b: (usize, usize)) -> Result<(), FlowError> {
    if a == b { Ok(()) } else { Err(FlowError::Sizes { a, b }) }
}
