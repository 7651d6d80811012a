//! Tracks of a clip, kept so that cameras can be found more than once.

use super::known::{Known, Recovered};
use super::luma::{LONGEST_SIDE_PX, WorkingSize};
use super::reconstruct::{check, check_masks, from_tracks};
use super::tracking::{RawTrack, track};
use super::{SparseConfig, SparseError, Work};
use m4_core::{Progress, RgbImage};

/// What was followed through a clip. Following takes most of the time of a reconstruction.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct Followed {
    tracks: Vec<RawTrack>,
    frames: usize,
    size: [usize; 2],
    working: WorkingSize,
}

/// Follows corners through a clip.
///
/// # Errors
///
/// As [`super::recover`], but for what concerns cameras.
pub fn follow(frames: &[&RgbImage], config: &SparseConfig, progress: &dyn Progress) -> Result<Followed, SparseError> {
    let (width, height) = check(frames, &Known::default(), config)?;
    let working = WorkingSize::new(width, height, LONGEST_SIDE_PX);
    Ok(Followed {
        tracks: track(frames, working, progress)?,
        frames: frames.len(),
        size: [width, height],
        working,
    })
}

impl Followed {
    /// As [`super::recover`] of the same frames with the same settings.
    ///
    /// # Errors
    ///
    /// As [`super::recover`].
    pub fn recover(&self, known: &Known<'_>, config: &SparseConfig, work: &Work<'_>) -> Result<Recovered, SparseError> {
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
