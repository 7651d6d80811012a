//! Which frames are compared with which.
//!
//! ```text
//! Geometry -> distance (how far pixels move between two frames)
//!          -> selection (candidate pairs, suppression around existing edges, greedy choice)
//!          -> FactorGraph (active, retired and rejected edges; ages; renumbering when a keyframe goes)
//! ```
//!
//! Source: docs/spec/front-end.md 1.5; DROID-SLAM (Teed and Deng 2021), section 3.1. Indices are those
//! of keyframes, poses map world to camera, positions are pixels of the grid (see [`crate::dba`]).

mod distance;
mod factor_graph;

pub use distance::{FAR, frame_distance, frame_distance_reference, symmetric_distances};
pub(crate) use factor_graph::projected_planes;
pub use factor_graph::{EdgeChanges, EdgeId, EdgeKey, FactorGraph, GraphEdge};

/// Which pairs are candidates and how many are taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProximitySettings {
    /// First source of a candidate pair.
    pub first_source: usize,
    /// First target of a candidate pair.
    pub first_target: usize,
    /// Frames this close in time are not candidates; those up to one further are always joined.
    pub radius: usize,
    /// How far around an edge others are suppressed, in steps of frames.
    pub suppression: usize,
    /// Greatest distance, pixels of the grid.
    pub threshold_px: f64,
    /// Share of the full motion in the distance, the rest being motion without rotation.
    pub beta: f64,
    /// Most edges that one choice makes.
    pub max_factors: usize,
}

/// All ordered pairs of different frames of `from..to` at most `radius` apart, by source and then target.
#[must_use]
pub fn neighbourhood(from: usize, to: usize, radius: usize) -> Vec<(usize, usize)> {
    (from..to)
        .flat_map(|i| (from..to).map(move |j| (i, j)))
        .filter(|&(i, j)| i != j && i.abs_diff(j) <= radius)
        .collect()
}

/// Candidate pairs that are not open any more.
struct Open<'a> {
    settings: &'a ProximitySettings,
    frames: usize,
    open: Vec<bool>,
}

impl Open<'_> {
    fn at(&self, i: usize, j: usize) -> Option<usize> {
        let s = self.settings;
        let inside = (s.first_source..self.frames).contains(&i) && (s.first_target..self.frames).contains(&j);
        inside.then(|| (i - s.first_source) * (self.frames - s.first_target) + j - s.first_target)
    }

    fn close(&mut self, i: usize, j: usize) {
        if let Some(k) = self.at(i, j) {
            self.open[k] = false;
        }
    }

    /// Closes all pairs around an edge: as many steps away as the suppression says, fewer for short edges.
    fn suppress(&mut self, i: usize, j: usize) {
        let reach = i.abs_diff(j).saturating_sub(2).min(self.settings.suppression);
        for i1 in i.saturating_sub(reach)..=i + reach {
            let left = reach - i.abs_diff(i1);
            for j1 in j.saturating_sub(left)..=j + left {
                self.close(i1, j1);
            }
        }
    }
}

/// The edges to add to a graph of `frames` frames that has the edges `existing`: neighbours in time, then pairs by
/// rising distance, both directions of each. `distances` gives the distance of every pair it is asked for.
/// Some may exist already.
pub fn select_proximity(
    frames: usize,
    existing: &[(usize, usize)],
    settings: &ProximitySettings,
    distances: impl FnOnce(&[(usize, usize)]) -> Vec<f64>,
) -> Vec<(usize, usize)> {
    let (s, columns) = (settings, frames.saturating_sub(settings.first_target));
    let rows = frames.saturating_sub(s.first_source);
    let mut candidates = Open { settings, frames, open: vec![true; rows * columns] };
    for &(i, j) in existing {
        candidates.suppress(i, j);
    }
    let mut edges = Vec::new();
    for i in s.first_source..frames {
        for j in i.saturating_sub(s.radius + 1)..i {
            edges.push((i, j));
            edges.push((j, i));
            candidates.close(i, j);
        }
    }
    let pairs: Vec<(usize, usize)> = (s.first_source..frames)
        .flat_map(|i| (s.first_target..frames).map(move |j| (i, j)))
        .filter(|&(i, j)| i >= j + s.radius && candidates.at(i, j).is_some_and(|k| candidates.open[k]))
        .collect();
    let distance = distances(&pairs);
    let mut order: Vec<usize> = (0..pairs.len()).filter(|&k| distance[k] <= s.threshold_px.min(100.0)).collect();
    order.sort_by(|&a, &b| distance[a].total_cmp(&distance[b]));
    for k in order {
        let (i, j) = pairs[k];
        if !candidates.at(i, j).is_some_and(|k| candidates.open[k]) {
            continue;
        }
        if edges.len() > s.max_factors {
            break;
        }
        edges.push((i, j));
        edges.push((j, i));
        candidates.suppress(i, j);
    }
    edges
}
