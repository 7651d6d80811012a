//! The edges of a graph and what becomes of them.

use super::symmetric_distances;
use super::{ProximitySettings, select_proximity};
use crate::dba::{Factor, Geometry, PROJECTION_GUARD};
use std::collections::HashSet;

/// Names an edge from its first to its last day, whatever happens to the numbering of keyframes. No
/// two edges of one process share it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct EdgeId(u64);

impl EdgeId {
    /// As a number.
    #[must_use]
    pub fn number(self) -> u64 {
        self.0
    }
}

/// An edge as a source of correspondences knows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EdgeKey {
    /// Unique.
    pub id: EdgeId,
    /// Number of the source frame in the clip.
    pub source_frame: usize,
    /// Number of the target frame in the clip.
    pub target_frame: usize,
}

/// An edge with its measurements.
#[derive(Debug, Clone)]
pub struct GraphEdge {
    /// Identity.
    pub key: EdgeKey,
    /// Keyframes it joins, and the present measurement.
    pub factor: Factor<f32>,
    /// Iterations since it was added.
    pub age: u32,
    /// Probability that each pixel is static, 0..=1, `[height * width]`; 1 until first measured.
    pub static_confidence: Vec<f32>,
}

impl GraphEdge {
    /// Keyframes it joins.
    #[must_use]
    pub fn ends(&self) -> (usize, usize) {
        (self.factor.source, self.factor.target)
    }
}

/// Edges that became active, and edges that will not be revised any more.
#[derive(Debug, Clone, Default)]
pub struct EdgeChanges {
    /// In the order in which they were added.
    pub entered: Vec<EdgeKey>,
    /// Retired or removed.
    pub left: Vec<EdgeKey>,
}

/// Active edges are revised; inactive ones keep their last measurement and still count; bad ones
/// only suppress others.
#[derive(Debug)]
pub struct FactorGraph {
    /// In the order in which they were added.
    pub active: Vec<GraphEdge>,
    /// In the order in which they were retired.
    pub inactive: Vec<GraphEdge>,
    /// Pairs that were tried and found wanting.
    pub bad: Vec<(usize, usize)>,
    /// Most active edges; when there are more, the oldest go.
    pub max_factors: usize,
    #[cfg(test)]
    permuted_ranks: bool,
    changes: EdgeChanges,
}

impl FactorGraph {
    /// Without edges.
    #[must_use]
    pub fn new(max_factors: usize) -> Self {
        Self {
            active: Vec::new(),
            inactive: Vec::new(),
            bad: Vec::new(),
            max_factors,
            #[cfg(test)]
            permuted_ranks: false,
            changes: EdgeChanges::default(),
        }
    }

    /// As published, if `on`: where edges make room, the permutation that sorts the ages is taken
    /// for the ranks.
    #[cfg(test)]
    #[must_use]
    pub(crate) fn with_permuted_ranks(mut self, on: bool) -> Self {
        self.permuted_ranks = on;
        self
    }

    /// What changed since the last call.
    pub fn take_changes(&mut self) -> EdgeChanges {
        std::mem::take(&mut self.changes)
    }

    /// Adds those of `pairs` that are neither active nor inactive; their measurement starts as the
    /// projection of the present geometry with weight 0. With `make_room`, active edges retire
    /// first so that no more than `max_factors` remain. `frames[k]` is the number of keyframe `k`
    /// in the clip.
    pub fn add(
        &mut self,
        pairs: &[(usize, usize)],
        geometry: &Geometry<f32>,
        frames: &[usize],
        make_room: bool,
    ) {
        let edges: HashSet<(usize, usize)> = self
            .active
            .iter()
            .chain(&self.inactive)
            .map(GraphEdge::ends)
            .collect();
        let fresh: Vec<(usize, usize)> = pairs
            .iter()
            .copied()
            .filter(|p| !edges.contains(p))
            .collect();
        if fresh.is_empty() {
            return;
        }
        if make_room && self.active.len() + fresh.len() > self.max_factors {
            self.make_room(self.max_factors.saturating_sub(fresh.len()));
        }
        for (source, target) in fresh {
            let key = EdgeKey {
                id: next_id(),
                source_frame: frames[source],
                target_frame: frames[target],
            };
            self.changes.entered.push(key);
            let len = geometry.grid.len();
            self.active.push(GraphEdge {
                key,
                factor: Factor {
                    source,
                    target,
                    target_px: projected_planes(geometry, source, target),
                    weight: [vec![0.0; len], vec![0.0; len]],
                },
                age: 0,
                static_confidence: vec![1.0; len],
            });
        }
    }

    /// Adds neighbours in time and near pairs, as [`select_proximity`] chooses them.
    pub fn add_proximity(
        &mut self,
        settings: &ProximitySettings,
        geometry: &Geometry<f32>,
        frames: &[usize],
        make_room: bool,
    ) {
        let existing = self.all_pairs();
        let pairs = select_proximity(geometry.frames(), &existing, settings, |pairs| {
            symmetric_distances(geometry, pairs, settings.beta)
        });
        self.add(&pairs, geometry, frames, make_room);
    }

    /// Active, bad and inactive pairs.
    #[must_use]
    pub fn all_pairs(&self) -> Vec<(usize, usize)> {
        let active = self.active.iter().map(GraphEdge::ends);
        let inactive = self.inactive.iter().map(GraphEdge::ends);
        active
            .chain(self.bad.iter().copied())
            .chain(inactive)
            .collect()
    }

    /// Makes active edges inactive.
    pub fn retire(&mut self, mut goes: impl FnMut(&GraphEdge) -> bool) {
        let (gone, stay): (Vec<_>, Vec<_>) = self.active.drain(..).partition(|e| goes(e));
        self.changes.left.extend(gone.iter().map(|e| e.key));
        self.active = stay;
        self.inactive.extend(gone);
    }

