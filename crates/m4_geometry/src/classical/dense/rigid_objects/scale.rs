//! The one number that the motion of a part does not reveal.

use super::rigid::Shape;
use super::{OCCLUSION_RANGE, Tracklet, WorkingClip};
use crate::classical::dense::moving_depth::{BELOW_PX, FEET_SHARE, HIDDEN_QUANTILE};
use m4_core::quantile;
use nalgebra::Vector3;

/// Share of the frames whose lower bound of the scale the scale exceeds, where nothing but bounds
/// is known.
const BOUND_QUANTILE: f64 = 0.75;
/// The same of frames in which a part stands on the ground: they are as often too near as too far.
const TOUCH_QUANTILE: f64 = 0.5;
/// A region has ground under it where the background there comes nearer by more than this share of
/// its disparity per row.
const GROUND_SLOPE: f32 = 0.003;
/// Least share of its frames in which a region must have ground under it for its scale to be known.
const STANDING_SHARE: f32 = 0.3;
/// A region whose path, at its best scale, is shorter than this share of what the path of the
/// camera would make of it at another scale stays in place, and that is its scale, unless it is out
/// of [`OCCLUSION_RANGE`].
const STILL_REST: f64 = 0.12;
/// Rounds of the robust fit of a fixed place, and the residual that counts half, in medians
/// (Cauchy).
const ROUNDS: usize = 5;
const CAUCHY: f64 = 2.0;
/// Over how many rows the slope of the ground is read.
const SLOPE_ROWS: usize = 6;

/// What the frames of a part say about its scale: factors on its disparities.
pub(super) struct Reading {
    /// Its own disparity, before any factor: the median over frames.
    typical: f32,
    /// The least factor, by what the part hides and what lies under it.
    bound: f32,
    /// The factor by the ground that it stands on, or because it stays where it is.
    factor: Option<f32>,
}

/// Reads the scale of one part.
///
/// In every frame the part is at least as near as what it hides: a lower bound of the factor, so a
/// high quantile of all frames is one, too. Where there is ground at its feet it touches that, but
/// for the errors of its outline and its shape: the median of those frames. All are in one unit.
pub(super) fn read(clip: &WorkingClip<'_>, tracklet: &Tracklet, shape: &Shape) -> Option<Reading> {
    let frames = tracklet.parts.len();
    let (mut all, mut standing, mut typical) = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..frames {
        let Some(bound) = bound(clip, tracklet, shape, k) else {
            continue;
        };
        all.push(bound.factor);
        typical.push(bound.typical);
        standing.extend(bound.standing());
    }
    let share = standing.len() as f32 / frames as f32;
    let (bound, typical) = (
        quantile(&mut all, BOUND_QUANTILE)?,
        quantile(&mut typical, 0.5)?,
    );
    let touch = quantile(&mut standing, TOUCH_QUANTILE).filter(|_| share >= STANDING_SHARE);
    // Nothing but the right factor makes a part stay where it is while the camera passes it.
    let still = in_place(clip, tracklet, shape)
        .map(|(factor, rest)| (factor as f32, rest))
        .filter(|&(factor, rest)| rest < STILL_REST && factor > bound / OCCLUSION_RANGE);
    Some(Reading {
        typical,
        bound,
        factor: still.map(|(factor, _)| factor).or(touch),
    })
}

/// The factors of all parts. What neither stands nor stays, because it flies, is taken to be about
/// as near as what does: a guess, but a better one than the wall behind it.
pub(super) fn settle(readings: &[&Reading]) -> Vec<f32> {
    let mut near: Vec<f32> = readings
        .iter()
        .filter_map(|r| r.factor.map(|f| f * r.typical))
        .collect();
    let near = quantile(&mut near, 0.5);
    let guess = |r: &Reading| near.map_or(r.bound, |d| r.bound.max(d / r.typical));
    readings
        .iter()
        .map(|r| r.factor.unwrap_or_else(|| guess(r)))
        .collect()
}

