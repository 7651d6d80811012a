//! Tracks of a clip, kept so that cameras can be found more than once.

use super::luma::{LONGEST_SIDE_PX, WorkingSize};
use super::priors::Recovered;
use super::reconstruct::{check, check_masks, from_tracks};
use super::tracking::{RawTrack, track};
use super::{SparseConfig, SparseError};
use m4_core::{Mask, Progress, RgbImage};

/// Feature tracks of a clip. Tracking takes most of the time of a reconstruction.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct FeatureTracks {
    tracks: Vec<RawTrack>,
    frames: usize,
    size: [usize; 2],
    working: WorkingSize,
}

/// Tracks corners through a clip.
///
/// # Errors
///
/// [`SparseError`] for frames of different size, settings out of range, and when the user stops the run.
pub fn track_features(
    frames: &[&RgbImage],
    config: &SparseConfig,
    progress: &dyn Progress,
) -> Result<FeatureTracks, SparseError> {
    let (width, height) = check(frames, None, config)?;
    let working = WorkingSize::new(width, height, LONGEST_SIDE_PX);
    Ok(FeatureTracks {
        tracks: track(frames, working, progress)?,
        frames: frames.len(),
        size: [width, height],
        working,
    })
}

impl FeatureTracks {
    /// Estimates cameras and points from the tracks (docs/spec/front-end.md 7.1, items 1 to 5).
    ///
    /// The world is the camera of frame 0, scaled so that the median depth of all points is 1. One focal
    /// length is shared by all frames; the principal point is the image centre and pixels are square, unless
    /// [`SparseConfig::intrinsics`] says otherwise.
    ///
    /// `masks` has one mask per frame, of any size, read at the nearest pixel: tracks that mostly lie where it is above 0 are returned
    /// as dynamic and do not affect the camera.
    ///
    /// Cameras that are static or only rotate are no error: `camera_motion` and the warnings of the result say so.
    ///
    /// # Errors
    ///
    /// [`SparseError`] for clips in which nothing can be tracked or no two frames agree on a rigid scene, for masks of
    /// another number than that of the frames, and when the user stops the run.
    pub fn recover(
        &self,
        masks: Option<&[Mask]>,
        config: &SparseConfig,
        progress: &dyn Progress,
    ) -> Result<Recovered, SparseError> {
        check_masks(masks, self.frames)?;
        from_tracks(
            self.tracks.clone(),
            self.frames,
            self.size,
            self.working,
            masks,
            config,
            progress,
        )
    }
}
