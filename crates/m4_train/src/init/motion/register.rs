//! Registers the dynamic points of two keyframes, with the help of the capture's tracks.

use crate::init::{motion::rigid::Rigid, voxel::Centroids};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use m4_core::{Tracks, nalgebra::Vector3};
use rayon::prelude::*;
use std::num::NonZero;

/// A difference of colour of this size counts as much as a displacement of one `reach` (our rules,
/// as the next three).
const COLOUR_SCALE: f32 = 0.1;
/// Points that move together as one rigid piece, in the last rounds.
const NEIGHBOURS: usize = 20;
/// Rounds of match and fit from a rough guess, and from one that is nearly right (measured, as the
/// next two: docs/decisions/0022).
const ROUNDS: (usize, usize) = (8, 4);
/// How many more points move together in the first rounds than in the last.
const FIRST: usize = 8;
/// Large pieces are fitted around one of this many nodes; the others have the motion of the nearest
/// of these.
const NODES_PER_LEADER: usize = 4;
/// Spacing of the points that are registered, pixels at the median depth (our rule).
pub(crate) const NODE_PIXELS: f32 = 4.0;
/// Length over which places compete with colours, pixels at the median depth (our rule).
pub(crate) const REACH_PIXELS: f32 = 8.0;

/// Coordinates in which a match is the nearest point: place over reach, colour over its scale.
fn joint(p: [f32; 3], rgb: [f32; 3], reach: f32) -> [f32; 6] {
    let (a, b) = (1.0 / reach, 1.0 / COLOUR_SCALE);
    [
        p[0] * a,
        p[1] * a,
        p[2] * a,
        rgb[0] * b,
        rgb[1] * b,
        rgb[2] * b,
    ]
}

/// One keyframe as its neighbours are registered to it.
#[derive(Clone, Copy)]
pub(crate) struct KeyframeView<'a> {
    /// Points whose motion is looked for.
    pub nodes: &'a Centroids,
    /// Points that nodes of other keyframes are brought onto.
    pub points: &'a Centroids,
    /// Whether it would see a place.
    pub sees: &'a (dyn Fn([f32; 3]) -> bool + Sync),
}

/// A keyframe with what registering from it and to it needs; neighbours share it.
pub(crate) struct Keyframe<'a> {
    pub view: KeyframeView<'a>,
    /// The nodes nearest to each node, the nearest first; none if they have no order in space.
    near: Vec<Vec<u32>>,
    leaders: Leaders,
    /// Points in place and colour; `None` without points.
    points: Option<ImmutableKdTree<f32, 6>>,
}

impl<'a> Keyframe<'a> {
    /// Prepares `view`; `reach` in world units.
    pub fn new(view: KeyframeView<'a>, reach: f32) -> Self {
        let nodes = &view.nodes.xyz;
        let ((near, leaders), points) = rayon::join(
            || (nearest(nodes, nodes, NEIGHBOURS), Leaders::new(nodes)),
            || {
                let joint = view
                    .points
                    .xyz
                    .iter()
                    .zip(&view.points.rgb)
                    .map(|(p, c)| joint(*p, *c, reach));
                let joint: Vec<[f32; 6]> = joint.collect();
                ImmutableKdTree::new_from_slice(&joint)
                    .ok()
                    .filter(|_| !joint.is_empty())
            },
        );
        Self {
            view,
            near,
            leaders,
            points,
        }
    }
}

/// Nodes that large pieces are fitted around: wide neighbourhoods of neighbours hardly differ.
struct Leaders {
    nodes: Vec<u32>,
    /// The leader of each node.
    of: Vec<u32>,
    /// The nodes nearest to each leader, the nearest first.
    near: Vec<Vec<u32>>,
}

