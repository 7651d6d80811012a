//! Errors of geometry that the user provides.

use crate::Category;
use m4_io::ErrorKind;
use std::io;
use std::path::PathBuf;

/// Why something that the user gave cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GivenError {
    /// Poses for a front end that finds them itself.
    #[error("the front end megasam estimates the poses itself: omit --poses, or choose another --frontend")]
    CamerasTwice,
    /// There is no such file or folder.
    #[error("there is nothing at {}, which was given with {option}", path.display())]
    Missing {
        /// The option.
        option: &'static str,
        /// The path that was searched.
        path: PathBuf,
    },
    /// A file that cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A lens that is none.
    #[error(
        "the intrinsics {given:?} cannot be used: {reason}; give --intrinsics fx,fy,cx,cy in pixels of the frames, or a JSON file with fl_x, fl_y, cx, cy, w and h"
    )]
    Lens {
        /// The given value.
        given: String,
        /// The fault.
        reason: String,
    },
    /// Another number of files or poses than of frames.
    #[error("{} has {found} {what} for {frames} frames; give one per frame, in the order or with the names of the frames", path.display())]
    Count {
        /// The kind of file.
        what: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The number of them.
        found: usize,
        /// How many frames the clip has.
        frames: usize,
    },
    /// An image of another shape than the frames.
    #[error("{} is {} x {} pixels and the frames are {} x {}: the aspect ratios differ", path.display(), found.0, found.1, frame.0, frame.1)]
    Size {
        /// The file.
        path: PathBuf,
        /// Its width and height.
        found: (usize, usize),
        /// Those of the frames.
        frame: (usize, usize),
    },
    /// A line of a trajectory that is no pose.
    #[error("{}, line {line}: {what}; each line is `t tx ty tz qx qy qz qw`, camera to world", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Its line, from 1.
        line: usize,
        /// The fault.
        what: String,
    },
    /// A trajectory says nothing about the lens.
    #[error("{} has poses without intrinsics; give --intrinsics, or --fov with the horizontal field of view", path.display())]
    NoLens {
        /// The file.
        path: PathBuf,
    },
    /// Depth maps that know nothing.
    #[error("the depth maps in {} are 0 (unknown) everywhere", path.display())]
    NoDepth {
        /// The folder.
        path: PathBuf,
    },
    /// Depth maps and the reconstruction have nothing in common.
    #[error(
        "the depth maps know only {found} of the points that were reconstructed, {needed} are needed to bring both to one scale; give --poses in metres too, or depth maps with fewer holes"
    )]
    NoScale {
        /// Points with a given depth.
        found: usize,
        /// Points needed.
        needed: usize,
    },
}

impl GivenError {
    /// Returns the category of the failure.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::Missing { .. } => Category::NoInput,
            Self::Read { source, .. } => ErrorKind::of_read(source).into(),
            _ => Category::BadInput,
        }
    }
}
