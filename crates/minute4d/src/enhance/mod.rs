//! Better masks for a capture (Minute4D sec. 3.2): dynamic objects are separated, segmented and tracked through the clip.
//!
//! ```text
//! capture (motion maps, or masks) --m4_geometry::masks, with an object tracker--> capture (masks, instances), report
//! ```
//!
//! [`make`] is `minute4d enhance`, which also follows points in the new masks ([`m4_geometry::tracks`]); the geometry stage does the same to what its
//! front ends find. [`masks`] does the first half on a capture in memory, with any [`VideoSegmenter`]; [`Follower`] is the one that needs no network
//! with a memory.

mod config;
mod plan;
#[cfg(feature = "nets")]
mod sam2;
mod stage;
#[cfg(feature = "nets")]
mod tapip3d;

pub use config::{EnhanceConfig, Tapip3dConfig, Tracker};
pub(crate) use plan::{Before, Plan};
#[cfg(feature = "nets")]
pub use sam2::Sam2Follower;
pub use stage::{EnhanceReport, STAGE, make};
pub(crate) use stage::{apply, moving_share};
#[cfg(feature = "nets")]
pub use tapip3d::Tapip3dTracker;

use crate::error::Category;
use crate::geometry::{self, Segmenter};
use crate::record::write_json;
use crate::{Error, Refusal};
use m4_core::{Capture, CompactIds, CompactMask, Plane, Progress, RgbImage};
use m4_geometry::classical::dense::{self, FlowSource, InverseSearch};
use m4_geometry::masks::{
    Coarse, FlowFollower, FrameSource, ImageError, InstanceError, InstanceReport, RefineInput, RefineSettings,
    RefinedFrame, VideoSegmenter, refine,
};
use m4_geometry::tracks::TrackError;
use m4_io::capture::Split;
use std::borrow::Cow;
use std::path::Path;

/// What was found, beside a capture's list of frames.
pub const REPORT_FILE: &str = "instances.json";

/// The frames of a capture.
struct Frames<'a>(&'a Capture);

impl FrameSource for Frames<'_> {
    fn frames(&self) -> usize {
        self.0.frames.len()
    }

    fn size(&self) -> (usize, usize) {
        self.0.frames.first().map_or((0, 0), |frame| frame.rgb.size())
    }

    fn image(&self, frame: usize) -> Result<Cow<'_, RgbImage>, ImageError> {
        match self.0.frames.get(frame) {
            Some(frame) => Ok(Cow::Borrowed(&frame.rgb)),
            None => Err(format!("the capture has {} frames", self.0.frames.len()).into()),
        }
    }
}

/// The capture with refined masks and maps of instances at the size of its images, and what was found. Everything else stays as it is, the maps of
/// motion, too. The dynamic part roughly is read from the maps of motion where every frame has one, else from the masks. `flow` checks whether maps
/// of motion are the right way round, besides their looks.
///
/// # Errors
///
/// [`Error::Refused`]: a frame says nothing about the dynamic part. [`Error::Enhance`]: the maps are the wrong way round, the settings make
/// no sense, `segmenter` fails or `progress` says to stop.
pub fn masks(
    mut capture: Capture,
    settings: &RefineSettings,
    segmenter: &dyn VideoSegmenter,
    flow: Option<&dyn FlowSource>,
    progress: &dyn Progress,
) -> Result<(Capture, InstanceReport), Error> {
    let coarse = coarse(&capture)?;
    let input = RefineInput { clip: &Frames(&capture), coarse: &coarse, flow };
    let refined = refine(&input, segmenter, settings, progress).map_err(EnhanceError::from)?;
    for (frame, found) in capture.frames.iter_mut().zip(refined.frames) {
        let (mask, ids) = at_size(found, frame.rgb.size());
        frame.mask = Some(mask);
        frame.instances = Some(ids);
    }
    Ok((capture, refined.report))
}

