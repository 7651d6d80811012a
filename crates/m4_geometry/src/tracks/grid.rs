//! Where points start.

use super::clip::read_checked;
use super::{PosedClip, Query, TrackError, TrackedPoints};
use m4_core::Progress;

/// Queries on a regular grid of pixels inside the masks (section 3.2 of the paper; docs/spec/optimiser.md 2.6).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QueryGrid {
    /// Points start in every n-th frame, and in the last.
    pub every: usize,
    /// Distance of the points, pixels of the clip.
    pub spacing_px: usize,
    /// Most queries; more are thinned everywhere alike.
    pub most: usize,
    /// 1: all queries at once (the paper). More: the frames in which points start are dealt out to this many rounds, and from the
    /// second on no query starts in a cell that a visible track passes.
    pub rounds: usize,
}

impl Default for QueryGrid {
    /// Every 10th frame: the paper's choice for DyCheck and DAVIS; for NVIDIA Dynamic it has every frame.
    fn default() -> Self {
        Self {
            every: 10,
            spacing_px: 4,
            most: 20_000,
            rounds: 1,
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
            ("rounds", self.rounds),
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

    /// The queries of frame `frame` in cells that `followed` does not pass.
    fn queries(
        &self,
        clip: &dyn PosedClip,
        index: usize,
        followed: Option<&TrackedPoints>,
    ) -> Result<Vec<Query>, TrackError> {
        let frame = read_checked(clip, index)?;
        let (w, h) = frame.rgb.size();
        let columns = w.div_ceil(self.spacing_px);
        let mut taken = vec![false; columns * h.div_ceil(self.spacing_px)];
        if let Some(TrackedPoints { tracks, .. }) = followed {
            let seen = (0..tracks.count()).filter(|k| tracks.visible()[index * tracks.count() + k]);
            for p in seen.filter_map(|k| tracks.place(index, k)) {
                let ([u, v], z) = frame.camera.project(&p.map(f64::from).into());
                if z > 0.0 && u > -0.5 && v > -0.5 && u < w as f64 - 0.5 && v < h as f64 - 0.5 {
                    let (x, y) = nearest([u as f32, v as f32]);
                    taken[y.min(h - 1) / self.spacing_px * columns + x.min(w - 1) / self.spacing_px] = true;
                }
            }
        }
        let usable = |x: usize, y: usize| {
            let z = frame.depth[(x, y)];
            frame.moving[(x, y)] > 0 && z.is_finite() && z > 0.0
        };
        let free = (0..taken.len()).filter(|&c| !taken[c]);
        let seeds = free.filter_map(|c| seed((w, h), c % columns, c / columns, self.spacing_px, &usable));
        let query = |at: [f32; 2]| {
            let z = frame.depth[(at[0] as usize, at[1] as usize)];
            Query::at_pixel(index, &frame.camera, at, z)
        };
        Ok(seeds.map(query).collect())
    }

    /// Everything that moves, followed by `follow`.
    pub(super) fn follow_in_rounds(
        &self,
        tracker: &str,
        clip: &dyn PosedClip,
        progress: &dyn Progress,
        follow: &dyn Fn(&[Query]) -> Result<TrackedPoints, TrackError>,
    ) -> Result<TrackedPoints, TrackError> {
        self.check()?;
        let starts: Vec<usize> = self.starts(clip.frames()).collect();
        let rounds = self.rounds.min(starts.len()).max(1);
        let mut followed: Option<TrackedPoints> = None;
        let mut left = self.most;
        for round in 0..rounds {
            let mut queries = Vec::new();
            for &frame in starts.iter().skip(round).step_by(rounds) {
                if progress.cancelled() {
                    let phase = "choosing points";
                    return Err(TrackError::Cancelled { phase });
                }
                queries.extend(self.queries(clip, frame, followed.as_ref())?);
            }
            // Later rounds are to have their share.
            let queries = thinned(&queries, if round + 1 == rounds { left } else { left.div_ceil(2) });
            left -= queries.len();
            let note = format!("{} points for {tracker}", queries.len());
            progress.update("choosing points", round + 1, rounds, &note);
            if queries.is_empty() && (followed.is_some() || round + 1 < rounds) {
                continue;
            }
            let more = follow(&queries)?;
            followed = Some(match followed {
                Some(before) => before.joined(more)?,
                None => more,
            });
        }
        match followed {
            Some(followed) => Ok(followed),
            None => follow(&[]),
        }
    }
}

/// At most `most` of them, everywhere alike.
pub(crate) fn thinned<T: Clone>(all: &[T], most: usize) -> Vec<T> {
    let count = all.len().min(most);
    (0..count).map(|k| all[k * all.len() / count].clone()).collect()
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
    let pixels = (top..(top + cell).min(h)).flat_map(|y| (left..(left + cell).min(w)).map(move |x| (x, y)));
    pixels
        .filter(|&(x, y)| usable(x, y))
        .min_by_key(|&(x, y)| (2 * x).abs_diff(mx).pow(2) + (2 * y).abs_diff(my).pow(2))
        .map(|(x, y)| [x as f32, y as f32])
}

/// The pixel that holds a place of the image.
pub(crate) fn nearest(at: [f32; 2]) -> (usize, usize) {
    ((at[0] + 0.5).max(0.0) as usize, (at[1] + 0.5).max(0.0) as usize)
}
