//! Depth of dynamic regions, part by part. Each part is taken for a rigid body: its motion relative
//! to the camera reveals its shape and how its distance changes, but not its size. Its size follows
//! from what it hides, where it touches the ground, and how it moves.
//!
//! ```text
//! masks, flow -> tracklet: one part through time; objects that touch in the image are separated by other frames
//!             -> edges: where its pixels are in other frames; silhouette: how near it is by its size
//!             -> rigid: dense bundle adjustment of camera against part (crate::dba), shape and distance up to scale;
//!                reversal: frames that took the mirror image are turned back, by the flow and by
//!                shape_prior: a part stands on the ground (contact) and bulges towards the camera
//!             -> pieces: what is rigid in it, by the space of its paths; each piece is adjusted alone, joints
//!                puts them at their distances, and relief carries their shape on to the rest
//!             -> scale: the one number that is left, by contact, hinge or fall
//!             -> ballistic: objects in flight share one acceleration
//! ```
//!
//! docs/spec/front-end.md 7.1, item 7, (a) contact and (b) rigid motion with unknown
//! scale.

mod ballistic;
mod contact;
mod edges;
mod flight;
mod ground;
mod hinge;
mod joints;
mod local_ground;
mod pieces;
mod relief;
mod residual;
mod reversal;
mod rigid;
mod scale;
mod shape;
mod shape_prior;
mod silhouette;
mod subspace;
#[cfg(test)]
mod tests;
mod tracklet;
mod vote;

use super::sources::DenseError;
use super::working::{WorkingClip, each};
use crate::smooth::Smoother;
use flight::Flight;
use m4_core::{Progress, quantile};
use rayon::prelude::*;
use scale::Decision;
pub(super) use tracklet::{Tracklet, follow};
use vote::Vote;

/// Distance of the pixels that are adjusted, pixels at the working size.
const BLOCK_PX: usize = 4;
/// Regions smaller than this share of the image are not shaped.
const LEAST_SHARE: f32 = 0.002;
/// Shortest time that a region is followed, seconds, and fewest frames, which its adjustment needs
/// at any rate.
const SHORTEST_S: f64 = 0.2;
const FEWEST: usize = 5;
/// Flow whose round trip misses by more than this is not followed, pixels at the working size.
pub(super) const ROUND_TRIP_PX: f32 = 1.5;
/// A part may seem to lie behind what it hides by up to this factor of depth. Background that is
/// nearer still is not behind it but was filled in from a static occluder, and a scale that puts
/// the part farther still is wrong.
const OCCLUSION_RANGE: f32 = 1.2;
/// Strength of the edge-aware spreading, pixels squared (Min et al. 2014, lambda).
const FILL_LAMBDA: f32 = 100.0;

/// Fewest frames of a region.
fn shortest(clip: &WorkingClip<'_>) -> usize {
    clip.rate.frames(SHORTEST_S).max(FEWEST)
}

/// A part that was adjusted, and what its frames say about its scale.
type Body<'a> = (&'a Tracklet, shape::Shape, scale::Reading);

/// What gives the distance of a dynamic object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DistanceCue {
    /// The ground under it.
    Contact,
    /// A point that stays in place while the object turns or swings about it.
    FixedPoint,
    /// Its fall.
    Ballistic,
    /// Nothing: it is taken to be as far as the others, in front of what it hides.
    Assumed,
}

/// A dynamic object in consecutive frames.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DynamicObject {
    /// Its first frame, of those that the estimate was made of.
    pub first_frame: usize,
    /// Number of frames.
    pub frames: usize,
    /// Its mean share of the image, 0..1.
    pub share: f64,
    /// What gives its distance.
    pub cue: DistanceCue,
    /// Standard deviation of its distance, per cent.
    pub sigma_percent: f64,
}

/// Objects smaller than this share of the image do not count for a frame.
const COUNTED_SHARE: f64 = 0.001;
/// Least deviation of a frame: on exact data an estimate may be 0, which says that there is none.
const LEAST_SIGMA: f64 = 1e-6;

/// Returns the relative standard deviation of the distance of the objects in `frame`, counted as
/// [`DynamicObject::first_frame`]: the root mean square over them, weighted by their shares of the
/// image. `None` where there is none of at least 0.1 % of the image.
#[must_use]
pub fn distance_sigma(objects: &[DynamicObject], frame: usize) -> Option<f32> {
    let [mut sum, mut weight] = [0.0f64; 2];
    for object in objects {
        let lasts = object.first_frame..object.first_frame + object.frames;
        if lasts.contains(&frame) && object.share >= COUNTED_SHARE {
            sum += object.share * (object.sigma_percent / 100.0).powi(2);
            weight += object.share;
        }
    }
    (weight > 0.0).then(|| (sum / weight).sqrt().max(LEAST_SIGMA) as f32)
}

/// Standard deviation of the logarithm of the distance by a fall, and of an assumed one.
const BALLISTIC_SIGMA: f64 = 0.12;
const ASSUMED_SIGMA: f64 = 0.5;

