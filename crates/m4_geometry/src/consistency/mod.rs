//! Whether cameras and depth fit the images: what an import is checked with.
//!
//! ```text
//! Capture -> flow of some pairs of frames -> samples: static pixels, where they go, their depth
//!   samples + cameras as given           -> error of reprojection, error of depth
//!   samples + the usual misreadings      -> which of them explains the flow better: Cause
//!   the likeliest one                    -> fitted scale, focal length, principal point -> half-pixel shifts
//! ```
//!
//! Flow knows nothing of poses, so it shows what conventions they were written in. The usual misreadings are cameras whose axes are
//! those of OpenGL, poses that are world to camera, depth in another unit than the poses, and principal points measured from the middle
//! of the first pixel. Two of them together are found, too.
//!
//! A shift of the principal point hardly changes where points are seen while the camera goes sideways; it shows where it turns or goes
//! forward, and is reported only where the samples determine it. Source: docs/spec/front-end.md 6.1, which asks for this
//! report; the fit is Gauss-Newton with Huber's weights, and its standard deviations count a pair of frames as one measurement.

mod causes;
mod fit;
mod fix;
mod reading;
mod report;
mod samples;

#[cfg(test)]
mod tests;

pub use fix::fixed;
pub use report::{Cause, Consistency, Verdict, check};
pub use samples::ConsistencyError;
