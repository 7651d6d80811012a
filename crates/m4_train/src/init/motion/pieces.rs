//! Cuts the surface that a frame shows into pieces that overlap.

use crate::init::motion::{
    align::{Node, Pieces},
    observed::Observed,
    rigid::Rigid,
};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use m4_core::nalgebra::Vector3;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::num::NonZero;

/// Points of a node at most, the nearest ones.
const MOST_POINTS: usize = 80;
/// Points along the distance between two nodes.
const POINTS: f32 = 5.0;
/// Neighbours of a node.
const NEIGHBOURS: usize = 6;
/// Range of the noise of depth, share: files round, and networks err.
const DEPTH_NOISE: [f32; 2] = [0.004, 0.03];

/// The median difference of depth at the guess, as a standard deviation; mostly the noise of depth
/// where the guess is near.
pub(crate) fn depth_noise(to: &Observed, places: &[[f32; 3]], motion: &[Rigid]) -> f32 {
    let off = places.iter().zip(motion).filter_map(|(p, m)| {
        let projected = to.project(&m.moved(&Vector3::from(*p)))?;
        let depth = to.sample(projected.at)?.depth;
        (depth > 0.0).then(|| (depth / projected.point[2] - 1.0).abs())
    });
    let mut off: Vec<f32> = off.collect();
    let [least, most] = DEPTH_NOISE;
    m4_core::median(&mut off).unwrap_or(most).clamp(least, most)
}

/// Pieces around some of `places`, `px` pixels apart, and which those are. `None` without places.
pub(crate) fn pieces(from: &Observed, places: &[[f32; 3]], px: f32) -> Option<(Pieces, Vec<u32>)> {
    let mut depths: Vec<f32> = places
        .iter()
        .filter_map(|p| from.project(&Vector3::from(*p)).map(|p| p.point[2]))
        .collect();
    let spacing = px * from.pixel(m4_core::median(&mut depths)?);
    let mut cells: BTreeMap<[i32; 3], u32> = BTreeMap::new();
    for (k, p) in places.iter().enumerate() {
        cells
            .entry(p.map(|v| (v / spacing).floor() as i32))
            .or_insert(k as u32);
    }
    let chosen: Vec<u32> = cells.into_values().collect();
    let nodes: Vec<[f32; 3]> = chosen.iter().map(|&k| places[k as usize]).collect();
    let step = ((px / POINTS).round() as usize).max(1);
    let points = from.points(step);
    let xyz: Vec<[f32; 3]> = points.iter().map(|p| p.place.into()).collect();
    let most = NonZero::new(MOST_POINTS.min(xyz.len()))?;
    let tree = ImmutableKdTree::<f32, 3>::new_from_slice(&nodes).ok()?;
    let cloud = ImmutableKdTree::<f32, 3>::new_from_slice(&xyz).ok()?;
    let count = NonZero::new((NEIGHBOURS + 1).min(nodes.len()))?;
    // the weight falls to exp(-1/2) at twice the distance of nodes
    let radius = 2.0 * spacing;
    let node = |(i, p): (usize, &[f32; 3])| {
        let near = tree
            .query(p)
            .nearest_n::<SquaredEuclidean<f32>>(count)
            .execute();
        let near = near
            .iter()
            .filter(|n| n.item as usize != i && n.distance < (4.0 * spacing).powi(2));
        let around = cloud
            .query(p)
            .nearest_n::<SquaredEuclidean<f32>>(most)
            .execute();
        let around = around
            .iter()
            .filter(|n| n.distance < (2.0 * radius).powi(2));
        Node {
            place: (*p).into(),
            points: around
                .map(|n| (n.item, 0.5 * n.distance / (radius * radius)))
                .collect(),
            near: near.map(|n| n.item).collect(),
        }
    };
    let nodes = nodes.par_iter().enumerate().map(node).collect();
    Some((
        Pieces {
            nodes,
            points,
            spacing,
            step,
        },
        chosen,
    ))
}