impl Leaders {
    fn new(places: &[[f32; 3]]) -> Self {
        let nodes: Vec<u32> = (0..places.len() as u32).step_by(NODES_PER_LEADER).collect();
        let leading: Vec<[f32; 3]> = nodes.iter().map(|&k| places[k as usize]).collect();
        let of = nearest(&leading, places, 1).into_iter().flatten().collect();
        Self {
            nodes,
            of,
            near: nearest(places, &leading, FIRST * NEIGHBOURS),
        }
    }

    /// Tells whether each of the nodes has a leader: not where points have no order in space.
    fn are_complete(&self, nodes: &Centroids) -> bool {
        self.of.len() == nodes.xyz.len() && self.near.len() == self.nodes.len()
    }

    /// Fits the leaders, and returns for every node the motion of its leader.
    fn fitted(
        &self,
        nodes: &Centroids,
        motion: &[Rigid],
        wanted: &[(Vector3<f32>, f32)],
        pieces: usize,
    ) -> Vec<Rigid> {
        let leading: Vec<Rigid> = self.nodes.iter().map(|&k| motion[k as usize]).collect();
        let leading = fitted(nodes, &leading, &self.near, wanted, pieces);
        self.of.iter().map(|&k| leading[k as usize]).collect()
    }
}

/// Finds the `count` of `points` that are nearest to each of the `places`, the nearest first; none
/// if points have no order in space.
fn nearest(points: &[[f32; 3]], places: &[[f32; 3]], count: usize) -> Vec<Vec<u32>> {
    let (Ok(tree), Some(count)) = (
        ImmutableKdTree::<f32, 3>::new_from_slice(points),
        NonZero::new(count.min(points.len())),
    ) else {
        return Vec::new();
    };
    let near = places.par_iter().map(|p| {
        tree.query(p)
            .nearest_n::<SquaredEuclidean<f32>>(count)
            .execute()
    });
    near.map(|neighbours| neighbours.into_iter().map(|n| n.item).collect())
        .collect()
}

/// Where a registration starts.
pub(crate) enum Guess {
    /// A rough one: pieces are large in the first rounds and shrink.
    Rough(Vec<Rigid>),
    /// One that is nearly right: pieces are small at once.
    Close(Vec<Rigid>),
}

/// A motion for every node of `from`, that brings them onto `to`, starting from `guess`; `reach` in
/// world units.
///
/// Each round matches every displaced node to the nearest point of `to` in place and colour; then
/// the motion of a node is the rigid one that fits what the matches of its neighbours ask for,
/// matches of unlike colour or far away weighing little, and nodes that go where they cannot be
/// seen nothing at all. From a rough guess neighbourhoods shrink from round to round: large pieces
/// first, then their parts. Then nodes near `tracks` are moved with them.
pub(crate) fn register(
    from: &Keyframe<'_>,
    to: &Keyframe<'_>,
    tracks: Option<TrackShifts>,
    guess: Guess,
    reach: f32,
) -> Vec<Rigid> {
    let (nodes, near) = (from.view.nodes, &from.near);
    let (mut motion, rounds, first) = match guess {
        Guess::Rough(motion) => (motion, ROUNDS.0, FIRST as f32),
        Guess::Close(motion) => (motion, ROUNDS.1, 1.0),
    };
    let Some(points) = to.points.as_ref().filter(|_| !near.is_empty()) else {
        return motion;
    };
    for round in 0..rounds {
        let wanted = wanted(nodes, &motion, |i, place| {
            let n = points
                .query(&joint(place, nodes.rgb[i], reach))
                .nearest_one::<SquaredEuclidean<f32>>()
                .execute();
            let match_ = to.view.points.xyz[n.item as usize];
            (to.view.sees)(place).then(|| (match_, 1.0 / (1.0 + n.distance).powi(2)))
        });
        // down to 1 in the first two thirds of the rounds
        let left = 1.0 - (1.5 * round as f32 / rounds as f32).min(1.0);
        let pieces = (NEIGHBOURS as f32 * first.powf(left)) as usize;
        motion = match pieces > NEIGHBOURS && from.leaders.are_complete(nodes) {
            true => from.leaders.fitted(nodes, &motion, &wanted, pieces),
            false => fitted(nodes, &motion, near, &wanted, pieces),
        };
    }
    if let Some(tracks) = tracks {
        let wanted = wanted(nodes, &motion, |i, _| tracks.shifted(nodes.xyz[i]));
        motion = fitted(nodes, &motion, near, &wanted, NEIGHBOURS);
    }
    motion
}

