//! Depth of dynamic regions, part by part: each moving part is taken for a rigid body, whose motion relative to
//! the camera reveals its shape and how its distance changes, but not its size; its size follows from what it
//! hides, where it touches the ground, and how it moves.
//!
//! ```text
//! masks, flow -> tracklet: one part through time; objects that touch in the image are separated by other frames
//!             -> rigid: dense bundle adjustment of camera against part (crate::dba), shape and distance up to scale
//!             -> scale: the one number that is left
//!             -> ballistic: objects in flight share one acceleration
//! ```
//!
//! docs/spec/front-end.md 7.1, item 7, (a) contact and (b) rigid motion with unknown
//! scale.

mod ballistic;
mod ground;
mod rigid;
mod scale;
mod tracklet;

#[cfg(test)]
mod tests;

use super::error::DenseError;
use super::estimate::each;
use super::flow::FlowPair;
use super::smooth::Smoother;
use m4_core::{Camera, Progress};
use rayon::prelude::*;
pub(super) use tracklet::{Tracklet, follow};

/// Distance of the pixels that are adjusted, pixels at the working size.
const BLOCK_PX: usize = 4;
/// Regions smaller than this share of the image are not shaped.
const LEAST_SHARE: f32 = 0.002;
/// Fewest frames of a region.
const SHORTEST: usize = 5;
/// Flow whose round trip misses by more than this is not followed, pixels at the working size.
pub(super) const ROUND_TRIP_PX: f32 = 1.5;
/// Strength of the edge-aware spreading, pixels squared (Min et al. 2014, lambda).
const FILL_LAMBDA: f32 = 100.0;

/// Input: cameras, masks, background and flow of a clip.
pub(super) struct Clip<'a> {
    pub width: usize,
    pub height: usize,
    /// By frame, at the working size.
    pub cameras: &'a [Camera],
    /// `[height][width]` by frame: above 0 in dynamic regions.
    pub moving: &'a [Vec<u8>],
    /// `[height][width]` by frame: disparity of static regions, continued behind dynamic ones.
    pub background: &'a [Vec<f32>],
    /// Between neighbouring frames.
    pub flows: &'a [FlowPair],
}

/// Replaces the disparity of moving parts, `[height][width]` by frame, where a part could be followed long
/// enough to be understood as a body; `falling`: what flies takes its distance from how it falls, where there is a ground.
///
/// # Errors
///
/// [`DenseError::Cancelled`].
pub(super) fn place<'s>(
    clip: &Clip<'_>,
    smoother: impl Fn(usize) -> Smoother + Sync + 's,
    falling: bool,
    disparity: &mut [Vec<f32>],
    progress: &dyn Progress,
) -> Result<(), DenseError> {
    let tracklets = follow(clip);
    let before: &[Vec<f32>] = disparity;
    let bodies = each(tracklets.len(), "shaping moving parts", progress, |i| {
        let t = &tracklets[i];
        let shape = rigid::reconstruct(clip, t, before)?;
        let reading = scale::read(clip, t, &shape)?;
        Some((t, shape, reading))
    })?;
    let bodies: Vec<_> = bodies.into_iter().flatten().collect();
    let scales = scale::settle(&bodies.iter().map(|(_, _, reading)| reading).collect::<Vec<_>>());
    let mut scales: Vec<Vec<f32>> = bodies.iter().zip(&scales).map(|((t, _, _), s)| vec![*s; t.parts.len()]).collect();
    if falling && let Some(ground) = ground::find(clip) {
        fall(clip, &ground, &bodies, &mut scales);
    }
    // Part by part onto the pixels, along the edges of the image.
    let mut values: Vec<Vec<(u32, f32)>> = vec![Vec::new(); disparity.len()];
    for ((tracklet, shape, _), scale) in bodies.iter().zip(&scales) {
        for (k, scale) in scale.iter().enumerate() {
            values[tracklet.first + k].extend(shape.known(clip, k).map(|(p, d)| (p, d * scale)));
        }
    }
    disparity.par_iter_mut().enumerate().for_each(|(i, disparity)| {
        if !values[i].is_empty() {
            spread(clip, i, &smoother(i), &bodies, &values[i], disparity);
        }
    });
    Ok(())
}

/// Corrects the scales (by body and frame) of what flies.
fn fall(
    clip: &Clip<'_>,
    ground: &ground::Ground,
    bodies: &[(&Tracklet, rigid::Shape, scale::Reading)],
    scales: &mut [Vec<f32>],
) {
    let typical = |shape: &rigid::Shape, k: usize| {
        let mut all: Vec<f32> = shape.known(clip, k).map(|(_, d)| d).collect();
        m4_core::quantile(&mut all, 0.5)
    };
    let depth: Vec<Vec<f64>> = bodies
        .iter()
        .zip(&*scales)
        .map(|((_, shape, _), scale)| {
            scale.iter().enumerate().map(|(k, s)| 1.0 / f64::from(typical(shape, k).unwrap_or(1.0) * s)).collect()
        })
        .collect();
    let tracklets: Vec<&Tracklet> = bodies.iter().map(|(t, _, _)| *t).collect();
    let Some(flying) = ballistic::depths(clip, ground, &tracklets, &depth) else {
        return;
    };
    for (((tracklet, shape, _), flying), scales) in bodies.iter().zip(&flying).zip(scales) {
        if flying.iter().all(Option::is_none) {
            continue;
        }
        let known: Vec<Option<f32>> = flying
            .iter()
            .enumerate()
            .map(|(k, z)| match z {
                Some(z) => typical(shape, k).map(|d| 1.0 / (*z as f32 * d)),
                None => scale::standing(clip, tracklet, shape, k),
            })
            .collect();
        scale::between(&known, scales);
    }
}

/// Spreads the values of a frame over the parts that they lie in.
fn spread(
    clip: &Clip<'_>,
    i: usize,
    smoother: &Smoother,
    bodies: &[(&Tracklet, rigid::Shape, scale::Reading)],
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
        let Some(pixels) = i.checked_sub(tracklet.first).and_then(|k| tracklet.parts.get(k)) else {
            continue;
        };
        for &p in pixels {
            let p = p as usize;
            if reach[p] > 1e-4 {
                disparity[p] = filled[p].max(clip.background[i][p]);
            }
        }
    }
}