    /// Takes the pairs for which `is_bad` holds out of the active edges and never tries them again.
    pub fn reject(&mut self, mut is_bad: impl FnMut(&GraphEdge) -> bool) {
        let (gone, stay): (Vec<_>, Vec<_>) = self.active.drain(..).partition(|e| is_bad(e));
        self.changes.left.extend(gone.iter().map(|e| e.key));
        self.active = stay;
        self.bad.extend(gone.iter().map(GraphEdge::ends));
    }

    /// One iteration older.
    pub fn grow_older(&mut self) {
        for edge in &mut self.active {
            edge.age += 1;
        }
    }

    /// Removes keyframe `frame`: its edges go, later keyframes move down by one.
    pub fn remove_frame(&mut self, frame: usize) {
        let touches = |e: &GraphEdge| e.factor.source == frame || e.factor.target == frame;
        let gone = self.active.iter().filter(|e| touches(e)).map(|e| e.key);
        self.changes.left.extend(gone);
        for edges in [&mut self.active, &mut self.inactive] {
            edges.retain(|e| !touches(e));
            for edge in edges.iter_mut() {
                edge.factor.source -= usize::from(edge.factor.source > frame);
                edge.factor.target -= usize::from(edge.factor.target > frame);
            }
        }
        self.bad.retain(|&(i, j)| i != frame && j != frame);
        for (i, j) in &mut self.bad {
            *i -= usize::from(*i > frame);
            *j -= usize::from(*j > frame);
        }
    }

    /// Takes all edges out, so that their source may forget them.
    pub fn clear(&mut self) {
        self.changes.left.extend(self.active.iter().map(|e| e.key));
        self.active.clear();
        self.inactive.clear();
    }

    /// Retires the oldest edges until `n_kept` are left.
    fn make_room(&mut self, n_kept: usize) {
        let mut order: Vec<usize> = (0..self.active.len()).collect();
        order.sort_by_key(|&k| self.active[k].age);
        let mut rank = vec![0; order.len()];
        order.iter().enumerate().for_each(|(r, &k)| rank[k] = r);
        #[cfg(test)]
        if self.permuted_ranks {
            rank = order;
        }
        let mut ranks = rank.into_iter();
        self.retire(|_| ranks.next().is_some_and(|r| r >= n_kept));
    }
}

fn next_id() -> EdgeId {
    use std::sync::atomic::{AtomicU64, Ordering};
    static NEXT: AtomicU64 = AtomicU64::new(0);
    EdgeId(NEXT.fetch_add(1, Ordering::Relaxed))
}

/// Where the pixels of `source` are seen in `target`, `[2][height * width]`: the position of
/// [`crate::dba::project`] without its derivatives.
pub(crate) fn projected_planes(
    geometry: &Geometry<f32>,
    source: usize,
    target: usize,
) -> [Vec<f32>; 2] {
    let g = geometry.relative(source, target);
    let (r, t, lens) = (&g.rotation, &g.translation, &geometry.lens);
    let disparity = &geometry.disparity[source];
    let mut planes = [
        Vec::with_capacity(disparity.len()),
        Vec::with_capacity(disparity.len()),
    ];
    for (row, line) in disparity.chunks(geometry.grid.width.max(1)).enumerate() {
        let y = (row as f64 - lens.cy) / lens.fy;
        let start: [f64; 3] = std::array::from_fn(|k| r[(k, 1)] * y + r[(k, 2)]);
        for (column, &d) in line.iter().enumerate() {
            let (x, d) = ((column as f64 - lens.cx) / lens.fx, f64::from(d));
            let p: [f64; 3] = std::array::from_fn(|k| start[k] + r[(k, 0)] * x + t[k] * d);
            let iz = 1.0 / if p[2] < PROJECTION_GUARD { 1.0 } else { p[2] };
            planes[0].push((lens.fx * p[0] * iz + lens.cx) as f32);
            planes[1].push((lens.fy * p[1] * iz + lens.cy) as f32);
        }
    }
    planes
}

#[cfg(test)]
mod tests {
    use super::projected_planes;
    use crate::dba::{Geometry, Grid, Pinhole, project};
    use m4_core::{Se3, nalgebra::Vector6};

    #[test]
    fn positions_are_those_of_the_reference_projection() {
        let grid = Grid {
            width: 9,
            height: 7,
        };
        let lens = Pinhole {
            fx: 8.0,
            fy: 7.5,
            cx: 4.1,
            cy: 3.2,
        };
        let plane: Vec<f32> = (0..grid.len()).map(|n| 0.2 + 0.03 * n as f32).collect();
        let geometry = Geometry {
            grid,
            lens,
            // The second camera is so far ahead that near points lie behind it.
            poses: vec![
                Se3::identity(),
                Se3::exp(&Vector6::new(0.3, 0.1, -0.8, 0.1, -0.2, 0.3)),
            ],
            disparity: vec![plane.clone(), plane.clone()],
            sensor: vec![vec![0.0; grid.len()]; 2],
        };
        let got = projected_planes(&geometry, 0, 1);
        let mut behind = 0;
        for (n, &d) in plane.iter().enumerate() {
            let (u, v) = ((n % 9) as f64, (n / 9) as f64);
            let want = project(&geometry.relative(0, 1), &lens, 1.0, u, v, f64::from(d));
            behind += usize::from(want.z < 0.1);
            for k in 0..2 {
                let off = (f64::from(got[k][n]) - want.pixel[k]).abs();
                assert!(
                    off <= 1e-6 * want.pixel[k].abs().max(1.0),
                    "pixel {n}: off by {off}"
                );
            }
        }
        assert!(behind > 0 && behind < grid.len());
    }
}
