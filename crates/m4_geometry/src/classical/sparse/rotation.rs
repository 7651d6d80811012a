//! Frames related by a turn of the camera alone, what is left when that turn is taken out, and the
//! thresholds that follow from it.

use super::map::{MOST_FRAMES, RAYLEIGH_MEDIAN};
use super::tracking::RawTrack;
use super::two_view::Match;
use m4_core::median;
use m4_core::nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// Fields of view tried where none is given. 12: docs/spec/front-end.md 7.1.
const FOV_CANDIDATES: usize = 12;
/// Least horizontal field of view tried, degrees. 35: docs/spec/front-end.md 7.1.
const MIN_FOV_DEG: f64 = 35.0;
/// Greatest horizontal field of view tried, degrees. 100: docs/spec/front-end.md 7.1.
const MAX_FOV_DEG: f64 = 100.0;
/// A frame becomes a keyframe when the median parallax to the last one, rotation taken out, exceeds
/// this share of the image width. 0.015: docs/spec/front-end.md 7.1.
pub(super) const KEYFRAME_PARALLAX: f64 = 0.015;
/// ... or when fewer than this share of the last keyframe's tracks are still seen.
const KEYFRAME_SURVIVAL: f64 = 0.6;
/// Most keyframes of every [`MOST_FRAMES`] frames; the clip is cut into this many where more are
/// asked for.
const MAX_KEYFRAMES: usize = 40;

/// Fewest tracks from one frame to the next.
pub(super) const MIN_TRACKS: usize = 20;

/// The direction of working pixels `at`.
pub(crate) fn ray(at: [f64; 2], focal: f64) -> Vector3<f64> {
    Vector3::new(at[0], at[1], focal).normalize()
}

/// The rotation that fits a sum of outer products of directions after and before it best (Wahba's
/// problem).
pub(crate) fn nearest_rotation(sum: Matrix3<f64>) -> Option<Matrix3<f64>> {
    let svd = sum.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = (u.determinant() * v_t.determinant()).signum();
    Some(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t)
}

/// Tracks seen in both frames, and where.
pub(crate) fn matches(tracks: &[RawTrack], a: usize, b: usize) -> Vec<Match> {
    tracks
        .iter()
        .filter_map(|t| Some((t.at(a)?, t.at(b)?)))
        .collect()
}

/// The turn that maps rays of the first frame to rays of the second.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Turn {
    /// First camera to second camera.
    pub rotation: Matrix3<f64>,
    /// Median distance that is left, pixels: parallax, where the scene is static.
    pub parallax_px: f64,
}

/// Iteratively re-weighted solution of Wahba's problem; the Cauchy scale shrinks from 16 pixels to
/// 1. `None` for fewer than 3 matches.
pub(crate) fn turn(matches: &[Match], focal: f64) -> Option<Turn> {
    if matches.len() < 3 {
        return None;
    }
    let rays: Vec<(Vector3<f64>, Vector3<f64>)> = matches
        .iter()
        .map(|m| (ray(m.0, focal), ray(m.1, focal)))
        .collect();
    let mut rotation = Matrix3::identity();
    let residual = |rotation: &Matrix3<f64>, (a, _): &(Vector3<f64>, Vector3<f64>), m: &Match| {
        let p = rotation * a;
        if p.z > 1e-6 {
            (focal * p.x / p.z - m.1[0]).hypot(focal * p.y / p.z - m.1[1])
        } else {
            focal
        }
    };
    for step in 0..12 {
        let scale = if step == 0 {
            1e9
        } else {
            (16.0 * 0.7_f64.powi(step)).max(1.0)
        };
        let mut sum = Matrix3::zeros();
        for (pair, m) in rays.iter().zip(matches) {
            let weight = 1.0 / (1.0 + (residual(&rotation, pair, m) / scale).powi(2));
            sum += pair.1 * pair.0.transpose() * weight;
        }
        rotation = nearest_rotation(sum)?;
    }
    let mut left: Vec<f64> = rays
        .iter()
        .zip(matches)
        .map(|(r, m)| residual(&rotation, r, m))
        .collect();
    Some(Turn {
        rotation,
        parallax_px: median(&mut left)?,
    })
}

/// Focal lengths in working pixels for the fields of view to try, widest lens first.
pub(crate) fn focal_candidates(width: usize) -> Vec<f64> {
    // Evenly spaced in the logarithm of the focal length.
    let at = |deg: f64| focal_from_fov(width, deg).ln();
    let (low, high) = (at(MAX_FOV_DEG), at(MIN_FOV_DEG));
    (0..FOV_CANDIDATES)
        .map(|i| (low + (high - low) * (i as f64 + 0.5) / FOV_CANDIDATES as f64).exp())
        .collect()
}

