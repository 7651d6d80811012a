//! Estimates a zoom of a static or turning camera: a rotation and a focal length per frame, no
//! points.
//!
//! Frames are then related by infinite homographies `K_t R_t K_0^-1` (Hartley and Zisserman 2004,
//! section 8.4), whatever the scene. Something flat towards which the camera walks looks the same,
//! a scene with depth does not: what is near grows faster.

use super::bundle::Jacobian;
use super::lens::Bend;
use super::rotation::{MIN_TRACKS, matches, ray, spread};
use super::tracking::RawTrack;
use super::two_view::Match;
use m4_core::{
    Se3, exp_so3, median,
    nalgebra::{Matrix3, Matrix4, Vector3, Vector4},
};
use rayon::prelude::*;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Aim {
    /// World to camera.
    pub rotation: Matrix3<f64>,
    /// Working pixels.
    pub focal: f64,
}

/// A camera that stays in place and zooms.
#[derive(Debug, Clone)]
pub(crate) struct Zooming {
    /// One per frame; the world is the camera of frame 0.
    pub aims: Vec<Aim>,
    /// False where the turn says so little about the focal length of frame 0 that the assumed one
    /// was kept.
    pub focal_observed: bool,
}

/// Greatest median distance, pixels, that a turn and a zoom may leave.
pub(crate) const MOST_PX: f64 = 0.5;
/// Greatest over least focal length from which on a lens zooms.
const LEAST_RATIO: f64 = 1.03;
/// Frames compared at first, and those over which the focal length of frame 0 is looked for.
const GLANCE: usize = 12;
const LOOK: usize = 48;
/// How often directions of tracks and aims of frames are fitted in turn.
const ROUNDS: usize = 10;
/// Error of another focal length against that of the assumed one from which on it is believed.
const BETTER: f64 = 0.8;

/// How a lens zooms, if turns and zooms alone explain the tracks; `focals` are candidates for frame
/// 0, working pixels.
pub(crate) fn zooming(
    tracks: &[RawTrack],
    frames: usize,
    focals: &[f64],
    assumed: f64,
    cauchy_px: f64,
) -> Option<Zooming> {
    // A quick test rejects most clips: a camera that translates leaves parallax somewhere.
    let few: Vec<Vec<Match>> = spread(frames, GLANCE)
        .windows(2)
        .map(|w| matches(tracks, w[0], w[1]))
        .collect();
    let tried = focals.par_iter().chain(rayon::iter::once(&assumed));
    if !tried.any(|&focal| glance(&few, focal).is_some()) {
        return None;
    }
    let picked = spread(frames, LOOK);
    let fit = |&focal: &f64| {
        let aims = aims(tracks, &picked, focal, cauchy_px)?;
        Some((median_error(tracks, &picked, &aims)?, focal))
    };
    let candidates: Vec<Option<(f64, f64)>> = focals
        .par_iter()
        .chain(rayon::iter::once(&assumed))
        .map(fit)
        .collect();
    let error_assumed = candidates
        .last()
        .copied()
        .flatten()
        .map_or(f64::INFINITY, |c| c.0);
    let best = candidates
        .iter()
        .flatten()
        .min_by(|a, b| a.0.total_cmp(&b.0))?;
    let observed = best.0 < BETTER * error_assumed;
    let focal = if observed { best.1 } else { assumed };
    let all: Vec<usize> = (0..frames).collect();
    let aims = aims(tracks, &all, focal, cauchy_px)?;
    let (least, most) = range(&aims);
    let good = median_error(tracks, &all, &aims)? < MOST_PX && most / least > LEAST_RATIO;
    good.then_some(Zooming {
        aims,
        focal_observed: observed,
    })
}

pub(crate) fn range(aims: &[Aim]) -> (f64, f64) {
    let focals = aims.iter().map(|a| a.focal);
    focals.fold((f64::INFINITY, 0.0), |(low, high), f| {
        (low.min(f), high.max(f))
    })
}

/// Goes over a few frames of the clip; `None` where turns and zooms leave too much, or nothing
/// zooms.
fn glance(pairs: &[Vec<Match>], focal: f64) -> Option<()> {
    let (mut at, mut least, mut most) = (focal, focal, focal);
    for matches in pairs.iter().filter(|matches| matches.len() >= MIN_TRACKS) {
        let next = step(matches, at, 1.0)?;
        let mut errors: Vec<f64> = matches
            .iter()
            .map(|m| error_px(&next, &ray(m.0, at), m.1))
            .collect();
        // Rays through a wrong focal length leave a little more than the true one would.
        if median(&mut errors)? > 2.0 * MOST_PX {
            return None;
        }
        at = next.focal;
        (least, most) = (least.min(at), most.max(at));
    }
    (most / least > LEAST_RATIO).then_some(())
}

