//! Tracks of a clip, kept so that cameras can be found more than once.

use super::luma::{LONGEST_SIDE_PX, WorkingSize};
use super::priors::{Priors, Recovered};
use super::reconstruct::{check, check_masks, from_tracks};
use super::tracking::{RawTrack, track};
use super::{SparseConfig, SparseError, Work};
use m4_core::{Progress, RgbImage};

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
/// As [`super::recover`], but for what concerns cameras.
pub fn track_features(
    frames: &[&RgbImage],
    config: &SparseConfig,
    progress: &dyn Progress,
) -> Result<FeatureTracks, SparseError> {
    let (width, height) = check(frames, &Priors::default(), config)?;
    let working = WorkingSize::new(width, height, LONGEST_SIDE_PX);
    Ok(FeatureTracks {
        tracks: track(frames, working, progress)?,
        frames: frames.len(),
        size: [width, height],
        working,
    })
}

impl FeatureTracks {
    /// As [`super::recover`] of the same frames with the same settings.
    ///
    /// # Errors
    ///
    /// As [`super::recover`].
    pub fn recover(
        &self,
        known: &Priors<'_>,
        config: &SparseConfig,
        work: &Work<'_>,
    ) -> Result<Recovered, SparseError> {
        check_masks(known, self.frames)?;
        from_tracks(
            self.tracks.clone(),
            self.frames,
            self.size,
            self.working,
            known,
            config,
            work,
        )
    }
}
