//! The flights of a part: stretches of frames on one parabola.

use super::super::ground::Ground;
use super::RigidObject;
use super::parabola::Parabola;
use rayon::prelude::*;

/// Fewest frames of a flight.
const SHORTEST: usize = 8;
/// Most frames: a longer flight is cut, which costs little.
const LONGEST: usize = 48;
/// Noise of the middle of a part, pixels at the working size, and what of it grows with the part, a share of its radius.
const NOISE_PX: f64 = 0.15;
const NOISE_SHARE: f64 = 0.010;
/// What a frame off all parabolas costs, in variances of the noise; the same where not all of the part is seen.
const AFOOT: f64 = 2.5;
const UNSEEN: f64 = 0.5;
/// What a parabola costs.
const START: f64 = 10.0;
/// The depth of a flight is certain to this share of it, one standard deviation.
const DOUBT: f64 = 0.12;

/// An object on a parabola.
pub(super) struct Flight {
    /// Its frames, counted from the object's first.
    pub first: usize,
    pub end: usize,
    pub parabola: Parabola,
}

impl Flight {
    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.end - self.first
    }
}

/// The flights of every object at the acceleration `g`.
pub(super) fn find(objects: &[RigidObject<'_>], ground: &Ground, g: f64) -> Vec<Vec<Flight>> {
    objects.par_iter().map(|object| of_one(object, ground, g)).collect()
}

/// Cuts the frames of an object so that what lies off parabolas, what is on none, and the number of parabolas cost least.
fn of_one(object: &RigidObject<'_>, ground: &Ground, g: f64) -> Vec<Flight> {
    let n = object.depth.len();
    let noise = |first: usize, end: usize| {
        let radius = object.observations[first..end].iter().map(|s| s.radius_px).sum::<f64>() / (end - first) as f64;
        NOISE_PX + NOISE_SHARE * radius
    };
    // By frame: the least cost of all frames before it, and the flight that ends there.
    let mut cost = vec![0.0f64; n + 1];
    let mut last: Vec<Option<(usize, Parabola)>> = vec![None; n + 1];
    for end in 1..=n {
        cost[end] = cost[end - 1]
            + if object.observations[end - 1].whole {
                AFOOT
            } else {
                UNSEEN
            };
        for first in end.saturating_sub(LONGEST)..(end + 1).saturating_sub(SHORTEST) {
            let Some(parabola) = Parabola::fit(object, (first, end), ground, g) else {
                continue;
            };
            let noise = noise(first, end);
            let doubt = parabola.doubt * noise;
            if doubt.is_nan() || doubt > DOUBT {
                continue;
            }
            let off = parabola.seen as f64 * (parabola.miss_px / noise).powi(2);
            let here = cost[first] + off + START;
            if here < cost[end] {
                (cost[end], last[end]) = (here, Some((first, parabola)));
            }
        }
    }
    let mut out = Vec::new();
    let mut end = n;
    while end > 0 {
        let Some((first, parabola)) = last[end].take() else {
            end -= 1;
            continue;
        };
        out.push(Flight { first, end, parabola });
        end = first;
    }
    out
}