/// Focal length in pixels of an image `width` pixels wide.
pub(crate) fn focal_from_fov(width: usize, fov_deg: f64) -> f64 {
    0.5 * width as f64 / (0.5 * fov_deg.to_radians()).tan()
}

/// How much the image moves over the clip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sway {
    /// Greatest over all pairs of frames of the 60th percentile of displacement, pixels.
    pub motion_px: f64,
    /// Greatest over all pairs of frames of the median parallax, pixels, for the focal length that
    /// makes it least.
    pub parallax_px: f64,
    /// That focal length.
    pub focal: f64,
    /// Greatest turn between two frames for that focal length, radians.
    pub turn_rad: f64,
}

/// Compares up to 12 frames spread over the clip, each with each.
pub(crate) fn sway(tracks: &[RawTrack], frames: usize, focals: &[f64]) -> Option<Sway> {
    let picked = spread(frames, 12);
    let mut pairs: Vec<Vec<Match>> = Vec::new();
    for (i, &a) in picked.iter().enumerate() {
        for &b in &picked[i + 1..] {
            let matches = matches(tracks, a, b);
            if matches.len() >= MIN_TRACKS {
                pairs.push(matches);
            }
        }
    }
    let displacement = |pair: &Vec<Match>| {
        let mut lengths: Vec<f64> = pair
            .iter()
            .map(|m| (m.1[0] - m.0[0]).hypot(m.1[1] - m.0[1]))
            .collect();
        let k = lengths.len() * 6 / 10;
        *lengths.select_nth_unstable_by(k, f64::total_cmp).1
    };
    let motion_px = pairs.iter().map(displacement).reduce(f64::max)?;
    let by_focal: Vec<Sway> = focals
        .par_iter()
        .map(|&focal| {
            let turns = pairs.iter().filter_map(|pair| turn(pair, focal));
            let (parallax_px, turn_rad) = turns.fold((0.0_f64, 0.0_f64), |(p, w), t| {
                let angle = (0.5 * (t.rotation.trace() - 1.0)).clamp(-1.0, 1.0).acos();
                (p.max(t.parallax_px), w.max(angle))
            });
            Sway {
                motion_px,
                parallax_px,
                focal,
                turn_rad,
            }
        })
        .collect();
    by_focal
        .into_iter()
        .min_by(|a, b| a.parallax_px.total_cmp(&b.parallax_px))
}

/// At most `count` of `0..n`, evenly spread, first and last among them.
pub(crate) fn spread(n: usize, count: usize) -> Vec<usize> {
    if n <= count {
        return (0..n).collect();
    }
    (0..count)
        .map(|i| i * (n - 1) / (count - 1).max(1))
        .collect()
}

/// Keyframes: frame 0, then a frame whenever the parallax to the last keyframe or the loss of
/// tracks asks for one, and the last frame; `parallax` as [`KEYFRAME_PARALLAX`].
pub(crate) fn keyframes(
    tracks: &[RawTrack],
    frames: usize,
    width: usize,
    focal: f64,
    parallax: f64,
) -> Vec<usize> {
    let most = MAX_KEYFRAMES * frames.div_ceil(MOST_FRAMES);
    let mut threshold = parallax * width as f64;
    loop {
        let mut keys = vec![0];
        let mut last = 0;
        for frame in 1..frames {
            let matches = matches(tracks, last, frame);
            let started = tracks
                .iter()
                .filter(|t| t.at(last).is_some())
                .count()
                .max(1);
            let lost = (matches.len() as f64) < KEYFRAME_SURVIVAL * started as f64;
            if lost || turn(&matches, focal).is_none_or(|t| t.parallax_px > threshold) {
                keys.push(frame);
                last = frame;
            }
        }
        if last + 1 != frames {
            keys.push(frames - 1);
        }
        if keys.len() <= most {
            return keys;
        }
        // Loss of tracks cannot be argued with: then every n-th frame it is.
        if threshold > 0.2 * width as f64 {
            return spread(frames, most);
        }
        threshold *= 1.5;
    }
}

/// Bundle adjustment of all frames has a loss as wide as this many robust standard deviations of
/// the residuals. 2.385: 95 % efficiency on normal errors (Holland and Welsch 1977).
const CAUCHY_DEVIATIONS: f64 = 2.385;

