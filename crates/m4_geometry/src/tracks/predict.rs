//! Predicts occluded points from their neighbours' rigid motion.

use super::fill::{Board, State};
use super::rigid::{Anchor, fit};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use m4_core::Camera;
use m4_core::nalgebra::{Matrix3, Rotation3, Vector3};
use rayon::prelude::*;
use std::num::NonZero;

/// Neighbours that a hidden point goes with.
const NEIGHBOURS: usize = 16;
/// Neighbours farther away than this many times the distance of neighbouring tracks do not count.
const REACH: f32 = 24.0;
/// Most frames that a hidden point without a visible neighbour goes on with its last motion; they
/// count if it becomes visible again.
const BLIND_FRAMES: usize = 12;
/// Neighbours that are remembered when a point is lost: the nearest, and those of a thinner set
/// that reaches farther.
const NEAREST: usize = 24;
const FARTHER: usize = 40;
/// The thinner set has one of this many.
const THINNER: usize = 8;
/// Fewest neighbours whose motion is trusted before others are asked.
const ENOUGH: usize = 3;
/// Frames before a point was lost in which its distance to a neighbour is compared: what belongs to
/// one body keeps its distance.
const BACK: [usize; 2] = [4, 8];
/// Frames after which a prediction is trusted half as much.
const HALF_TRUST: f32 = 16.0;

/// A point that is not seen.
#[derive(Debug, Clone)]
pub(super) struct Lost {
    /// The last frame in which it was seen.
    pub since: usize,
    /// Tracks that were seen there too, the nearest first, and how far they seem to be of its body,
    /// 0..1.
    near: Vec<(u32, f64)>,
    /// How far tracks lie apart there, world units.
    spacing: f64,
    /// Of its surface there, towards the camera.
    normal: Option<Vector3<f64>>,
    /// Of its body since then.
    rotation: Rotation3<f64>,
    /// Frames without any neighbour.
    pub blind: usize,
    /// Frames in which something farther was seen in its place.
    pub violations: usize,
}

/// Where a point should be.
#[derive(Debug, Clone, Copy)]
pub(super) struct Guess {
    pub place: Vector3<f64>,
    /// Of its body since it was lost.
    pub rotation: Rotation3<f64>,
    pub state: State,
    pub confidence: f32,
}

type Tree = ImmutableKdTree<f32, 3>;

fn tree(places: &[[f32; 3]]) -> Option<Tree> {
    if places.is_empty() {
        return None;
    }
    Tree::new_from_slice(places).ok()
}

/// Squared distance and index of the nearest, in order.
fn nearest(tree: &Tree, p: &[f32; 3], count: usize) -> Vec<(f32, usize)> {
    let Some(count) = NonZero::new(count) else {
        return Vec::new();
    };
    let neighbours = tree
        .query(p)
        .nearest_n::<SquaredEuclidean<f32>>(count)
        .execute();
    let mut out: Vec<(f32, usize)> = neighbours
        .into_iter()
        .map(|n| (n.distance, n.item as usize))
        .collect();
    out.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    out
}

fn vector(p: [f32; 3]) -> Vector3<f64> {
    Vector3::from(p.map(f64::from))
}

/// What is remembered of `tracks`, which were last seen in frame `since`.
pub(super) fn lose(board: &Board, camera: &Camera, since: usize, tracks: &[usize]) -> Vec<Lost> {
    let visible: Vec<usize> = board.seen_in(since).collect();
    let places: Vec<[f32; 3]> = visible
        .iter()
        .filter_map(|&k| board.visible_place(since, k))
        .collect();
    let thin: Vec<usize> = visible.iter().copied().step_by(THINNER).collect();
    let thin_places: Vec<[f32; 3]> = places.iter().copied().step_by(THINNER).collect();
    let (Some(all), Some(thinner)) = (tree(&places), tree(&thin_places)) else {
        return Vec::new();
    };
    let spacing = spacing(&all, &places);
    let one = |&k: &usize| {
        let at = board.places[board.at(since, k)];
        let close = nearest(&all, &at, (NEAREST + 1).min(places.len()));
        let far = nearest(&thinner, &at, FARTHER.min(thin.len()));
        let mut near: Vec<(f32, usize)> = close.iter().map(|&(d, i)| (d, visible[i])).collect();
        near.extend(far.into_iter().map(|(d, i)| (d, thin[i])));
        near.retain(|&(_, j)| j != k);
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.dedup();
        let kin = |j: usize| kinship(board, since, k, j, spacing);
        Lost {
            since,
            near: near.iter().map(|&(_, j)| (j as u32, kin(j))).collect(),
            spacing,
            normal: normal(
                close.iter().map(|&(_, i)| vector(places[i])),
                &(camera.centre() - vector(at)),
            ),
            rotation: Rotation3::identity(),
            blind: 0,
            violations: 0,
        }
    };
    tracks.par_iter().map(one).collect()
}