/// Where each node should go and how much that weighs, by `ask(node, its place so far)`.
fn wanted(
    nodes: &Centroids,
    motion: &[Rigid],
    ask: impl Fn(usize, [f32; 3]) -> Option<([f32; 3], f32)> + Sync,
) -> Vec<(Vector3<f32>, f32)> {
    let places = nodes.xyz.par_iter().zip(motion).enumerate();
    places
        .map(|(i, (p, m))| match ask(i, m.apply(*p)) {
            Some((q, weight)) => (q.into(), weight),
            None => (Vector3::zeros(), 0.0),
        })
        .collect()
}

/// The rigid motion of the `pieces` nearest nodes of each; without weights, the one before.
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
            let pairs = near[..pieces.min(near.len())].iter().map(|&i| {
                let (q, w) = wanted[i as usize];
                (Vector3::from(nodes.xyz[i as usize]), q, w)
            });
            Rigid::fit(pairs, before.rotation).unwrap_or(*before)
        })
        .collect()
}

/// Tracks that are asked about one place.
const NEAREST: NonZero<usize> = NonZero::new(6).unwrap();
/// Tracks of another body are farther away than this many times what tracks lie apart.
const SPACING: f32 = 3.0;

/// The tracks of a capture at its keyframes.
#[derive(Clone, Copy)]
pub(crate) struct KeyframeTracks<'a> {
    pub tracks: &'a Tracks,
    /// The frame of each keyframe.
    pub frames: &'a [usize],
    /// Tracks this close speak for a place, however densely they lie, world units.
    pub reach: f32,
}

/// Shifts of tracks from one keyframe to another.
pub(crate) struct TrackShifts {
    tree: ImmutableKdTree<f32, 3>,
    shifts: Vec<[f32; 3]>,
    /// Tracks farther away than this do not speak for a place, world units.
    reach: f32,
}

impl KeyframeTracks<'_> {
    /// The shifts from keyframe `from` to keyframe `to`; `None` where no track knows both.
    pub fn between(&self, from: usize, to: usize) -> Option<TrackShifts> {
        let (from, to) = (*self.frames.get(from)?, *self.frames.get(to)?);
        let endpoints = |k: usize| Some((self.tracks.place(from, k)?, self.tracks.place(to, k)?));
        let (places, ends): (Vec<[f32; 3]>, Vec<[f32; 3]>) =
            (0..self.tracks.count()).filter_map(endpoints).unzip();
        if places.is_empty() {
            return None;
        }
        let shifts = places
            .iter()
            .zip(&ends)
            .map(|(p, q)| [0, 1, 2].map(|k| q[k] - p[k]))
            .collect();
        let tree = ImmutableKdTree::<f32, 3>::new_from_slice(&places).ok()?;
        let reach = self.reach.max(SPACING * spacing(&tree, &places));
        Some(TrackShifts {
            tree,
            shifts,
            reach,
        })
    }
}

/// The median distance of a place to its nearest neighbour; 0 for a lone one.
fn spacing(tree: &ImmutableKdTree<f32, 3>, places: &[[f32; 3]]) -> f32 {
    const TWO: NonZero<usize> = NonZero::new(2).unwrap();
    let mut squares: Vec<f32> = places
        .par_iter()
        .filter_map(|p| {
            let near = tree
                .query(p)
                .nearest_n::<SquaredEuclidean<f32>>(TWO)
                .execute();
            near.iter()
                .map(|n| n.distance)
                .max_by(f32::total_cmp)
                .filter(|_| near.len() > 1)
        })
        .collect();
    m4_core::median(&mut squares).map_or(0.0, f32::sqrt)
}