/// Thresholds that follow how much parallax there is and how large the residuals are.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limits {
    /// Scale of the Cauchy loss of bundle adjustment, working pixels. 1 while the map grows.
    pub cauchy_px: f64,
    /// Points whose rays meet at less than this are not triangulated, degrees. 1.5:
    /// docs/spec/front-end.md 7.1. In clips with so little parallax that this would leave few
    /// points, half the angle that the greatest median parallax stands for.
    pub min_angle_deg: f64,
    /// See [`KEYFRAME_PARALLAX`].
    pub keyframe_parallax: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            cauchy_px: 1.0,
            min_angle_deg: 1.5,
            keyframe_parallax: KEYFRAME_PARALLAX,
        }
    }
}

impl Limits {
    /// Narrows the loss to residuals with this median, pixels: what a wide loss lets pass (slow
    /// motion, patches on two surfaces) would pull at the focal length. Never under 0.05 pixels.
    pub fn sharpen(&mut self, median_px: f64) {
        let scale = CAUCHY_DEVIATIONS * median_px / RAYLEIGH_MEDIAN;
        self.cauchy_px = self.cauchy_px.min(scale.max(0.05));
    }

    /// Little parallax asks for keyframes and rays that lie closer together; `width` is that of the
    /// working size.
    pub fn adapt(&mut self, sway: &Sway, width: usize) {
        let angle_deg = (sway.parallax_px / sway.focal).to_degrees();
        self.min_angle_deg = self.min_angle_deg.min(0.5 * angle_deg);
        self.keyframe_parallax = self
            .keyframe_parallax
            .min(0.2 * sway.parallax_px / width as f64);
    }
}

#[cfg(test)]
mod tests {
    use super::{KEYFRAME_PARALLAX, focal_candidates, keyframes, spread, sway, turn};
    use crate::classical::sparse::tracking::RawTrack;
    use m4_core::nalgebra::Vector3;
    use m4_core::{CounterRng, exp_so3};

    /// Tracks of a camera that turns by `turn` and moves by `step` per frame.
    fn tracks(frames: usize, turn: f64, step: f64, focal: f64) -> Vec<RawTrack> {
        let mut rng = CounterRng::new(9, 0, 0);
        (0..200)
            .map(|_| {
                let x = Vector3::new(
                    1.2 * rng.normal(),
                    0.9 * rng.normal(),
                    5.0 + 5.0 * rng.uniform(),
                );
                let positions = (0..frames)
                    .map(|i| {
                        let t = i as f64;
                        let p = exp_so3(&Vector3::new(0.0, turn * t, 0.3 * turn * t)) * x
                            - Vector3::new(step * t, 0.0, 0.0);
                        [focal * p.x / p.z, focal * p.y / p.z]
                    })
                    .collect();
                RawTrack {
                    first: 0,
                    seen: positions,
                    again: Vec::new(),
                }
            })
            .collect()
    }

    #[test]
    fn a_turn_is_taken_out() {
        let t = tracks(5, 0.03, 0.0, 400.0);
        let actual = turn(&super::matches(&t, 0, 4), 400.0).expect("a turn");
        assert!(actual.parallax_px < 1e-6);
        assert!((actual.rotation - exp_so3(&Vector3::new(0.0, 0.12, 0.036))).norm() < 1e-9);
    }

    #[test]
    fn sway_separates_rotation_from_translation_and_gives_focal_length() {
        let focals = focal_candidates(480);
        let turning = sway(&tracks(20, 0.02, 0.0, 400.0), 20, &focals).expect("sway");
        assert!(
            turning.parallax_px < 2.5 && turning.motion_px > 20.0,
            "{turning:?}"
        );
        assert!((turning.focal / 400.0).ln().abs() < 0.1, "{turning:?}");
        let moving = sway(&tracks(20, 0.0, 0.05, 400.0), 20, &focals).expect("sway");
        assert!(moving.parallax_px > 4.0, "{moving:?}");
    }

    #[test]
    fn keyframes_follow_parallax_alone() {
        assert_eq!(
            keyframes(
                &tracks(20, 0.02, 0.0, 400.0),
                20,
                480,
                400.0,
                KEYFRAME_PARALLAX
            ),
            [0, 19]
        );
        let moving = keyframes(
            &tracks(20, 0.0, 0.2, 400.0),
            20,
            480,
            400.0,
            KEYFRAME_PARALLAX,
        );
        assert!(moving.len() > 4, "{moving:?}");
        assert_eq!(spread(10, 4), [0, 3, 6, 9]);
    }
}