/// The factor by the ground under a part in one frame, if it is ground.
pub(super) fn standing(
    clip: &WorkingClip<'_>,
    tracklet: &Tracklet,
    shape: &Shape,
    k: usize,
) -> Option<f32> {
    bound(clip, tracklet, shape, k)?.standing()
}

/// Fills what is not known between what is, evenly in ratios, and carries the first and the last
/// on.
pub(super) fn between(factors: &[Option<f32>], out: &mut [f32]) {
    let at: Vec<(usize, f32)> = factors
        .iter()
        .enumerate()
        .filter_map(|(k, v)| v.map(|v| (k, v)))
        .collect();
    for (k, out) in out.iter_mut().enumerate() {
        let next = at.partition_point(|(i, _)| *i < k);
        let (before, after) = (next.checked_sub(1).and_then(|i| at.get(i)), at.get(next));
        *out = match (before, after) {
            (Some(&(i, a)), Some(&(j, b))) => a * (b / a).powf((k - i) as f32 / (j - i) as f32),
            (Some(&(_, v)), None) | (None, Some(&(_, v))) => v,
            (None, None) => *out,
        };
    }
}

/// What one frame says.
struct Bound {
    /// By what the part hides and what lies under it.
    factor: f32,
    /// By what lies under it alone.
    feet: f32,
    /// Median disparity of the part.
    typical: f32,
    /// How fast what lies under the part comes nearer downwards, as a share of its disparity a row:
    /// a wall's is about 0.
    slope: f32,
}

impl Bound {
    /// The factor by the ground under the part, if that is ground. What it seems to hide says
    /// nothing then: beside something static in front of the part, the background that is filled in
    /// behind it is as near as that.
    fn standing(&self) -> Option<f32> {
        (self.slope > GROUND_SLOPE && self.feet > 0.0).then_some(self.feet)
    }
}

fn bound(clip: &WorkingClip<'_>, tracklet: &Tracklet, shape: &Shape, k: usize) -> Option<Bound> {
    let (w, h) = (clip.width, clip.height);
    let background = &clip.disparity[tracklet.first + k];
    let pixels = &tracklet.parts[k];
    let row = |i: u32| i as usize / w;
    let (top, bottom) = (row(*pixels.first()?), row(*pixels.last()?));
    let feet_from = bottom - ((bottom - top) as f32 * FEET_SHARE) as usize;
    let (mut feet, mut hidden, mut own, mut slope) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (p, d) in shape.values(clip, k) {
        own.push(d);
        hidden.push(background[p as usize] / d);
        if row(p) + 2 >= feet_from && bottom + 1 + BELOW_PX < h {
            let below = (bottom + BELOW_PX).min(h - 1);
            let ground = |y: usize| background[y * w + p as usize % w];
            feet.push(ground(below) / d);
            let further = (below + SLOPE_ROWS).min(h - 1);
            slope.push((ground(further) / ground(below) - 1.0) / (further - below).max(1) as f32);
        }
    }
    let feet = quantile(&mut feet, 0.5).unwrap_or(0.0);
    let hidden = quantile(&mut hidden, HIDDEN_QUANTILE).unwrap_or(0.0);
    let factor = feet.max(hidden);
    (factor > 0.0).then_some(Bound {
        factor,
        feet,
        typical: quantile(&mut own, 0.5)?,
        slope: quantile(&mut slope, 0.5).unwrap_or(0.0),
    })
}

