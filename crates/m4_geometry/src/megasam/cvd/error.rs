//! What consistent video depth cannot work with.

/// Why pairs could not be stored or read back.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PairError {
    /// A pair of a frame with itself, or one that was there already.
    #[error("the pair ({source_frame}, {target_frame}) is {what}; give each pair of different frames once")]
    Pair {
        /// The frame that the flow starts in.
        source_frame: usize,
        /// The frame that it leads to.
        target_frame: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// Planes of another size.
    #[error("{what} has {found} values where {expected} were expected; all frames must have one size")]
    Length {
        /// Which plane.
        what: &'static str,
        /// Its values.
        found: usize,
        /// Width times height.
        expected: usize,
    },
    /// The temporary file of pairs that do not fit into memory.
    #[error(
        "the temporary file of flow fields cannot be used ({0}); free space in the temporary folder or allow more memory"
    )]
    Spill(#[from] std::io::Error),
}

/// Why no consistent depth could be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CvdError {
    /// Inputs that do not belong together.
    #[error("{what} has {found} entries where {expected} were expected; give one for each frame, all of one size")]
    Count {
        /// Which input.
        what: &'static str,
        /// Its entries.
        found: usize,
        /// What the other inputs ask for.
        expected: usize,
    },
    /// Images that are too small.
    #[error("frames of {}x{} are too small; at least {minimum} px per side are needed", size.0, size.1)]
    Size {
        /// Width and height.
        size: (usize, usize),
        /// Least side, pixels.
        minimum: usize,
    },
    /// A pair that names a frame which is not there.
    #[error("pair {pair} is of frames {source_frame} and {target_frame}, but there are {frames} frames")]
    Frame {
        /// Which pair.
        pair: usize,
        /// The frame that the flow starts in.
        source_frame: usize,
        /// The frame that it leads to.
        target_frame: usize,
        /// Frames there are.
        frames: usize,
    },
    /// A number that cannot be worked with.
    #[error("{what} of frame {frame} holds {value}; it must be {range}")]
    Value {
        /// Which input.
        what: &'static str,
        /// Which frame.
        frame: usize,
        /// The number.
        value: f64,
        /// What is allowed.
        range: &'static str,
    },
    /// No pixel of any pair is usable.
    #[error("no pixel of the {pairs} pairs has a consistent flow; there is nothing to make the depth consistent with")]
    NoFlow {
        /// Pairs given.
        pairs: usize,
    },
    /// Pairs could not be read.
    #[error(transparent)]
    Pairs(#[from] PairError),
    /// The user asked to stop.
    #[error("stopped on request in stage {stage} after {step} steps")]
    Cancelled {
        /// 1 or 2.
        stage: usize,
        /// Steps of that stage that were finished.
        step: usize,
    },
}