/// The turn and the focal length of the second frame, given that of the first.
fn step(matches: &[Match], focal: f64, cauchy_px: f64) -> Option<Aim> {
    let sightings: Vec<_> = matches.iter().map(|m| (ray(m.0, focal), m.1)).collect();
    // Distances between points grow with the focal length, however the camera turns (a little).
    let half = matches.len() / 2;
    let distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let mut growth: Vec<f64> = (0..half)
        .map(|i| (&matches[i], &matches[i + half]))
        .filter(|(a, b)| distance(a.0, b.0) > 10.0)
        .map(|(a, b)| distance(a.1, b.1) / distance(a.0, b.0))
        .collect();
    let start = Aim {
        rotation: Matrix3::identity(),
        focal: focal * median(&mut growth).filter(|g| *g > 0.0).unwrap_or(1.0),
    };
    fit(&sightings, &start, true, &[1e6, 16.0, 4.0, cauchy_px])
}

fn error_px(aim: &Aim, direction: &Vector3<f64>, at: [f64; 2]) -> f64 {
    let p = aim.rotation * direction;
    if p.z > 1e-6 {
        (aim.focal * p.x / p.z - at[0]).hypot(aim.focal * p.y / p.z - at[1])
    } else {
        f64::INFINITY
    }
}

/// Gauss-Newton steps under Cauchy losses of shrinking scales, two a scale; `None` for too few
/// sightings.
fn fit(
    sightings: &[(Vector3<f64>, [f64; 2])],
    start: &Aim,
    free_focal: bool,
    scales_px: &[f64],
) -> Option<Aim> {
    if sightings.len() < 4 {
        return None;
    }
    let mut aim = *start;
    for &cauchy_px in scales_px.iter().flat_map(|s| [s, s]) {
        let pose = Se3 {
            rotation: aim.rotation,
            translation: Vector3::zeros(),
        };
        let (mut h, mut g) = (Matrix4::zeros(), Vector4::zeros());
        for (direction, at) in sightings {
            let j = Jacobian::new(&pose, direction, aim.focal, Bend::NONE, *at, cauchy_px);
            for (row, r) in [0, 1].map(|k| (k, j.residual[k])) {
                let by = Vector4::new(
                    j.pose[(row, 3)],
                    j.pose[(row, 4)],
                    j.pose[(row, 5)],
                    j.lens[0][row],
                );
                h += by * by.transpose();
                g += by * r;
            }
        }
        if !free_focal {
            for k in 0..3 {
                (h[(3, k)], h[(k, 3)]) = (0.0, 0.0);
            }
            g[3] = 0.0;
        }
        for k in 0..4 {
            h[(k, k)] += 1e-9 * h[(k, k)] + 1e-12;
        }
        let d = -h.cholesky()?.solve(&g);
        aim.rotation = exp_so3(&Vector3::new(d[0], d[1], d[2])) * aim.rotation;
        aim.focal *= d[3].clamp(-0.3, 0.3).exp();
    }
    (aim.focal.is_finite() && aim.rotation.iter().all(|v| v.is_finite())).then_some(aim)
}

/// Aims chained through `picked` frames, then refined so that every track has one direction in the
/// world. The focal length of the first frame stays. `None` where two frames share too little.
fn aims(tracks: &[RawTrack], picked: &[usize], focal: f64, cauchy_px: f64) -> Option<Vec<Aim>> {
    let first = Aim {
        rotation: Matrix3::identity(),
        focal,
    };
    let mut aims = vec![first];
    let mut last = first;
    for pair in picked.windows(2) {
        let matches = matches(tracks, pair[0], pair[1]);
        if matches.len() < MIN_TRACKS {
            return None;
        }
        let next = step(&matches, last.focal, cauchy_px)?;
        last = Aim {
            rotation: next.rotation * last.rotation,
            focal: next.focal,
        };
        aims.push(last);
    }
    for _ in 0..ROUNDS {
        let directions: Vec<Option<Vector3<f64>>> =
            tracks.iter().map(|t| direction(t, picked, &aims)).collect();
        let refined: Option<Vec<Aim>> = (0..picked.len())
            .into_par_iter()
            .map(|k| {
                let pairs = tracks.iter().zip(&directions);
                let sightings: Vec<_> = pairs
                    .filter_map(|(t, d)| Some(((*d)?, t.at(picked[k])?)))
                    .collect();
                fit(&sightings, &aims[k], k > 0, &[cauchy_px])
            })
            .collect();
        aims = refined?;
    }
    let world = aims[0].rotation.transpose();
    for aim in &mut aims {
        aim.rotation *= world;
    }
    Some(aims)
}

