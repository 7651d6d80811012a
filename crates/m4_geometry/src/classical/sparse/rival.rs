//! Which of two rigid worlds is the static one.
//!
//! Static is what most tracks agree on. Where a person or an object fills the image, that may be
//! the object: its tracks agree with each other, and the room counts as dynamic. Where many tracks
//! are dynamic these are therefore reconstructed by themselves. If they agree on a rigid world,
//! too, the one that reaches farther out in the image, through all of the clip, is the static one:
//! a room surrounds what moves in it.

use super::SparseError;
use super::bundle::BundleReport;
use super::map::Map;
use super::reconstruct::SparseProblem;
use super::rotation::{Limits, keyframes};
use super::tracking::RawTrack;
use crate::classical::Motion;
use m4_core::advice::MASKS;
use std::collections::BTreeSet;

/// Least ratio of dynamic tracks to static ones for the dynamic ones to be reconstructed.
const MANY: f64 = 0.2;
/// Least ratio of the tracks that a rival explains to those that the first world explains.
const COMPARABLE: f64 = 0.2;
/// How much farther out the static world reaches; below, the two tie.
const FARTHER: f64 = 1.15;
/// Cells of the image along its width, for its extent: dense texture counts no more than sparse.
const CELLS: f64 = 24.0;

/// A refined map, with the motion of each track by it.
pub(super) type Refined = (Map, Vec<Motion>, BundleReport);

/// How sure it is which part of the image is static.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// One world alone.
    Alone,
    /// One of two surrounds the other.
    Decided,
    /// Either of two may be it.
    Tied,
}

impl SparseProblem<'_> {
    /// `first`, or the world that its dynamic tracks agree on if that is the static one; and a
    /// warning where there are two.
    pub(super) fn static_world(
        &mut self,
        first: Refined,
    ) -> Result<(Refined, Verdict, Option<String>), SparseError> {
        let n_static = count(&first.1, Motion::Static);
        let reach = self.reach(&first.1, Motion::Static);
        // What moves within the static world cannot be what surrounds it.
        if (count(&first.1, Motion::Dynamic) as f64) < MANY * n_static as f64
            || FARTHER * self.reach(&first.1, Motion::Dynamic) < reach
        {
            return Ok((first, Verdict::Alone, None));
        }
        let Some((second, limits)) = self.rival(&first)? else {
            return Ok((first, Verdict::Alone, None));
        };
        let n_rival = count(&second.1, Motion::Static);
        if (n_rival as f64) < COMPARABLE * n_static as f64 {
            return Ok((first, Verdict::Alone, None));
        }
        let rival_reach = self.reach(&second.1, Motion::Static);
        if rival_reach > FARTHER * reach {
            self.limits = limits;
            let warning = format!(
                "a rigid object fills much of the image ({n_static} tracks); what surrounds it ({n_rival} tracks) is taken for \
                 static; if that is wrong, {MASKS}"
            );
            return Ok((second, Verdict::Decided, Some(warning)));
        }
        if reach > FARTHER * rival_reach {
            return Ok((first, Verdict::Decided, None));
        }
        let warning = format!(
            "two parts of the image move against each other, and either may be the static one ({n_static} and {n_rival} tracks; \
             the first was taken): {MASKS}"
        );
        Ok((first, Verdict::Tied, Some(warning)))
    }

    /// The map that the dynamic tracks of `first` agree on, refined with all tracks, and the limits
    /// that became as sharp as its errors allow.
    fn rival(
        &mut self,
        (map, motions, _): &Refined,
    ) -> Result<Option<(Refined, Limits)>, SparseError> {
        let pairs = self.tracks.iter().zip(motions);
        let dynamic: Vec<RawTrack> = pairs
            .filter(|(_, motion)| **motion == Motion::Dynamic)
            .map(|(track, _)| track.clone())
            .collect();
        let alone = SparseProblem {
            tracks: dynamic,
            masked: Vec::new(),
            lenses: self.lenses.clone(),
            limits: Limits {
                cauchy_px: Limits::default().cauchy_px,
                ..self.limits
            },
            straight: None,
            warnings: Vec::new(),
            quiet: true,
            ..*self
        };
        let width = alone.size.width;
        let parallax = alone.limits.keyframe_parallax;
        let keys = keyframes(&alone.tracks, alone.frames, width, map.focal, parallax);
        let starts = alone.scan(&alone.start_pairs(&keys, map.focal), &[map.focal])?;
        let Some((grown, _)) = alone.select(&keys, &starts)? else {
            return Ok(None);
        };
        let rival = Map::new(grown.focal, grown.poses, &self.tracks);
        let limits = std::mem::replace(&mut self.limits, alone.limits);
        let refined = self.refine(rival);
        let sharp = std::mem::replace(&mut self.limits, limits);
        refined.map(|refined| Some((refined, sharp)))
    }

    /// How far from the centre of the image the tracks of a kind are, root mean square over the
    /// cells that they are in, mean over all frames, working pixels.
    fn reach(&self, motions: &[Motion], kind: Motion) -> f64 {
        let side = self.size.width as f64 / CELLS;
        let tracks: Vec<&RawTrack> = self
            .tracks
            .iter()
            .zip(motions)
            .filter(|(_, motion)| **motion == kind)
            .map(|(track, _)| track)
            .collect();
        let of_frame = |frame: usize| {
            let cells: BTreeSet<[i64; 2]> = tracks
                .iter()
                .filter_map(|track| track.at(frame))
                .map(|at| at.map(|v| (v / side).floor() as i64))
                .collect();
            let squared = cells.iter().map(|cell| {
                let [x, y] = cell.map(|v| (v as f64 + 0.5) * side);
                x * x + y * y
            });
            (squared.sum::<f64>() / cells.len().max(1) as f64).sqrt()
        };
        (0..self.frames).map(of_frame).sum::<f64>() / self.frames.max(1) as f64
    }
}

fn count(motions: &[Motion], motion: Motion) -> usize {
    motions.iter().filter(|m| **m == motion).count()
}