/// Replaces the disparity of dynamic parts, `[height][width]` by frame, where a part could be
/// followed long enough to be understood as a rigid object; what flies takes its distance from how
/// it falls, where there is a ground. Returns these objects, in order of their first frames.
pub(super) fn place<'s>(
    clip: &WorkingClip<'_>,
    smoother: impl Fn(usize) -> Smoother + Sync + 's,
    disparity: &mut [Vec<f32>],
    progress: &dyn Progress,
) -> Result<Vec<DynamicObject>, DenseError> {
    let tracklets = follow(clip);
    let before: &[Vec<f32>] = disparity;
    let ground = ground::find(clip);
    let down = ground.map(|ground| ground.down);
    let phase = "shaping moving parts";
    let bodies = each(tracklets.len(), phase, progress, |i| {
        let t = &tracklets[i];
        let shape = rigid::reconstruct(clip, t, before, down, progress)?;
        let reading = scale::read(clip, t, &shape)?;
        Some((t, shape, reading))
    })?;
    // A part whose adjustment was stopped looks like one that cannot be shaped.
    if progress.cancelled() {
        return Err(DenseError::Cancelled { phase });
    }
    let bodies: Vec<Body<'_>> = bodies.into_iter().flatten().collect();
    let scales = scale::settle(
        &bodies
            .iter()
            .map(|(_, _, reading)| reading)
            .collect::<Vec<_>>(),
    );
    let falls = match ground {
        Some(ground) => falls(clip, &ground, &bodies, &scales),
        None => vec![None; bodies.len()],
    };
    let decisions: Vec<Option<Decision>> = bodies
        .iter()
        .zip(&falls)
        .map(|((_, _, reading), fall)| reading.decide_with(*fall))
        .collect();
    // Part by part onto the pixels, along the edges of the image.
    let mut values: Vec<Vec<(u32, f32)>> = vec![Vec::new(); disparity.len()];
    for (((tracklet, shape, _), decision), scale) in bodies.iter().zip(&decisions).zip(&scales) {
        let scale = decision.map_or(*scale, |decision| decision.vote.factor as f32);
        for k in 0..tracklet.parts.len() {
            values[tracklet.first + k].extend(shape.values(clip, k).map(|(p, d)| (p, d * scale)));
        }
    }
    disparity
        .par_iter_mut()
        .enumerate()
        .for_each(|(i, disparity)| {
            if !values[i].is_empty() {
                spread(clip, i, &smoother(i), &bodies, &values[i], disparity);
            }
        });
    let mut objects: Vec<DynamicObject> = bodies
        .iter()
        .zip(decisions)
        .map(|(body, decision)| describe(clip, body, decision))
        .collect();
    objects.sort_by_key(|object| object.first_frame);
    Ok(objects)
}

fn describe(
    clip: &WorkingClip<'_>,
    (tracklet, _, _): &Body<'_>,
    decision: Option<Decision>,
) -> DynamicObject {
    let (cue, sigma) = decision.map_or((DistanceCue::Assumed, ASSUMED_SIGMA), |decision| {
        (decision.cue, decision.vote.sigma)
    });
    let frames = tracklet.parts.len();
    let pixels: usize = tracklet.parts.iter().map(Vec::len).sum();
    DynamicObject {
        first_frame: tracklet.first,
        frames,
        share: pixels as f64 / (frames * clip.width * clip.height) as f64,
        cue,
        sigma_percent: 100.0 * sigma,
    }
}

/// The scales of bodies that fall, by their parabolas; `scales` are those without.
fn falls(
    clip: &WorkingClip<'_>,
    ground: &ground::Ground,
    bodies: &[Body<'_>],
    scales: &[f32],
) -> Vec<Option<Vote>> {
    let typical: Vec<Vec<f64>> = bodies
        .iter()
        .map(|(tracklet, shape, _)| {
            let of_frame = |k: usize| {
                let mut all: Vec<f32> = shape.values(clip, k).map(|(_, d)| d).collect();
                f64::from(quantile(&mut all, 0.5).unwrap_or(1.0))
            };
            (0..tracklet.parts.len()).map(of_frame).collect()
        })
        .collect();
    let depth: Vec<Vec<f64>> = typical
        .iter()
        .zip(scales)
        .map(|(typical, scale)| {
            let depth = |t: &f64| 1.0 / (t * f64::from(*scale));
            typical.iter().map(depth).collect()
        })
        .collect();
    let tracklets: Vec<&Tracklet> = bodies.iter().map(|(t, _, _)| *t).collect();
    let Some(flying) = ballistic::depths(clip, ground, &tracklets, &depth) else {
        return vec![None; bodies.len()];
    };
    flying
        .iter()
        .zip(&typical)
        .map(|(flying, typical)| {
            let mut factors: Vec<f32> = flying
                .iter()
                .zip(typical)
                .filter_map(|(z, typical)| z.map(|z| (1.0 / (z * typical)) as f32))
                .collect();
            Vote::of_frames(&mut factors, BALLISTIC_SIGMA)
        })
        .collect()
}

/// Spreads the values of a frame over the parts that they lie in.
fn spread(
    clip: &WorkingClip<'_>,
    i: usize,
    smoother: &Smoother,
    bodies: &[Body<'_>],
    values: &[(u32, f32)],
    disparity: &mut [f32],
) {
    let n = clip.width * clip.height;
    let (mut value, mut weight) = (vec![0.0f32; n], vec![0.0f32; n]);
    for &(p, d) in values {
        value[p as usize] = d;
        weight[p as usize] = 1.0;
    }
    let (filled, reach) = smoother.fill(&value, &weight, FILL_LAMBDA);
    for (tracklet, _, _) in bodies {
        let Some(pixels) = i
            .checked_sub(tracklet.first)
            .and_then(|k| tracklet.parts.get(k))
        else {
            continue;
        };
        for &p in pixels {
            let p = p as usize;
            if reach[p] > 1e-4 {
                let background = clip.disparity[i][p];
                disparity[p] = if background < OCCLUSION_RANGE * filled[p] {
                    filled[p].max(background)
                } else {
                    filled[p]
                };
            }
        }
    }
}
