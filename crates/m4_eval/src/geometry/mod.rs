//! Scores reconstructed cameras, depth and motion masks against ground truth.
//!
//! A reconstruction from a video alone has its own origin, axes and unit, so cameras are compared
//! after the similarity that fits them best (Umeyama 1991, over camera centres), rotations after
//! the rotation that fits them best (chordal mean, over camera axes: a nearly straight path leaves
//! the rotation about itself undetermined), and depth after one factor for the whole clip (the
//! median of truth / estimate over static pixels). [`evaluate`] does all of it, and splits the
//! error of dynamic depth by object and cause ([`ObjectError`]); [`absolute_error`] and
//! [`relative_error`] are the figures of the program `evo`, which papers on SLAM print.

mod depth;
mod evo;
mod matching;
mod objects;
mod report;
mod substitute;
mod trajectory;

pub use evo::{
    AbsoluteError, ErrorStatistics, PathAlignment, RelativeError, absolute_error, relative_error,
};
pub use matching::Matching;
pub use objects::ObjectError;
pub use report::{DepthError, GeometryError, GeometryReport, MaskScore, evaluate};
pub use substitute::{Substitutes, Substitution};
pub use trajectory::{RotationError, TrajectoryError, placement};
