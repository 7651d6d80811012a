//! A walk around a pillar that ends where it began.

use super::{HEIGHT, WIDTH, features};
use crate::classical::sparse::SparseConfig;
use crate::classical::sparse::map::Map;
use crate::classical::sparse::priors::Lenses;
use crate::classical::sparse::reconstruct::SparseProblem;
use crate::classical::sparse::tracking::RawTrack;
use m4_core::nalgebra::{Matrix3, Vector3};
use m4_core::{CounterRng, Se3, Silent, Sim3, exp_so3};
use std::collections::BTreeSet;

const FRAMES: usize = 132;
const FOCAL: f64 = 520.0;
/// Frames that show earlier points again.
const AGAIN: [usize; 3] = [122, 126, 130];

/// World to camera: 3 degrees per frame around the origin, 3 units away, looking outwards.
fn pose(frame: usize) -> Se3<f64> {
    let (s, c) = (3.0 * frame as f64).to_radians().sin_cos();
    let rotation = Matrix3::new(c, 0.0, -s, 0.0, 1.0, 0.0, s, 0.0, c);
    Se3 {
        rotation,
        translation: Vector3::new(0.0, 0.0, -3.0),
    }
}

fn view(x: &Vector3<f64>, frame: usize) -> Option<[f64; 2]> {
    let p = pose(frame).transform(x);
    let q = [FOCAL * p.x / p.z, FOCAL * p.y / p.z];
    let inside = q[0].abs() < WIDTH as f64 / 2.0 && q[1].abs() < HEIGHT as f64 / 2.0;
    (p.z > 0.5 && inside).then_some(q)
}

/// Tracks of points around: each time that a point comes into view it is another track.
fn tracks() -> Vec<RawTrack> {
    let mut rng = CounterRng::new(3, 0, 0);
    let mut tracks = Vec::new();
    for _ in 0..900 {
        let (angle, away) = (
            std::f64::consts::TAU * rng.uniform(),
            6.0 + 2.0 * rng.uniform(),
        );
        let x = Vector3::new(
            away * angle.sin(),
            2.0 * rng.uniform() - 1.0,
            away * angle.cos(),
        );
        let mut noisy = |at: [f64; 2]| at.map(|v| v + 0.1 * rng.normal());
        let mut of_point: Vec<RawTrack> = Vec::new();
        for frame in 0..FRAMES {
            let Some(at) = view(&x, frame) else { continue };
            match of_point.last_mut().filter(|t| t.end() == frame) {
                Some(track) => track.seen.push(noisy(at)),
                None => of_point.push(RawTrack {
                    first: frame,
                    seen: vec![noisy(at)],
                    again: Vec::new(),
                }),
            }
        }
        if of_point.len() > 1 {
            let later = AGAIN.into_iter().filter(|&i| i >= of_point[1].first);
            let later = later.filter_map(|i| Some((i, noisy(view(&x, i)?))));
            of_point[0].again = later.collect();
        }
        tracks.extend(of_point.into_iter().filter(|t| t.seen.len() > 1));
    }
    tracks
}

/// Cameras that drift: heading by 6 degrees and scale by a tenth until the end.
fn drifted() -> Vec<Option<Se3<f64>>> {
    let drift = |i: usize| {
        let share = i as f64 / FRAMES as f64;
        (
            exp_so3(&Vector3::new(0.0, 0.1 * share, 0.0)),
            1.1_f64.powf(share),
        )
    };
    let mut centre = pose(0).inverse().translation;
    let one = |i: usize| {
        let c2w = pose(i).inverse();
        let (turn, scale) = drift(i);
        if let Some(before) = i.checked_sub(1) {
            centre += turn * (c2w.translation - pose(before).inverse().translation) * scale;
        }
        let c2w = Se3 {
            rotation: turn * c2w.rotation,
            translation: centre,
        };
        Some(c2w.inverse())
    };
    (0..FRAMES).map(one).collect()
}

/// Root mean square distance of the cameras from the true ones, after alignment.
fn error(map: &Map) -> f64 {
    let centres = |pose: Se3<f64>| pose.inverse().translation;
    let ours: Vec<_> = map.poses.iter().flatten().copied().map(centres).collect();
    let want: Vec<_> = (0..FRAMES).map(|i| centres(pose(i))).collect();
    let fit = Sim3::umeyama(&ours, &want).expect("a similarity");
    let pairs = ours.iter().zip(&want);
    let squared = pairs.map(|(a, b)| (fit.transform(a) - b).norm_squared());
    (squared.sum::<f64>() / FRAMES as f64).sqrt()
}

fn frames_again(tracks: &[RawTrack]) -> BTreeSet<usize> {
    tracks
        .iter()
        .flat_map(|t| &t.again)
        .map(|(frame, _)| *frame)
        .collect()
}

/// The error before and after loops are closed, and the frames whose sightings are kept.
fn closed(tracks: Vec<RawTrack>) -> (f64, f64, BTreeSet<usize>) {
    let config = SparseConfig::default();
    let lenses = Lenses(Vec::new());
    let mut problem = SparseProblem::new(features(tracks, FRAMES), None, lenses, &config, &Silent);
    let mut map = Map::new(FOCAL, drifted(), &problem.tracks);
    map.triangulate(&problem.tracks, &[], &problem.limits);
    let before = error(&map);
    problem.close_loops(&mut map).unwrap();
    (before, error(&map), frames_again(&problem.tracks))
}

#[test]
fn drift_is_taken_back_where_a_place_is_seen_again() {
    let (before, after, frames) = closed(tracks());
    assert!(before > 0.1, "{before}");
    assert!(after < 0.1 * before, "{before} {after}");
    assert_eq!(frames, BTreeSet::from(AGAIN));
}

#[test]
fn sightings_that_agree_on_no_place_are_dropped() {
    let mut tracks = tracks();
    let mut rng = CounterRng::new(4, 0, 0);
    for (frame, at) in tracks.iter_mut().flat_map(|t| &mut t.again) {
        if *frame == AGAIN[1] {
            *at = [WIDTH, HEIGHT].map(|n| n as f64 * (rng.uniform() - 0.5));
        }
    }
    let (before, after, frames) = closed(tracks.clone());
    assert!(after < 0.1 * before, "{before} {after}");
    assert_eq!(frames, BTreeSet::from([AGAIN[0], AGAIN[2]]));
    // nothing is seen again: nothing changes
    for track in &mut tracks {
        track.again.clear();
    }
    let (before, after, frames) = closed(tracks);
    assert!(before == after && frames.is_empty());
}
