//! The flights of a part (intervals of frames on one parabola), and the acceleration: one number
//! for a clip, in the unit of its cameras per frame squared.

use super::ballistic::{Parabola, RigidObject};
use super::ground::Ground;
use m4_core::quantile;
use rayon::prelude::*;

/// Shortest flight, seconds.
const SHORTEST_S: f64 = 1.0 / 3.0;
/// Longest, seconds: a longer one is cut, which costs little.
const LONGEST_S: f64 = 2.0;
/// Noise of the middle of a part, pixels at the working size, and the share of its radius that is
/// added to it.
const NOISE_PX: f64 = 0.15;
const NOISE_SHARE: f64 = 0.010;
/// Cost of a frame that is on no parabola, in variances of the noise; the same where the part is
/// partly hidden.
const OFF_PARABOLA_COST: f64 = 2.5;
const INCOMPLETE_COST: f64 = 0.5;
/// Cost of a parabola.
const PARABOLA_COST: f64 = 10.0;
/// Largest standard deviation of the depth of a flight, as a share of it.
const MOST_DEPTH_SIGMA: f64 = 0.12;

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
    objects
        .par_iter()
        .map(|object| of_one(object, ground, g))
        .collect()
}

/// Cuts the frames of an object so that what lies off parabolas, what is on none, and the number of
/// parabolas cost least.
fn of_one(object: &RigidObject<'_>, ground: &Ground, g: f64) -> Vec<Flight> {
    let n = object.depth.len();
    let [shortest, longest] = [SHORTEST_S, LONGEST_S].map(|s| object.rate.frames(s));
    let noise = |first: usize, end: usize| {
        let radius = object.observations[first..end]
            .iter()
            .map(|s| s.radius_px)
            .sum::<f64>()
            / (end - first) as f64;
        NOISE_PX + NOISE_SHARE * radius
    };
    // By frame: the least cost of all frames before it, and the flight that ends there.
    let mut cost = vec![0.0f64; n + 1];
    let mut last: Vec<Option<(usize, Parabola)>> = vec![None; n + 1];
    for end in 1..=n {
        cost[end] = cost[end - 1]
            + if object.observations[end - 1].complete {
                OFF_PARABOLA_COST
            } else {
                INCOMPLETE_COST
            };
        for first in end.saturating_sub(longest)..(end + 1).saturating_sub(shortest) {
            let Some(parabola) = Parabola::fit(object, (first, end), ground, g) else {
                continue;
            };
            let noise = noise(first, end);
            let depth_sigma = parabola.depth_sigma * noise;
            if depth_sigma.is_nan() || depth_sigma > MOST_DEPTH_SIGMA {
                continue;
            }
            let off = parabola.n_frames as f64 * (parabola.residual_px / noise).powi(2);
            let here = cost[first] + off + PARABOLA_COST;
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
        out.push(Flight {
            first,
            end,
            parabola,
        });
        end = first;
    }
    out
}

/// Length of a first estimate, and time in which estimates must start, of all objects together,
/// seconds.
const WINDOW_S: f64 = 5.0 / 12.0;
const ESTIMATES_S: f64 = 1.0 / 3.0;
/// Largest residual of a first estimate, pixels at the working size.
const MOST_RESIDUAL_PX: f64 = 0.9;
/// Least deviation of its parabola from a straight line, pixels at the working size.
const LEAST_BEND_PX: f64 = 5.0;
/// Steps to the acceleration that belongs to a depth.
const STEPS: usize = 3;
/// Noise assumed for the best fit, pixels, and the largest standard deviation of its acceleration,
/// as a share of it.
const FIT_NOISE_PX: f64 = 0.35;
const CERTAIN: f64 = 0.06;

/// The acceleration for which parabolas over a few frames have the estimated depths of the parts:
/// the most common one. `None` if hardly any part moves along a curved path.
pub(super) fn first_acceleration(objects: &[RigidObject<'_>], ground: &Ground) -> Option<f64> {
    let mut all: Vec<f64> = objects
        .iter()
        .flat_map(|object| {
            let starts = 0..(object.depth.len() + 1).saturating_sub(object.rate.frames(WINDOW_S));
            starts.filter_map(|first| estimate(object, first, ground))
        })
        .collect();
    let rate = objects.first()?.rate;
    if all.len() < rate.frames(ESTIMATES_S) {
        return None;
    }
    all.sort_by(f64::total_cmp);
    // The shortest interval, in ratios, that holds a third of them.
    let third = all.len().div_ceil(3);
    let ratio = |from: usize| all[from + third - 1] / all[from];
    let best = (0..=all.len() - third).min_by(|&a, &b| ratio(a).total_cmp(&ratio(b)))?;
    Some(all[best + third / 2])
}

fn estimate(object: &RigidObject<'_>, first: usize, ground: &Ground) -> Option<f64> {
    let end = first + object.rate.frames(WINDOW_S);
    let (mid, frames) = ((first + end) / 2, (end - first) as f64);
    let z = object.depth[first..end].iter().sum::<f64>() / frames;
    let mut g = 0.2 * z / (frames * frames);
    let mut residual_px = f64::INFINITY;
    // The depth is nearly affine in the acceleration.
    for _ in 0..STEPS {
        let parabola = Parabola::fit(object, (first, end), ground, g)?;
        let depth = |g: f64| parabola.depth(&object.cameras[mid], mid, ground, g);
        g *= (z - depth(0.0)) / (depth(g) - depth(0.0));
        if !(g > 0.0 && g.is_finite()) {
            return None;
        }
        residual_px = parabola.residual_px;
    }
    let bend_px = object.cameras[mid].intrinsics.fy * g * frames * frames / (8.0 * z);
    (residual_px < MOST_RESIDUAL_PX && bend_px > LEAST_BEND_PX).then_some(g)
}

/// One acceleration for all flights.
///
/// From a camera that moves evenly, a path fits any acceleration: a larger and farther object falls
/// faster. So there are two estimates. Where the camera did not move evenly, one acceleration fits
/// best; it is a little too low, since noise draws everything towards the camera. And nothing falls
/// through the ground: the acceleration that nearly all flights allow is that of flights that end
/// on it; it is a little too high, since they end between two frames. The result is their geometric
/// mean, the second where the first is uncertain, or the first where no flight comes near the
/// ground.
pub(super) fn settled_acceleration(
    objects: &[RigidObject<'_>],
    flights: &[Vec<Flight>],
    ground: &Ground,
) -> Option<f64> {
    let (mut sum, mut information) = (0.0, 0.0);
    for flight in flights.iter().flatten() {
        sum += flight.parabola.best_acceleration * flight.parabola.information;
        information += flight.parabola.information;
    }
    let (best, sigma) = (sum / information, FIT_NOISE_PX / information.sqrt());
    let mut most: Vec<f32> = objects
        .iter()
        .zip(flights)
        .flat_map(|(object, flights)| flights.iter().map(|f| allowed(object, f, ground) as f32))
        .collect();
    let allowed = f64::from(quantile(&mut most, 0.1)?);
    let certain = sigma < CERTAIN * best;
    let g = match (certain, allowed.is_finite()) {
        (true, true) => (best.min(allowed) * allowed).sqrt(),
        (true, false) => best,
        (false, _) => allowed,
    };
    (g > 0.0 && g.is_finite()).then_some(g)
}

/// The largest acceleration for which a flight stays above the ground.
fn allowed(object: &RigidObject<'_>, flight: &Flight, ground: &Ground) -> f64 {
    let mut most = f64::INFINITY;
    for k in (flight.first..flight.end).filter(|&k| object.observations[k].complete) {
        // How far the object is above the ground, less its own radius: affine in the acceleration,
        // as its depth is.
        let parabola = &flight.parabola;
        let above = |g: f64| {
            ground.height(&parabola.at(k, ground, g))
                - object.observations[k].radius * parabola.depth(&object.cameras[k], k, ground, g)
        };
        let (height, slope) = (above(0.0), above(1.0) - above(0.0));
        if height > 0.0 && slope < 0.0 {
            most = most.min(-height / slope);
        }
    }
    most
}
