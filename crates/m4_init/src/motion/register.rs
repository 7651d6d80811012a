//! Two keyframes' moving points brought together.

use super::rigid::Rigid;
use crate::voxel::Centroids;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use m4_math::nalgebra::Vector3;
use rayon::prelude::*;
use std::num::NonZero;

/// How points are registered.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Registration {
    /// A difference of colour of this size counts as much as a displacement of one `reach`.
    pub colour_scale: f32,
    /// Length over which places compete with colours, world units.
    pub reach: f32,
    /// Points that move together as one rigid piece, in the last rounds.
    pub neighbours: usize,
    /// Rounds of match and fit.
    pub rounds: usize,
}

/// Coordinates in which a match is the nearest point: place over reach, colour over its scale.
fn joint(p: [f32; 3], rgb: [f32; 3], by: &Registration) -> [f32; 6] {
    let (a, b) = (1.0 / by.reach, 1.0 / by.colour_scale);
    [p[0] * a, p[1] * a, p[2] * a, rgb[0] * b, rgb[1] * b, rgb[2] * b]
}

/// How many more points move together in the first rounds than in the last.
const FIRST: usize = 8;

/// A motion for every point of `from`, that brings them onto `to`, starting from `guess`.
///
/// Each round matches every displaced point to the nearest of `to` in place and colour; then the motion of a
/// point is the rigid one that fits what the matches of its neighbours ask for, matches of unlike colour or far
/// away weighing little, and points that go where they cannot be `seen` nothing at all. Neighbourhoods shrink from
/// round to round: large pieces first, then their parts.
pub(crate) fn register(
    from: &Centroids,
    to: &Centroids,
    guess: Vec<Rigid>,
    seen: &(dyn Fn([f32; 3]) -> bool + Sync),
    by: &Registration,
) -> Vec<Rigid> {
    let mut motion = guess;
    let targets: Vec<[f32; 6]> = to.xyz.iter().zip(&to.rgb).map(|(p, c)| joint(*p, *c, by)).collect();
    let (Ok(tree), Ok(places), Some(count)) = (
        ImmutableKdTree::<f32, 6>::new_from_slice(&targets),
        ImmutableKdTree::<f32, 3>::new_from_slice(&from.xyz),
        NonZero::new((FIRST * by.neighbours).min(from.xyz.len())),
    ) else {
        return motion;
    };
    if targets.is_empty() {
        return motion;
    }
    let near: Vec<Vec<u32>> = from
        .xyz
        .par_iter()
        .map(|p| {
            let found = places.query(p).nearest_n::<SquaredEuclidean<f32>>(count).execute();
            found.into_iter().map(|n| n.item).collect()
        })
        .collect();
    for round in 0..by.rounds {
        let wanted: Vec<(Vector3<f32>, f32)> = from
            .xyz
            .par_iter()
            .zip(&motion)
            .zip(&from.rgb)
            .map(|((p, m), rgb)| {
                let place = m.apply(*p);
                if !seen(place) {
                    return (Vector3::zeros(), 0.0);
                }
                let n = tree
                    .query(&joint(place, *rgb, by))
                    .nearest_one::<SquaredEuclidean<f32>>()
                    .execute();
                (to.xyz[n.item as usize].into(), 1.0 / (1.0 + n.distance).powi(2))
            })
            .collect();
        // from FIRST to 1 in the first two thirds of the rounds
        let left = 1.0 - (1.5 * round as f32 / by.rounds as f32).min(1.0);
        let pieces = (by.neighbours as f32 * (FIRST as f32).powf(left)) as usize;
        motion = near
            .par_iter()
            .zip(&motion)
            .map(|(near, before)| {
                let pairs = near[..pieces.clamp(1, near.len())].iter().map(|&i| {
                    let (q, w) = wanted[i as usize];
                    (Vector3::from(from.xyz[i as usize]), q, w)
                });
                Rigid::fit(pairs, before.rotation).unwrap_or(*before)
            })
            .collect();
    }
    motion
}
