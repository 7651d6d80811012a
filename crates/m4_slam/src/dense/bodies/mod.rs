//! Depth of what moves, part by part: each moving part is taken for a rigid body, whose motion relative to
//! the camera reveals its shape and how its distance changes, but not its size; its size follows from what it
//! hides, where it touches the ground, and how it moves.
//!
//! ```text
//! masks, flow -> tracklet: one part through time
//!             -> rigid: dense bundle adjustment of camera against part (crate::dba), shape and distance up to scale
//!             -> scale: the one number that is left
//! ```
//!
//! Section 7.1, item 7 of the specification of the front end, (a) contact and (b) rigid motion with unknown
//! scale.

mod edges;
mod path;
mod rigid;
mod scale;
mod tracklet;

#[cfg(test)]
mod tests;

use super::config::{BodyConfig, MovingDepthConfig};
use super::flow::FlowPair;
use super::smooth::Smoother;
use m4_scene::Camera;
use rayon::prelude::*;
pub(super) use tracklet::Tracklet;

/// What is known of the clip.
pub(super) struct Clip<'a> {
    pub width: usize,
    pub height: usize,
    /// By frame, at the working size.
    pub cameras: &'a [Camera],
    /// `[height][width]` by frame: above 0 where something moves.
    pub moving: &'a [Vec<u8>],
    /// `[height][width]` by frame: disparity of what stands still, continued behind what moves.
    pub background: &'a [Vec<f32>],
    /// Between neighbouring frames.
    pub flows: &'a [FlowPair],
}

/// Replaces the disparity of moving parts, `[height][width]` by frame, where a part could be followed long
/// enough to be understood as a body.
pub(super) fn place<'s>(
    clip: &Clip<'_>,
    smoother: impl Fn(usize) -> Smoother + Sync + 's,
    contact: &MovingDepthConfig,
    config: &BodyConfig,
    disparity: &mut [Vec<f32>],
) {
    let tracklets = tracklet::follow(clip, config);
    let before: &[Vec<f32>] = disparity;
    let bodies: Vec<_> = tracklets
        .par_iter()
        .filter_map(|t| {
            let shape = rigid::reconstruct(clip, t, before, config)?;
            let reading = scale::read(clip, t, &shape, contact, config)?;
            Some((t, shape, reading))
        })
        .collect();
    let scales = scale::settle(&bodies.iter().map(|(_, _, reading)| reading).collect::<Vec<_>>());
    // Part by part onto the pixels, along the edges of the picture.
    let mut values: Vec<Vec<(u32, f32)>> = vec![Vec::new(); disparity.len()];
    for ((tracklet, shape, _), scale) in bodies.iter().zip(&scales) {
        for k in 0..tracklet.parts.len() {
            values[tracklet.first + k].extend(shape.known(clip, k).map(|(p, d)| (p, d * scale)));
        }
    }
    disparity.par_iter_mut().enumerate().for_each(|(i, disparity)| {
        if !values[i].is_empty() {
            spread(clip, i, &smoother(i), &bodies, &values[i], config, disparity);
        }
    });
}

/// Spreads the values of a frame over the parts that they lie in.
fn spread(
    clip: &Clip<'_>,
    i: usize,
    smoother: &Smoother,
    bodies: &[(&Tracklet, rigid::Shape, scale::Reading)],
    values: &[(u32, f32)],
    config: &BodyConfig,
    disparity: &mut [f32],
) {
    let n = clip.width * clip.height;
    let (mut value, mut weight) = (vec![0.0f32; n], vec![0.0f32; n]);
    for &(p, d) in values {
        value[p as usize] = d;
        weight[p as usize] = 1.0;
    }
    let (filled, reach) = smoother.fill(&value, &weight, config.fill_lambda);
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