/// The factor on the disparities of a part that keeps its middle closest to one place, and what is
/// left of the path of its middle, over the path that the wrong factor 0 would leave.
///
/// With disparities times `q`, the middle is at `c + v / q`, `c` being the camera's centre and `v`
/// where the adjusted shape puts the middle, seen from there. Multiplied by `q` the way is linear
/// in `q`, and its error no longer favours parts close to the camera (Ozden, Schindler and Van Gool
/// 2010 on the scale of parts).
fn in_place(clip: &WorkingClip<'_>, tracklet: &Tracklet, shape: &Shape) -> Option<(f64, f64)> {
    let middle = shape.middle(clip)?;
    let (mut c, mut v) = (Vec::new(), Vec::new());
    for k in 0..tracklet.parts.len() {
        let c2w = clip.cameras[tracklet.first + k].c2w;
        c.push(c2w.translation);
        v.push(c2w.rotation * shape.poses[k].transform(&middle));
    }
    fixed(&c, &v)
}

/// The factor `q` for which `q c + v` stays closest to one place, and what is left of the path of
/// `v`, as a share; a few frames may be wrong. `None` where nothing moves.
fn fixed(c: &[Vector3<f64>], v: &[Vector3<f64>]) -> Option<(f64, f64)> {
    let mut weights = vec![1.0; c.len()];
    let mut out = None;
    for _ in 0..ROUNDS {
        let mean = |values: &[Vector3<f64>]| -> Vector3<f64> {
            values
                .iter()
                .zip(&weights)
                .map(|(v, w)| v * *w)
                .sum::<Vector3<f64>>()
                / weights.iter().sum::<f64>()
        };
        let (c_mean, v_mean) = (mean(c), mean(v));
        let dot = |a: &[Vector3<f64>],
                   a_mean: Vector3<f64>,
                   b: &[Vector3<f64>],
                   b_mean: Vector3<f64>|
         -> f64 {
            a.iter()
                .zip(b)
                .zip(&weights)
                .map(|((a, b), w)| w * (a - a_mean).dot(&(b - b_mean)))
                .sum()
        };
        let (cc, cv, vv) = (
            dot(c, c_mean, c, c_mean),
            dot(c, c_mean, v, v_mean),
            dot(v, v_mean, v, v_mean),
        );
        if !(cc > 0.0 && vv > 0.0) {
            return None;
        }
        out = Some((-cv / cc, ((vv - cv * cv / cc).max(0.0) / vv).sqrt()));
        // frames whose mask is wrong count little
        let off =
            |c: &Vector3<f64>, v: &Vector3<f64>| (v - v_mean - (c - c_mean) * (cv / cc)).norm();
        let off: Vec<f64> = c.iter().zip(v).map(|(c, v)| off(c, v)).collect();
        let typical = f64::from(quantile(
            &mut off.iter().map(|off| *off as f32).collect::<Vec<_>>(),
            0.5,
        )?);
        weights = off
            .iter()
            .map(|off| 1.0 / (1.0 + (off / (CAUCHY * typical.max(1e-12))).powi(2)))
            .collect();
    }
    out
}

#[cfg(test)]
mod tests {
    use super::{Vector3, fixed};

    #[test]
    fn a_fixed_place_is_found_although_a_few_frames_are_wrong() {
        let c: Vec<Vector3<f64>> = (0..40)
            .map(|k| 0.05 * f64::from(k))
            .map(|t| Vector3::new(t, 0.2 * (3.0 * t).sin(), 0.1 * t))
            .collect();
        let place = Vector3::new(0.5, -0.2, 4.0);
        let mut v: Vec<Vector3<f64>> = c.iter().map(|c| place - c * 1.5).collect();
        for v in &mut v[..4] {
            *v += Vector3::new(0.6, 0.3, -0.8);
        }
        let (factor, rest) = fixed(&c, &v).unwrap();
        assert!(
            (factor - 1.5).abs() < 0.01 && rest < 0.05,
            "{factor} {rest}"
        );
        // an object in motion has no such place, and a camera that stands says nothing
        let moves: Vec<Vector3<f64>> = (0..40)
            .map(|k| 0.3 * f64::from(k))
            .map(|t| Vector3::new(t.sin(), t.cos(), 0.0))
            .collect();
        assert!(fixed(&c, &moves).unwrap().1 > 0.5);
        assert_eq!(fixed(&vec![place; 40], &moves), None);
    }
}