/// Writes a capture, with its report if it has one, into `folder`; see [`m4_io::capture::write()`].
pub(crate) fn write(
    folder: &Path,
    capture: &Capture,
    report: Option<&InstanceReport>,
    progress: &dyn Progress,
) -> Result<(), Error> {
    m4_io::capture::write(folder, capture, Split::Train, progress)?;
    report.map_or(Ok(()), |report| write_json(&folder.join(REPORT_FILE), report))
}

fn coarse(capture: &Capture) -> Result<Coarse<'_>, Refusal> {
    if let Some(maps) = capture.frames.iter().map(|frame| frame.motion.as_ref()).collect() {
        return Ok(Coarse::Motion(maps));
    }
    let masks = capture.frames.iter().enumerate().map(|(i, frame)| {
        frame.mask.as_ref().ok_or_else(|| {
            Refusal::bad_input(format!(
                "frame {i} ({:?}) has neither a motion map nor a mask, so there is nothing to refine; create the capture with masks \
                 (`minute4d geometry`), or import it with them",
                frame.name
            ))
        })
    });
    masks.collect::<Result<_, _>>().map(Coarse::Masks)
}

/// A frame at another size: each pixel that of the working size in which its middle lies.
fn at_size(found: RefinedFrame, (width, height): (usize, usize)) -> (CompactMask, CompactIds) {
    let (w, h) = found.mask.size();
    if (w, h) == (width, height) {
        return (found.mask, found.ids);
    }
    let at = |x: usize, y: usize| ((2 * x + 1) * w / (2 * width), (2 * y + 1) * h / (2 * height));
    let ids = found.ids.to_plane();
    let mask = CompactMask::from_fn(width, height, |x, y| {
        let (x, y) = at(x, y);
        found.mask.at(x, y)
    });
    (mask, CompactIds::from(&Plane::from_fn(width, height, |x, y| ids[at(x, y)])))
}

/// Why masks could not be refined or points not be followed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EnhanceError {
    /// Refinement failed.
    #[error(transparent)]
    Instances(#[from] InstanceError),
    /// Points could not be followed.
    #[error(transparent)]
    Tracks(#[from] TrackError),
}

impl EnhanceError {
    /// Returns the category of the failure.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::Instances(InstanceError::Cancelled { .. }) | Self::Tracks(TrackError::Cancelled { .. }) => {
                Category::Stopped
            }
            Self::Instances(InstanceError::Setting { .. }) | Self::Tracks(TrackError::Setting { .. }) => {
                Category::BadSettings
            }
            Self::Instances(_) | Self::Tracks(_) => Category::BadInput,
        }
    }
}

/// Classical flow, and a segmenter of single images or none.
pub struct Follower {
    segmenter: Option<Box<dyn dense::Segmenter>>,
    weights_hash: Option<String>,
}

impl Follower {
    /// Loads the weights of the requested segmenter.
    ///
    /// # Errors
    ///
    /// [`Error::Network`] if the build has no networks, or the weights are missing or cannot be used.
    pub fn load(segmenter: Segmenter) -> Result<Self, Error> {
        let resolved = geometry::resolve_segmenter(segmenter)?;
        Ok(Self { segmenter: resolved.load()?, weights_hash: resolved.weights_hash().map(str::to_owned) })
    }

    /// Returns the segmenter that propagates masks along flow.
    #[must_use]
    pub fn segmenter(&self) -> FlowFollower<'_> {
        FlowFollower::new(&InverseSearch, self.segmenter.as_deref())
    }

    /// Returns the source of flow, which also checks motion maps.
    #[must_use]
    pub fn flow(&self) -> &dyn FlowSource {
        &InverseSearch
    }

    /// BLAKE3 of the weights, for records.
    #[must_use]
    pub fn weights_hash(&self) -> Option<&str> {
        self.weights_hash.as_deref()
    }
}