/// Mean direction of a track in the world; `None` where fewer than two of the frames see it.
fn direction(track: &RawTrack, picked: &[usize], aims: &[Aim]) -> Option<Vector3<f64>> {
    let (mut sum, mut count) = (Vector3::zeros(), 0);
    // Frames are in order: those of the track are neighbours.
    let from = picked.partition_point(|&frame| frame < track.first);
    for (&frame, aim) in picked.iter().zip(aims).skip(from) {
        let Some(at) = track.at(frame) else { break };
        sum += aim.rotation.tr_mul(&ray(at, aim.focal));
        count += 1;
    }
    (count > 1).then(|| sum.normalize())
}

/// Median over all tracks of the median distance to their direction.
fn median_error(tracks: &[RawTrack], picked: &[usize], aims: &[Aim]) -> Option<f64> {
    let mut all: Vec<f64> = tracks
        .par_iter()
        .filter_map(|track| {
            let direction = direction(track, picked, aims)?;
            let pairs = picked.iter().zip(aims);
            let mut errors: Vec<f64> = pairs
                .filter_map(|(&frame, aim)| Some(error_px(aim, &direction, track.at(frame)?)))
                .collect();
            median(&mut errors)
        })
        .collect();
    median(&mut all)
}

#[cfg(test)]
mod tests {
    use super::{range, zooming};
    use crate::classical::sparse::tracking::RawTrack;
    use m4_core::{CounterRng, exp_so3, log_so3, nalgebra::Vector3};

    const FRAMES: usize = 20;

    /// Sightings of a room between 3 and 9 away (`flat`: 6 away) by a camera that turns, zooms by
    /// `zoom` and walks ahead by `ahead` over the clip; noise of 0.1 pixels, a tenth of the tracks
    /// anywhere.
    fn tracks(turn: f64, zoom: f64, ahead: f64, flat: bool) -> Vec<RawTrack> {
        let mut rng = CounterRng::new(3, 0, 0);
        (0..300)
            .map(|i| {
                let z = if flat { 6.0 } else { 3.0 + 6.0 * rng.uniform() };
                let x = Vector3::new(0.3 * z * rng.normal(), 0.25 * z * rng.normal(), z);
                let positions = (0..FRAMES).map(|k| {
                    let s = k as f64 / (FRAMES - 1) as f64;
                    let p = exp_so3(&Vector3::new(0.2 * turn * s, turn * s, 0.0))
                        * (x - Vector3::new(0.0, 0.0, ahead * s));
                    let f = 400.0 * zoom.powf(s);
                    let off = if i % 10 == 0 { 10.0 } else { 0.1 };
                    [
                        f * p.x / p.z + off * rng.normal(),
                        f * p.y / p.z + off * rng.normal(),
                    ]
                });
                RawTrack {
                    first: 0,
                    seen: positions.collect(),
                    again: Vec::new(),
                }
            })
            .collect()
    }

    const FOCALS: [f64; 5] = [250.0, 320.0, 400.0, 500.0, 640.0];

    #[test]
    fn a_zoom_and_a_turn_are_measured() {
        let actual =
            zooming(&tracks(0.5, 2.0, 0.0, false), FRAMES, &FOCALS, 500.0, 1.0).expect("a zoom");
        assert!(actual.focal_observed);
        let last = actual.aims[FRAMES - 1];
        assert!((last.focal / 800.0 - 1.0).abs() < 0.01, "{}", last.focal);
        let turn = log_so3(&last.rotation);
        assert!((turn - Vector3::new(0.1, 0.5, 0.0)).norm() < 5e-3, "{turn}");
        // The other way round, without a turn: the assumed focal length is kept, the ratio is
        // known.
        let actual =
            zooming(&tracks(0.0, 0.6, 0.0, false), FRAMES, &FOCALS, 450.0, 1.0).expect("a zoom");
        let (least, most) = range(&actual.aims);
        assert!(
            !actual.focal_observed && (most - 450.0).abs() < 1.0,
            "{least} {most}"
        );
        assert!((least / most - 0.6).abs() < 0.005, "{least} {most}");
    }

    #[test]
    fn forward_motion_with_parallax_is_not_a_zoom() {
        let zooms = |tracks: &[RawTrack]| zooming(tracks, FRAMES, &FOCALS, 400.0, 1.0).is_some();
        assert!(!zooms(&tracks(0.1, 1.0, 1.5, false)));
        assert!(
            zooms(&tracks(0.0, 1.0, 1.5, true)),
            "something flat grows as if by a zoom"
        );
        assert!(
            !zooms(&tracks(0.3, 1.0, 0.0, false)),
            "a turn alone is none"
        );
    }
}
