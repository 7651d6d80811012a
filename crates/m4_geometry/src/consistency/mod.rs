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

mod reading;
mod samples;

#[cfg(test)]
mod tests;

use crate::classical::dense::InverseSearch;
use m4_core::{Camera, Capture, Progress, median, quantile};
pub use reading::fixed;
use reading::{Reading, depth_errors, errors, likeliest, masks_inverted};
pub use samples::ConsistencyError;
use samples::{Pair, Samples, samples};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Fewest samples that say anything.
const LEAST_SAMPLES: usize = 200;
/// Flow shorter than this says nothing of poses, pixels of an image 640 wide.
const LEAST_FLOW_PX: f64 = 0.5;
/// Up to here the error is what flow itself has; beyond the second the cameras do not belong to the images. Pixels of an image 640 wide.
const GOOD_PX: f64 = 1.0;
const FAIR_PX: f64 = 3.0;
/// The same for depth.
const GOOD_DEPTH: f64 = 0.05;
const FAIR_DEPTH: f64 = 0.15;

/// What was misread.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "cause")]
#[non_exhaustive]
pub enum Cause {
    /// The masks are inverted: static regions are marked as dynamic.
    Masks,
    /// The poses are world to camera.
    Inverted,
    /// The cameras' y and z axes point the other way: OpenGL's where OpenCV's were taken, or the other way round.
    Axes,
    /// Depth is in another unit than the poses.
    DepthUnit {
        /// What depth has to be multiplied by.
        factor: f64,
    },
    /// The focal length is another.
    Focal {
        /// What it has to be multiplied by.
        factor: f64,
    },
    /// Principal points are measured from the middle of the first pixel where its corner was taken, or the other way round.
    PixelCentre {
        /// What has to be added to them, pixels.
        shift_px: [f64; 2],
    },
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Masks => f.write_str(
                "the masks look inverted (pixels marked dynamic fit the cameras, pixels marked static do not)",
            ),
            Self::Inverted => f.write_str("the poses look inverted (world to camera taken for camera to world)"),
            Self::Axes => {
                f.write_str("the cameras' axes look turned (OpenGL's y up, z back for OpenCV's y down, z forward)")
            }
            Self::DepthUnit { factor } => {
                write!(f, "depth looks to be in another unit than the poses (times {factor:.4})")
            }
            Self::Focal { factor } => write!(f, "the focal length looks wrong (times {factor:.4})"),
            Self::PixelCentre { shift_px: [x, y] } => write!(
                f,
                "principal points look shifted by half a pixel (add {x:+.1}, {y:+.1}: middle of the first pixel for its corner)"
            ),
        }
    }
}

/// How well cameras and depth fit the images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// As well as flow can tell.
    Good,
    /// With errors that will be seen.
    Fair,
    /// Not.
    Bad,
    /// The camera hardly moves, or too little of the images can be followed.
    Unknown,
}

impl Verdict {
    /// As in a sentence.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Fair => "fair",
            Self::Bad => "bad",
            Self::Unknown => "unknown",
        }
    }
}

/// What flow says of a capture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Consistency {
    /// Pairs of frames between which flow was measured.
    pub pairs: usize,
    /// Static pixels that were followed.
    pub samples: usize,
    /// Their median way, pixels of the images.
    pub flow_px: f64,
    /// From where cameras and depth say a pixel goes to where flow says it goes, median, pixels of the images; without depth the distance from the
    /// epipolar line. `None` where most points lie behind a camera.
    pub error_px: Option<f64>,
    /// The same, what nine of ten are below.
    pub error_p90_px: Option<f64>,
    /// By what share depth of one frame differs from that of another at the same point, median; `None` without depth, or behind a camera.
    pub depth_error: Option<f64>,
    /// What of this is good.
    pub verdict: Verdict,
    /// What explains it, if it can be told.
    pub causes: Vec<Cause>,
    /// `error_px` and `depth_error` with the causes put right.
    pub fixed: Option<[Option<f64>; 2]>,
}

/// Compares the cameras and depth of a capture with the flow of its images.
///
/// # Errors
///
/// [`ConsistencyError`].
pub fn check(capture: &Capture, _: &InverseSearch, progress: &dyn Progress) -> Result<Consistency, ConsistencyError> {
    let found = samples(capture, progress)?;
    let cameras: Vec<Camera> = capture.frames.iter().map(|f| f.camera).collect();
    let mut report = of_pairs(capture, &cameras, &found.resting);
    if masks_inverted(&cameras, &found) {
        let Samples { moving, .. } = &found;
        let turned = of_pairs(capture, &cameras, moving);
        report.verdict = Verdict::Bad;
        report.fixed = Some(turned.fixed.unwrap_or([turned.error_px, turned.depth_error]));
        report.causes = [vec![Cause::Masks], turned.causes].concat();
    }
    Ok(report)
}

/// The report of one set of samples.
fn of_pairs(capture: &Capture, cameras: &[Camera], pairs: &[Pair]) -> Consistency {
    let total: usize = pairs.iter().map(|p| p.samples.len()).sum();
    let mut lengths: Vec<f64> = pairs
        .iter()
        .flat_map(|p| &p.samples)
        .map(|s| (s.to_px[0] - s.from_px[0]).hypot(s.to_px[1] - s.from_px[1]))
        .collect();
    let flow_px = median(&mut lengths).unwrap_or(0.0);
    let width = capture.frames.first().map_or(640, |f| f.rgb.width().max(f.rgb.height()));
    let unit = width as f64 / 640.0;
    let (error, depth) = figures(&Reading::GIVEN, cameras, pairs);
    let mut report = Consistency {
        pairs: pairs.len(),
        samples: total,
        flow_px,
        error_px: error[0],
        error_p90_px: error[1],
        depth_error: depth,
        verdict: Verdict::Unknown,
        causes: Vec::new(),
        fixed: None,
    };
    if total < LEAST_SAMPLES || flow_px < LEAST_FLOW_PX * unit {
        return report;
    }
    let within = |px: f64, share: f64| {
        report.error_px.is_some_and(|e| e <= px * unit) && (report.depth_error.is_none_or(|d| d <= share))
    };
    report.verdict = if within(GOOD_PX, GOOD_DEPTH) {
        Verdict::Good
    } else if within(FAIR_PX, FAIR_DEPTH) {
        Verdict::Fair
    } else {
        Verdict::Bad
    };
    let (reading, causes) = likeliest(cameras, pairs);
    if !causes.is_empty() {
        let (error, depth) = figures(&reading, cameras, pairs);
        report.fixed = Some([error[0], depth]);
        report.causes = causes;
    }
    report
}

/// Median and nine tenths of the errors, and the median error of depth; `None` where not finite.
fn figures(reading: &Reading, cameras: &[Camera], pairs: &[Pair]) -> ([Option<f64>; 2], Option<f64>) {
    let finite = |v: Option<f64>| v.filter(|v| v.is_finite());
    let mut errors = errors(reading, cameras, pairs);
    let error = [0.5, 0.9].map(|q| finite(quantile(&mut errors, q)));
    (error, finite(median(&mut depth_errors(reading, cameras, pairs))))
}