#[cfg(test)]
mod tests {
    use super::{Follower, REPORT_FILE, masks, write};
    use crate::geometry::Segmenter;
    use crate::{Category, Error};
    use m4_core::{Camera, Capture, CaptureFrame, CompactMask, Intrinsics, Plane, Silent};
    use m4_geometry::masks::{InstanceReport, RefineSettings};
    use m4_io::capture::{CaptureOptions, Split};

    const SIZE: (usize, usize) = (96, 72);

    /// A patterned square that moves by two pixels per frame in front of a pattern that rests.
    fn on_square(x: usize, y: usize, i: usize) -> bool {
        (10 + 2 * i..34 + 2 * i).contains(&x) && (20..44).contains(&y)
    }

    fn capture(frames: usize) -> Capture {
        let frame = |i: usize| {
            let wave = |x: f32, y: f32| {
                (128.0 + 50.0 * (x * 0.6).sin() * (y * 0.5).cos() + 40.0 * (0.31 * (x + 2.0 * y)).sin()) as u8
            };
            let rgb = Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
                if on_square(x, y, i) {
                    [wave(3.0 + 1.3 * (x - 2 * i) as f32, 0.9 * y as f32), 20, 20]
                } else {
                    [30, wave(x as f32, y as f32), 160]
                }
            });
            CaptureFrame {
                name: format!("{i:05}"),
                camera: Camera { intrinsics: Intrinsics::centred(SIZE.0, SIZE.1, 90.0), c2w: m4_core::Se3::identity() },
                t: i as f64,
                rgb,
                depth: None,
                mask: Some(CompactMask::from_fn(SIZE.0, SIZE.1, |x, y| on_square(x + 2, y + 2, i))),
                motion: None,
                instances: None,
                camera_index: None,
            }
        };
        Capture {
            frames: (0..frames).map(frame).collect(),
            time_frames: frames,
            duration_s: None,
            metric: false,
            tracks: None,
        }
    }

    #[test]
    fn a_capture_gets_numbers_that_are_written_and_read() {
        let follower = Follower::load(Segmenter::None).unwrap();
        let settings = RefineSettings::default();
        let (found, report) =
            masks(capture(12), &settings, &follower.segmenter(), Some(follower.flow()), &Silent).unwrap();
        assert_eq!((report.instances.len(), report.coarse.as_str()), (1, "masks"));
        assert_eq!((report.instances[0].frames, report.instances[0].id), (12, 1));
        for (i, frame) in found.frames.iter().enumerate() {
            let ids = frame.instances.as_ref().unwrap();
            assert_eq!((ids.size(), ids.at(20 + 2 * i, 30), ids.at(90, 65)), (SIZE, 1, 0), "frame {i}");
            assert!(frame.mask.as_ref().unwrap().at(20 + 2 * i, 30));
        }
        let dir = tempfile::tempdir().unwrap();
        write(dir.path(), &found, Some(&report), &Silent).unwrap();
        let again = m4_io::capture::read(dir.path(), Split::Train, &CaptureOptions::default(), &Silent).unwrap();
        for (a, b) in again.frames.iter().zip(&found.frames) {
            assert_eq!((&a.instances, &a.mask), (&b.instances, &b.mask));
        }
        let text = std::fs::read(dir.path().join(REPORT_FILE)).unwrap();
        assert_eq!(serde_json::from_slice::<InstanceReport>(&text).unwrap(), report);
    }

    #[test]
    fn a_frame_that_says_nothing_is_named() {
        let follower = Follower::load(Segmenter::None).unwrap();
        let mut given = capture(4);
        given.frames[2].mask = None;
        let error = masks(given, &RefineSettings::default(), &follower.segmenter(), None, &Silent).unwrap_err();
        assert!(matches!(error, Error::Refused(_)) && error.to_string().contains("00002"), "{error}");
        assert_eq!(error.category(), Category::BadInput);
        let wrong = RefineSettings { every_frames: 0, ..RefineSettings::default() };
        let error = masks(capture(4), &wrong, &follower.segmenter(), None, &Silent).unwrap_err();
        assert_eq!(error.category(), Category::BadSettings);
    }
}
