//! Motion according to the capture's tracks.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use m4_core::{Tracks, nalgebra::Vector3};
use rayon::prelude::*;
use std::num::NonZero;

/// Tracks that are asked about one place.
const NEAREST: NonZero<usize> = NonZero::new(6).unwrap();
/// Tracks of another body are farther away than this many times what tracks lie apart.
const SPACING: f32 = 3.0;

/// What the tracks of a capture know about its keyframes.
#[derive(Clone, Copy)]
pub(crate) struct Ways<'a> {
    pub tracks: &'a Tracks,
    /// The frame of each keyframe.
    pub frames: &'a [usize],
    /// Tracks this close speak for a place, however densely they lie, world units.
    pub reach: f32,
}

/// What they know about the way from one keyframe to another.
pub(crate) struct Follow {
    tree: ImmutableKdTree<f32, 3>,
    shifts: Vec<[f32; 3]>,
    /// Tracks farther away than this do not speak for a place, world units.
    reach: f32,
}

impl Ways<'_> {
    /// The way from keyframe `from` to keyframe `to`; `None` where no track knows both.
    pub fn between(&self, from: usize, to: usize) -> Option<Follow> {
        let (from, to) = (*self.frames.get(from)?, *self.frames.get(to)?);
        let known = |k: usize| Some((self.tracks.place(from, k)?, self.tracks.place(to, k)?));
        let (places, ends): (Vec<[f32; 3]>, Vec<[f32; 3]>) = (0..self.tracks.count()).filter_map(known).unzip();
        if places.is_empty() {
            return None;
        }
        let shifts = places.iter().zip(&ends).map(|(p, q)| [0, 1, 2].map(|k| q[k] - p[k])).collect();
        let tree = ImmutableKdTree::<f32, 3>::new_from_slice(&places).ok()?;
        let reach = self.reach.max(SPACING * spacing(&tree, &places));
        Some(Follow { tree, shifts, reach })
    }
}

/// The median distance of a place to its nearest neighbour; 0 for a lone one.
fn spacing(tree: &ImmutableKdTree<f32, 3>, places: &[[f32; 3]]) -> f32 {
    const TWO: NonZero<usize> = NonZero::new(2).unwrap();
    let mut squares: Vec<f32> = places
        .par_iter()
        .filter_map(|p| {
            let near = tree.query(p).nearest_n::<SquaredEuclidean<f32>>(TWO).execute();
            near.iter().map(|n| n.distance).max_by(f32::total_cmp).filter(|_| near.len() > 1)
        })
        .collect();
    m4_core::median(&mut squares).map_or(0.0, f32::sqrt)
}

impl Follow {
    /// Where a place went and how much that counts: the shift of those of the nearest tracks that differs least from the others'.
    /// `None` where no track is near.
    pub fn ask(&self, p: [f32; 3]) -> Option<([f32; 3], f32)> {
        let near = self.tree.query(&p).nearest_n::<SquaredEuclidean<f32>>(NEAREST).execute();
        let near = near.into_iter().filter(|n| n.distance <= self.reach * self.reach);
        let near: Vec<(Vector3<f32>, f32)> = near
            .map(|n| {
                let weight = 1.0 / (n.distance.sqrt() + 0.1 * self.reach);
                (self.shifts[n.item as usize].into(), weight)
            })
            .collect();
        let off = |a: &Vector3<f32>| near.iter().map(|(b, w)| w * (a - b).norm()).sum::<f32>();
        let middle = near.iter().map(|(a, _)| (a, off(a))).min_by(|a, b| a.1.total_cmp(&b.1))?.0;
        Some(((Vector3::from(p) + middle).into(), 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::Ways;
    use m4_core::Tracks;

    /// A row of tracks 0.1 apart that move by 1 along x in every frame, but for the third, which is wrong.
    fn row() -> Tracks {
        let place = |t: usize, k: usize| {
            let speed = if k == 2 { -3.0 } else { 1.0 };
            [0.1 * k as f32 + speed * t as f32, 0.0, 0.0]
        };
        let xyz = (0..2).flat_map(|t| (0..8).map(move |k| place(t, k))).collect();
        Tracks::new(2, 8, xyz, vec![true; 16]).unwrap()
    }

    #[test]
    fn one_wrong_track_is_outvoted_and_far_tracks_have_no_weight() {
        let tracks = row();
        let ways = Ways { tracks: &tracks, frames: &[0, 1], reach: 0.05 };
        let follow = ways.between(0, 1).unwrap();
        let (to, weight) = follow.ask([0.2, 0.05, 0.0]).unwrap();
        assert!((to[0] - 1.2).abs() < 1e-6 && to[1] == 0.05 && weight > 0.0, "{to:?}");
        assert_eq!(follow.ask([0.2, 0.5, 0.0]), None);
        let (back, _) = ways.between(1, 0).unwrap().ask([1.5, 0.0, 0.0]).unwrap();
        assert!((back[0] - 0.5).abs() < 1e-6);
        assert!(ways.between(0, 2).is_none());
    }

    #[test]
    fn a_single_track_moves_points_within_reach() {
        let tracks = Tracks::new(2, 1, vec![[0.0; 3], [0.0, 1.0, 0.0]], vec![true; 2]).unwrap();
        let ways = Ways { tracks: &tracks, frames: &[0, 1], reach: 0.5 };
        let follow = ways.between(0, 1).unwrap();
        assert_eq!(follow.ask([0.3, 0.0, 0.0]), Some(([0.3, 1.0, 0.0], 1.0)));
        assert_eq!(follow.ask([0.6, 0.0, 0.0]), None);
    }
}
