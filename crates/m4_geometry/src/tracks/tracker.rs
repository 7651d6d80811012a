//! Where points start, and why they could not be followed.

use super::CaptureClip;
use m4_core::{Progress, ShapeError};

/// A point that is to be followed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Query {
    /// The frame in which its place is known.
    pub frame: usize,
    /// Its place there, world units.
    pub xyz: [f32; 3],
}

/// Why there are no tracks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrackError {
    /// A frame cannot be used.
    #[error("points cannot be tracked in frame {frame}: {reason}")]
    Frame {
        /// Which frame.
        frame: usize,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// The tracker failed.
    #[error("{tracker} could not track points: {reason}")]
    Source {
        /// Its name.
        tracker: String,
        /// What went wrong.
        reason: Box<dyn std::error::Error + Send + Sync>,
    },
    /// Another number of values than of frames times queries.
    #[error(transparent)]
    Count(#[from] ShapeError),
    /// A setting out of range.
    #[error("setting {name} is {value}; it must be {expected}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        expected: &'static str,
    },
    /// The user asked to stop.
    #[error("stopped on request while {phase}")]
    Cancelled {
        /// What was going on.
        phase: &'static str,
    },
}

/// Queries on a regular grid of pixels inside the masks (section 3.2 of the paper;
/// docs/spec/optimiser.md 2.6).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QueryGrid {
    /// Points start in every n-th frame, and in the last.
    pub every: usize,
    /// Distance of the points, pixels of the clip.
    pub spacing_px: usize,
    /// Most queries; more are thinned everywhere alike.
    pub most: usize,
}

impl Default for QueryGrid {
    /// Every 10th frame: the paper's choice for DyCheck and DAVIS; for NVIDIA Dynamic it has every
    /// frame.
    fn default() -> Self {
        Self {
            every: 10,
            spacing_px: 4,
            most: 20_000,
        }
    }
}

impl QueryGrid {
    /// For chains of flow: every 4th frame. The specification's queries: every frame to every 10th.
    #[must_use]
    pub fn chains() -> Self {
        Self {
            every: 4,
            ..Self::default()
        }
    }

    /// Rejects unusable values.
    ///
    /// # Errors
    ///
    /// [`TrackError::Setting`] naming the first one.
    pub fn check(&self) -> Result<(), TrackError> {
        let all = [
            ("every", self.every),
            ("spacing_px", self.spacing_px),
            ("most", self.most),
        ];
        match all.into_iter().find(|(_, v)| *v == 0) {
            Some((name, _)) => Err(TrackError::Setting {
                name,
                value: 0.0,
                expected: "at least 1",
            }),
            None => Ok(()),
        }
    }

    /// The frames of a clip of `frames` frames in which points start.
    pub(crate) fn starts(&self, frames: usize) -> impl Iterator<Item = usize> + use<> {
        let every = self.every.max(1);
        (0..frames).filter(move |i| i % every == 0 || i + 1 == frames)
    }

    /// The queries of a clip for `tracker`, of every starting frame in turn.
    ///
    /// # Errors
    ///
    /// [`TrackError`] for an unusable grid, where a frame cannot be read, or the user stops.
    pub fn queries(
        &self,
        tracker: &str,
        clip: &CaptureClip<'_>,
        progress: &dyn Progress,
    ) -> Result<Vec<Query>, TrackError> {
        const PHASE: &str = "choosing points";
        self.check()?;
        let mut queries = Vec::new();
        for frame in self.starts(clip.frames()) {
            if progress.cancelled() {
                return Err(TrackError::Cancelled { phase: PHASE });
            }
            queries.extend(self.of_frame(clip, frame)?);
        }
        let queries = thinned(&queries, self.most);
        let note = format!("{} points for {tracker}", queries.len());
        progress.update(PHASE, 1, 1, &note);
        Ok(queries)
    }

    /// The queries of frame `index`, one per cell in which something moves.
    fn of_frame(&self, clip: &CaptureClip<'_>, index: usize) -> Result<Vec<Query>, TrackError> {
        let frame = clip.read(index)?;
        let (w, h) = frame.rgb.size();
        let (columns, rows) = (w.div_ceil(self.spacing_px), h.div_ceil(self.spacing_px));
        let usable = |x: usize, y: usize| {
            let z = frame.depth[(x, y)];
            frame.moving[(x, y)] > 0 && z.is_finite() && z > 0.0
        };
        let seeds = (0..columns * rows)
            .filter_map(|c| seed((w, h), c % columns, c / columns, self.spacing_px, &usable));
        let query = |at: [f32; 2]| {
            let z = frame.depth[(at[0] as usize, at[1] as usize)];
            let p = frame.camera.unproject(at[0].into(), at[1].into(), z.into());
            Query {
                frame: index,
                xyz: [p.x as f32, p.y as f32, p.z as f32],
            }
        };
        Ok(seeds.map(query).collect())
    }
}

/// At most `most` of them, everywhere alike.
pub(crate) fn thinned<T: Clone>(all: &[T], most: usize) -> Vec<T> {
    let count = all.len().min(most);
    (0..count)
        .map(|k| all[k * all.len() / count].clone())
        .collect()
}

/// The pixel of a cell that is nearest to its middle among the `usable` ones.
pub(crate) fn seed(
    (w, h): (usize, usize),
    column: usize,
    row: usize,
    cell: usize,
    usable: &dyn Fn(usize, usize) -> bool,
) -> Option<[f32; 2]> {
    let (left, top) = (column * cell, row * cell);
    let (mx, my) = (2 * left + cell - 1, 2 * top + cell - 1);
    let pixels =
        (top..(top + cell).min(h)).flat_map(|y| (left..(left + cell).min(w)).map(move |x| (x, y)));
    pixels
        .filter(|&(x, y)| usable(x, y))
        .min_by_key(|&(x, y)| (2 * x).abs_diff(mx).pow(2) + (2 * y).abs_diff(my).pow(2))
        .map(|(x, y)| [x as f32, y as f32])
}

/// The pixel that holds a place of the image.
pub(crate) fn nearest(at: [f32; 2]) -> (usize, usize) {
    (
        (at[0] + 0.5).max(0.0) as usize,
        (at[1] + 0.5).max(0.0) as usize,
    )
}
