//! The reasons why two captures cannot be compared.

/// Why an estimate could not be compared with the truth.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GeometryError {
    /// One of the captures has no frames.
    #[error("the {which} has no frames; nothing can be compared")]
    Empty {
        /// `"estimate"` or `"truth"`.
        which: &'static str,
    },
    /// Frames could be paired neither by name, nor by order, nor by time.
    #[error(
        "the estimate has {estimate} frames and the ground truth {truth}; names such as {estimate_name:?} and \
         {truth_name:?} do not match, nor do their times (frame {unpaired_name:?} is {distance_frames:.2} \
         frames from the nearest one of the ground truth): compare captures of the same frames of the same video"
    )]
    Unmatched {
        /// Frames of the estimate.
        estimate: usize,
        /// Frames of the truth.
        truth: usize,
        /// A name of the estimate.
        estimate_name: String,
        /// A name of the truth.
        truth_name: String,
        /// The frame whose time is worst.
        unpaired_name: String,
        /// Distance to the nearest true frame, in frames of the truth.
        distance_frames: f64,
    },
    /// A pose, focal length or depth that is no number.
    #[error("{what} of frame {name:?} of the {which} is not a finite number; the file is damaged or the run diverged")]
    NotFinite {
        /// `"estimate"` or `"truth"`.
        which: &'static str,
        /// The frame.
        name: String,
        /// The value that is NaN or infinite.
        what: &'static str,
    },
    /// Two paths have other numbers of poses.
    #[error("the estimate has {estimate} poses and the ground truth {truth}; give the poses of the same frames")]
    Lengths {
        /// Poses of the estimate.
        estimate: usize,
        /// Poses of the truth.
        truth: usize,
    },
    /// A path is static, or the two run against one another.
    #[error(
        "one of the paths has no extent, so there is nothing to align; compare without alignment, or rotations alone"
    )]
    NoExtent,
    /// No two frames lie so far apart.
    #[error(
        "a path of {poses} poses has no two that lie {delta_frames} frames apart; give a delta from 1 to its length"
    )]
    NoPairs {
        /// Poses of each path.
        poses: usize,
        /// Frames between the two of a pair.
        delta_frames: usize,
    },
}
