//! Registers the dynamic points of two keyframes.

use super::follow::Follow;
use super::look::Look;
use super::rigid::Rigid;
use crate::init::voxel::Centroids;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use m4_core::{CaptureFrame, nalgebra::Vector3};
use rayon::prelude::*;
use std::num::NonZero;

/// The parameters of the registration.
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
    /// Rounds in which the images say where points went.
    pub picture_rounds: usize,
}

/// Spacing of the points that are registered, pixels at the median depth (our rule).
pub(crate) const NODE_PIXELS: f32 = 4.0;
/// [`Registration::reach`], pixels at the median depth (our rule).
pub(crate) const REACH_PIXELS: f32 = 8.0;

impl Registration {
    /// What the first splats are made with (our rules); `reach` in world units. Three rounds of frames: +0.14 dB inside moving
    /// parts, difference of colour after one frame down by a fifth (docs/decisions/0004).
    pub fn with_reach(reach: f32) -> Self {
        Self { colour_scale: 0.1, reach, neighbours: 20, rounds: 15, picture_rounds: 3 }
    }
}

/// Coordinates in which a match is the nearest point: place over reach, colour over its scale.
fn joint(p: [f32; 3], rgb: [f32; 3], by: &Registration) -> [f32; 6] {
    let (a, b) = (1.0 / by.reach, 1.0 / by.colour_scale);
    [p[0] * a, p[1] * a, p[2] * a, rgb[0] * b, rgb[1] * b, rgb[2] * b]
}

/// How many more points move together in the first rounds than in the last.
const FIRST: usize = 8;

/// One keyframe as its neighbours are registered to it.
#[derive(Clone, Copy)]
pub(crate) struct View<'a> {
    /// Points whose motion is looked for.
    pub nodes: &'a Centroids,
    /// Points that nodes of other keyframes are brought onto.
    pub points: &'a Centroids,
    /// Its frame, for a look at the image; `None` to do without.
    pub frame: Option<&'a CaptureFrame>,
    /// Whether it would see a place.
    pub sees: &'a (dyn Fn([f32; 3]) -> bool + Sync),
}

/// A motion for every node of `from`, that brings them onto `to`, starting from `guess`.
///
/// Each round matches every displaced node to the nearest point of `to` in place and colour; then the motion of
/// a node is the rigid one that fits what the matches of its neighbours ask for, matches of unlike colour or far
/// away weighing little, and nodes that go where they cannot be seen nothing at all. Neighbourhoods shrink from
/// round to round: large pieces first, then their parts. Then tracks have their word, `follow`, on nodes that are near any; in the last
/// rounds the images, `looks`, say where nodes went, which is exact to a fraction of a pixel.
pub(crate) fn register(
    from: &View<'_>,
    to: &View<'_>,
    looks: Option<[&Look; 2]>,
    follow: Option<Follow>,
    guess: Vec<Rigid>,
    by: &Registration,
) -> Vec<Rigid> {
    let nodes = from.nodes;
    let mut motion = guess;
    let colours = to.points.xyz.iter().zip(&to.points.rgb);
    let targets: Vec<[f32; 6]> = colours.map(|(p, c)| joint(*p, *c, by)).collect();
    let (Ok(tree), Ok(places), Some(count)) = (
        ImmutableKdTree::<f32, 6>::new_from_slice(&targets),
        ImmutableKdTree::<f32, 3>::new_from_slice(&nodes.xyz),
        NonZero::new((FIRST * by.neighbours).min(nodes.xyz.len())),
    ) else {
        return motion;
    };
    if targets.is_empty() {
        return motion;
    }
    let near: Vec<Vec<u32>> = nodes
        .xyz
        .par_iter()
        .map(|p| {
            let found = places.query(p).nearest_n::<SquaredEuclidean<f32>>(count).execute();
            found.into_iter().map(|n| n.item).collect()
        })
        .collect();
    for round in 0..by.rounds {
        let wanted = wanted(nodes, &motion, |_, place, rgb| {
            let n = tree.query(&joint(place, rgb, by)).nearest_one::<SquaredEuclidean<f32>>().execute();
            let match_ = to.points.xyz[n.item as usize];
            (to.sees)(place).then(|| (match_, 1.0 / (1.0 + n.distance).powi(2)))
        });
        // from FIRST to 1 in the first two thirds of the rounds
        let left = 1.0 - (1.5 * round as f32 / by.rounds as f32).min(1.0);
        let pieces = by.neighbours as f32 * (FIRST as f32).powf(left);
        motion = fitted(nodes, &motion, &near, &wanted, pieces as usize);
    }
    if let Some(follow) = follow {
        let wanted = wanted(nodes, &motion, |p, _, _| follow.ask(p));
        motion = fitted(nodes, &motion, &near, &wanted, by.neighbours);
    }
    if let Some([here, there]) = looks {
        for _ in 0..by.picture_rounds {
            let wanted = wanted(nodes, &motion, |p, place, _| here.follow(there, p, place));
            motion = fitted(nodes, &motion, &near, &wanted, by.neighbours);
        }
    }
    motion
}

/// Where each node should go and how much that weighs, by `ask(node, its place so far, its colour)`.
fn wanted(
    nodes: &Centroids,
    motion: &[Rigid],
    ask: impl Fn([f32; 3], [f32; 3], [f32; 3]) -> Option<([f32; 3], f32)> + Sync,
) -> Vec<(Vector3<f32>, f32)> {
    nodes
        .xyz
        .par_iter()
        .zip(&nodes.rgb)
        .zip(motion)
        .map(|((p, rgb), m)| match ask(*p, m.apply(*p), *rgb) {
            Some((q, weight)) => (q.into(), weight),
            None => (Vector3::zeros(), 0.0),
        })
        .collect()
}

/// The rigid motion of the `pieces` nearest nodes of each; where they say nothing, the one before.
fn fitted(
    nodes: &Centroids,
    motion: &[Rigid],
    near: &[Vec<u32>],
    wanted: &[(Vector3<f32>, f32)],
    pieces: usize,
) -> Vec<Rigid> {
    near.par_iter()
        .zip(motion)
        .map(|(near, before)| {
            let pairs = near[..pieces.clamp(1, near.len())].iter().map(|&i| {
                let (q, w) = wanted[i as usize];
                (Vector3::from(nodes.xyz[i as usize]), q, w)
            });
            Rigid::fit(pairs, before.rotation).unwrap_or(*before)
        })
        .collect()
}