/// The median distance of a place to its nearest neighbour.
fn spacing(tree: &Tree, places: &[[f32; 3]]) -> f64 {
    if places.len() < 2 {
        return 0.0;
    }
    let mut squares: Vec<f32> = places
        .par_iter()
        .map(|p| nearest(tree, p, 2).get(1).map_or(0.0, |n| n.0))
        .collect();
    m4_core::median(&mut squares).map_or(0.0, |square| f64::from(square.sqrt()))
}

/// How far two tracks seem to be of one body: 1 where they kept their distance, towards 0 where
/// they did not.
fn kinship(board: &Board, frame: usize, a: usize, b: usize, spacing: f64) -> f64 {
    let apart = |t: usize| {
        Some((vector(board.visible_place(t, a)?) - vector(board.visible_place(t, b)?)).norm())
    };
    let Some(now) = apart(frame) else { return 0.0 };
    let others = BACK.iter().flat_map(|&k| {
        [
            frame.checked_sub(k),
            Some(frame + k).filter(|t| *t < board.frames),
        ]
    });
    let changes = others.flatten().filter_map(apart).map(|d| (d - now).abs());
    let change = changes.fold(0.0, f64::max) / (0.1 * now + 0.5 * spacing).max(1e-12);
    1.0 / (1.0 + change * change).powi(2)
}

/// The direction in which places spread least, towards `to`; `None` where that is no clear
/// direction.
fn normal(
    places: impl Iterator<Item = Vector3<f64>> + Clone,
    to: &Vector3<f64>,
) -> Option<Vector3<f64>> {
    let count = places.clone().count();
    if count < 6 {
        return None;
    }
    let mean = places.clone().sum::<Vector3<f64>>() / count as f64;
    let spread: Matrix3<f64> = places.map(|p| (p - mean) * (p - mean).transpose()).sum();
    let eigen = (spread / spread.norm().max(1e-300)).try_symmetric_eigen(1e-15, 200)?;
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let flat = eigen.eigenvalues[order[0]] < 0.1 * eigen.eigenvalues[order[1]];
    let n: Vector3<f64> = eigen.eigenvectors.column(order[0]).into_owned();
    flat.then(|| if n.dot(to) < 0.0 { -n } else { n })
}

/// Tracks that are seen in two neighbouring frames.
pub(super) struct Step {
    before: usize,
    now: usize,
    tracks: Vec<usize>,
    tree: Option<Tree>,
}

impl Step {
    pub fn new(board: &Board, before: usize, now: usize) -> Self {
        let both = board
            .seen_in(before)
            .filter(|&k| board.visible_place(now, k).is_some());
        let tracks: Vec<usize> = both.collect();
        let places: Vec<[f32; 3]> = tracks
            .iter()
            .filter_map(|&k| board.visible_place(before, k))
            .collect();
        let tree = tree(&places);
        Self {
            before,
            now,
            tracks,
            tree,
        }
    }
}

impl Lost {
    /// Where the point is in the frame that `step` leads to: by those that were seen with it, else
    /// by those that are around it on the way, else as it moved last (`before`: the frame before
    /// that of the step).
    pub fn guess(
        &self,
        board: &Board,
        track: usize,
        step: &Step,
        earlier: Option<usize>,
    ) -> Option<Guess> {
        let together = self.anchors_together(board, track, step.now);
        let passing = || self.anchors_passing(board, track, step);
        if together.len() >= ENOUGH {
            return self.together(board, track, step.now, &together);
        }
        let passing = passing();
        if passing.len() >= ENOUGH {
            return self.passing(board, track, step, &passing);
        }
        if !together.is_empty() {
            return self.together(board, track, step.now, &together);
        }
        if !passing.is_empty() {
            return self.passing(board, track, step, &passing);
        }
        self.blindly(board, track, step, earlier)
    }

    /// Where those that were last seen with it say that it is in frame `now`; `None` where too few
    /// are seen there.
    pub fn check(&self, board: &Board, track: usize, now: usize) -> Option<Vector3<f64>> {
        let anchors = self.anchors_together(board, track, now);
        let enough = anchors.len() >= ENOUGH;
        enough
            .then(|| self.together(board, track, now, &anchors))?
            .map(|g| g.place)
    }

    /// False where its surface has turned away from a camera at `centre`.
    pub fn faces(&self, guess: &Guess, centre: &Vector3<f64>) -> bool {
        self.normal
            .is_none_or(|n| (guess.rotation * n).dot(&(centre - guess.place)) > 0.0)
    }