impl TrackShifts {
    /// Where a place went and how much that counts: the shift of those of the nearest tracks that
    /// differs least from the others'. `None` where no track is near.
    pub fn shifted(&self, p: [f32; 3]) -> Option<([f32; 3], f32)> {
        let near = self
            .tree
            .query(&p)
            .nearest_n::<SquaredEuclidean<f32>>(NEAREST)
            .execute();
        let near = near
            .into_iter()
            .filter(|n| n.distance <= self.reach * self.reach);
        let near: Vec<(Vector3<f32>, f32)> = near
            .map(|n| {
                let weight = 1.0 / (n.distance.sqrt() + 0.1 * self.reach);
                (self.shifts[n.item as usize].into(), weight)
            })
            .collect();
        let off = |a: &Vector3<f32>| near.iter().map(|(b, w)| w * (a - b).norm()).sum::<f32>();
        let middle = near
            .iter()
            .map(|(a, _)| (a, off(a)))
            .min_by(|a, b| a.1.total_cmp(&b.1))?
            .0;
        Some(((Vector3::from(p) + middle).into(), 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::{Centroids, KeyframeTracks, NEIGHBOURS, Rigid, fitted};
    use m4_core::Tracks;
    use m4_core::nalgebra::Vector3;

    /// A row of tracks 0.1 apart that move by 1 along x in every frame, but for the third, which is
    /// wrong.
    fn row() -> Tracks {
        let place = |t: usize, k: usize| {
            let speed = if k == 2 { -3.0 } else { 1.0 };
            [0.1 * k as f32 + speed * t as f32, 0.0, 0.0]
        };
        let xyz = (0..2)
            .flat_map(|t| (0..8).map(move |k| place(t, k)))
            .collect();
        Tracks::new(2, 8, xyz, vec![true; 16]).unwrap()
    }

    #[test]
    fn a_node_without_neighbours_keeps_its_motion() {
        let nodes = Centroids {
            xyz: vec![[1.0, 2.0, 3.0]],
            ..Centroids::default()
        };
        let motion = [Rigid::shift([1.0, 2.0, 3.0], [4.0, 5.0, 6.0])];
        assert_eq!(
            fitted(
                &nodes,
                &motion,
                &[Vec::new()],
                &[(Vector3::zeros(), 1.0)],
                NEIGHBOURS
            ),
            motion
        );
    }

    #[test]
    fn one_wrong_track_is_outvoted_and_far_tracks_have_no_weight() {
        let tracks = row();
        let tracks = KeyframeTracks {
            tracks: &tracks,
            frames: &[0, 1],
            reach: 0.05,
        };
        let shifts = tracks.between(0, 1).unwrap();
        let (to, weight) = shifts.shifted([0.2, 0.05, 0.0]).unwrap();
        assert!(
            (to[0] - 1.2).abs() < 1e-6 && to[1] == 0.05 && weight > 0.0,
            "{to:?}"
        );
        assert_eq!(shifts.shifted([0.2, 0.5, 0.0]), None);
        let (back, _) = tracks
            .between(1, 0)
            .unwrap()
            .shifted([1.5, 0.0, 0.0])
            .unwrap();
        assert!((back[0] - 0.5).abs() < 1e-6);
        assert!(tracks.between(0, 2).is_none());
    }

    #[test]
    fn a_single_track_moves_points_within_reach() {
        let tracks = Tracks::new(2, 1, vec![[0.0; 3], [0.0, 1.0, 0.0]], vec![true; 2]).unwrap();
        let tracks = KeyframeTracks {
            tracks: &tracks,
            frames: &[0, 1],
            reach: 0.5,
        };
        let shifts = tracks.between(0, 1).unwrap();
        assert_eq!(
            shifts.shifted([0.3, 0.0, 0.0]),
            Some(([0.3, 1.0, 0.0], 1.0))
        );
        assert_eq!(shifts.shifted([0.6, 0.0, 0.0]), None);
    }
}
