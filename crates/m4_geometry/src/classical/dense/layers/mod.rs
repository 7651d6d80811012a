//! Depth of a clip without parallax: layers.
//!
//! A camera that does not move from its place cannot measure depth, so depth is made up such that what occludes is nearer than
//! what it occludes. The static background lies on a sphere of radius 1 around the camera, which is one surface for all
//! frames, however the camera turns. Every dynamic region lies in front of it by [`MARGIN`], in front of the dynamic regions that
//! it surely occludes by [`STEP`] more, and static occluders lie in front of all of them.
//!
//! ```text
//! masks, flow -> rigid_objects::tracklet: regions through time
//!             -> order: which of two regions that touch is in front
//!             -> occluders: static pixels in front of dynamic regions
//! ```

mod occluders;
mod order;

#[cfg(test)]
mod tests;

use super::components::Components;
use super::rigid_objects::{Clip, Tracklet, follow};
use super::shot::Shot;
use m4_core::Camera;
use occluders::Occluders;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Distance from the background to the farthest dynamic layer, as a share of the latter: more than ten times the extent of a splat in
/// depth, so that static splats are never sorted in front of dynamic ones, also where training moved them; 2 to 3 pixels when the
/// camera swings by 3 degrees.
const MARGIN: f32 = 0.1;
/// The same between dynamic layers: less, since an order may change in the course of a clip, and a person should not fall apart into
/// limbs.
const STEP: f32 = 0.03;

/// Disparity of a point on the unit sphere around the camera, `[height][width]`: the length of the ray of z-depth 1.
pub(super) fn sphere(camera: &Camera) -> Vec<f32> {
    let k = &camera.intrinsics;
    (0..k.width * k.height)
        .map(|p| {
            let x = ((p % k.width) as f64 + 0.5 - k.cx) / k.fx;
            let y = ((p / k.width) as f64 + 0.5 - k.cy) / k.fy;
            (x * x + y * y + 1.0).sqrt() as f32
        })
        .collect()
}

/// Disparity of every pixel of every frame, `[height][width]` each. `clip.background` is [`sphere`] of each camera, `shots` have the
/// colours, and a flow whose round trip misses by more than [`super::rigid_objects::ROUND_TRIP_PX`] saw an occlusion.
pub(super) fn place(clip: &Clip<'_>, shots: &[Shot]) -> Vec<Vec<f32>> {
    let (w, h) = (clip.width, clip.height);
    let tracklets = follow(clip);
    let labels = labels(clip, &tracklets);
    let ranks = order::ranks(clip, &labels, tracklets.len());
    let front = ranks.iter().max().map_or(0, |r| r + 1);
    let occluders = Occluders::find(clip, shots);
    (0..clip.moving.len())
        .into_par_iter()
        .map(|i| {
            let layer = dynamic_layers(w, h, &clip.moving[i], &labels[i], &ranks);
            let occludes = occluders.in_frame(&clip.cameras[i], w, h);
            (0..w * h)
                .map(|p| {
                    let layer = match (layer[p], occludes[p]) {
                        (0, true) => front + 1,
                        (layer, _) => layer,
                    };
                    clip.background[i][p] * nearer(layer)
                })
                .collect()
        })
        .collect()
}

/// Times the background's, the disparity of a layer: 0 for the background, from 1 on in front of it.
fn nearer(layer: usize) -> f32 {
    match layer {
        0 => 1.0,
        _ => (1.0 + MARGIN) * (1.0 + STEP).powi(layer as i32 - 1),
    }
}

/// One plus the tracklet of every pixel of every frame, 0 for none.
fn labels(clip: &Clip<'_>, tracklets: &[Tracklet]) -> Vec<Vec<u32>> {
    let mut out = vec![vec![0u32; clip.width * clip.height]; clip.moving.len()];
    for (k, tracklet) in tracklets.iter().enumerate() {
        for (frame, pixels) in out[tracklet.first..].iter_mut().zip(&tracklet.parts) {
            for &p in pixels {
                frame[p as usize] = k as u32 + 1;
            }
        }
    }
    out
}

/// The layer of every pixel: 0 for static ones, one plus the rank of its tracklet for dynamic ones. What is in no tracklet goes with
/// most of what it is connected to, or into the farthest dynamic layer.
fn dynamic_layers(w: usize, h: usize, moving: &[u8], labels: &[u32], ranks: &[usize]) -> Vec<usize> {
    let mut out = vec![0usize; w * h];
    for pixels in Components::of(w, h, moving).pixels {
        let rank = |p: u32| (labels[p as usize] as usize).checked_sub(1).map(|k| ranks[k]);
        let mut count: BTreeMap<usize, usize> = BTreeMap::new();
        for rank in pixels.iter().filter_map(|&p| rank(p)) {
            *count.entry(rank).or_default() += 1;
        }
        let most = count.into_iter().max_by_key(|&(rank, n)| (n, rank)).map_or(0, |(rank, _)| rank);
        for p in pixels {
            out[p as usize] = 1 + rank(p).unwrap_or(most);
        }
    }
    out
}