    /// Takes over what a guess found out.
    pub fn learn(&mut self, guess: &Guess) {
        self.rotation = guess.rotation;
        self.blind = if guess.state == State::Blind {
            self.blind + 1
        } else {
            0
        };
    }

    /// Neighbours in the last frame where both were seen, and now.
    fn anchors_together(&self, board: &Board, track: usize, now: usize) -> Vec<Anchor> {
        let from = vector(board.places[board.at(self.since, track)]);
        let both = self
            .near
            .iter()
            .filter(|(_, kin)| *kin > 0.05)
            .filter_map(|&(j, kin)| {
                let place = board.places[board.at(self.since, j as usize)];
                Some((
                    vector(place),
                    vector(board.visible_place(now, j as usize)?),
                    kin,
                ))
            });
        self.weighted(&from, both.take(NEIGHBOURS).collect())
    }

    /// Neighbours in the frame before, wherever they come from.
    fn anchors_passing(&self, board: &Board, track: usize, step: &Step) -> Vec<Anchor> {
        let at = board.places[board.at(step.before, track)];
        let Some(tree) = &step.tree else {
            return Vec::new();
        };
        let near = nearest(tree, &at, NEIGHBOURS.min(step.tracks.len()));
        let both = near.into_iter().filter_map(|(_, i)| {
            let k = step.tracks[i];
            Some((
                vector(board.visible_place(step.before, k)?),
                vector(board.visible_place(step.now, k)?),
                1.0,
            ))
        });
        self.weighted(&vector(at), both.collect())
    }

    /// Pairs, nearest first, with weights that fall with their distance to `at`; none beyond the
    /// reach.
    fn weighted(
        &self,
        at: &Vector3<f64>,
        pairs: Vec<(Vector3<f64>, Vector3<f64>, f64)>,
    ) -> Vec<Anchor> {
        let reach = f64::from(REACH) * self.spacing;
        let far = |p: &Vector3<f64>| (p - at).norm();
        let pairs: Vec<_> = pairs
            .into_iter()
            .filter(|(p, _, _)| far(p) <= reach)
            .collect();
        let Some((middle, _, _)) = pairs.get(pairs.len() / 2) else {
            return Vec::new();
        };
        let sd = far(middle).max(2.0 * self.spacing).max(1e-12);
        let anchor = |(from, to, kin): &(Vector3<f64>, Vector3<f64>, f64)| Anchor {
            from: *from,
            to: *to,
            weight: kin * (-0.5 * (far(from) / sd).powi(2)).exp(),
        };
        pairs.iter().map(anchor).collect()
    }

    fn together(
        &self,
        board: &Board,
        track: usize,
        now: usize,
        anchors: &[Anchor],
    ) -> Option<Guess> {
        let from = vector(board.places[board.at(self.since, track)]);
        let fit = fit(anchors, &self.rotation, self.spacing)?;
        Some(Guess {
            place: fit.apply(&from),
            rotation: fit.rotation,
            state: State::Predicted,
            confidence: self.trust(now, anchors.len(), fit.miss),
        })
    }

    fn passing(
        &self,
        board: &Board,
        track: usize,
        step: &Step,
        anchors: &[Anchor],
    ) -> Option<Guess> {
        let from = vector(board.places[board.at(step.before, track)]);
        let fit = fit(anchors, &Rotation3::identity(), self.spacing)?;
        Some(Guess {
            place: fit.apply(&from),
            rotation: fit.rotation * self.rotation,
            state: State::Predicted,
            confidence: 0.7 * self.trust(step.now, anchors.len(), fit.miss),
        })
    }

    fn blindly(
        &self,
        board: &Board,
        track: usize,
        step: &Step,
        earlier: Option<usize>,
    ) -> Option<Guess> {
        let from = board.places[board.at(step.before, track)];
        let last = board.places[board.at(earlier?, track)];
        let usable = self.blind < BLIND_FRAMES && last.iter().all(|v| v.is_finite());
        usable.then(|| Guess {
            place: 2.0 * vector(from) - vector(last),
            rotation: self.rotation,
            state: State::Blind,
            confidence: 0.3 * self.trust(step.now, 1, 0.0),
        })
    }

    /// Falls with time, with what neighbours disagree by, and where they are few.
    fn trust(&self, now: usize, neighbours: usize, miss: f64) -> f32 {
        let age = (-(now.abs_diff(self.since) as f32) / HALF_TRUST).exp2();
        let agreement = 1.0 / (1.0 + (miss / self.spacing.max(1e-12)).powi(2)) as f32;
        age * agreement * neighbours as f32 / (neighbours as f32 + 1.0)
    }
}
