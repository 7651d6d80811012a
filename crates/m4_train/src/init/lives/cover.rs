//! Which points of a keyframe a living splat is at.

use super::{
    carrier::carried,
    evidence::{Shown, around},
};
use crate::init::{motion::Rigid, voxel::Centroids};
use m4_core::{Binding, nalgebra::Vector3};
use rayon::prelude::*;

/// A splat covers a point within this share of the edge of its voxel (measured:
/// docs/decisions/0022).
const COVER: f32 = 0.4;
/// Ends the list of a pixel.
const NONE: u32 = u32::MAX;

/// Whether a splat of `splats` that lives at `t` (frames) is at each of the `points` of the
/// keyframe; `motions` bring splats there.
pub(super) fn covered(
    here: &Shown<'_>,
    splats: &[(Binding, Vector3<f32>)],
    motions: &[Rigid],
    t: f32,
    points: &Centroids,
) -> Vec<bool> {
    let (width, height) = here.size();
    // pixel and z-depth of each living splat
    let living: Vec<Option<([f32; 2], f32)>> = splats
        .par_iter()
        .map(|(b, mean)| {
            if t < b.life[0] || t > b.life[1] {
                return None;
            }
            let p = here
                .observed
                .project(&carried(motions, &b.nodes, &b.weights, mean))?;
            let [u, v] = p.at;
            let inside = u > -0.5 && v > -0.5 && u < width as f32 - 0.5 && v < height as f32 - 0.5;
            inside.then_some((p.at, p.point[2]))
        })
        .collect();
    // a list per pixel of the splats whose nearest pixel it is
    let mut head = vec![NONE; width * height];
    let mut next = vec![NONE; living.len()];
    for (i, splat) in living.iter().enumerate() {
        if let Some(([u, v], _)) = splat {
            let pixel = v.round() as usize * width + u.round() as usize;
            next[i] = std::mem::replace(&mut head[pixel], i as u32);
        }
    }
    let some = |&i: &u32| i != NONE;
    let at = |i: u32| living[i as usize];
    let pairs = points.xyz.par_iter().zip(&points.edge);
    let covered = pairs.map(|(p, edge)| {
        let Some(projected) = here.observed.project(&Vector3::from(*p)) else {
            return false;
        };
        let z = projected.point[2];
        let radius = COVER * edge / here.observed.pixel(z);
        // rounding moves a splat by up to half a pixel along each axis
        around(projected.at, radius + 0.75, (width, height)).any(|(x, y)| {
            let list = std::iter::successors(Some(head[y * width + x]).filter(some), |&i| {
                Some(next[i as usize]).filter(some)
            });
            list.filter_map(at).any(|(place, depth)| {
                let off = (place[0] - projected.at[0]).hypot(place[1] - projected.at[1]);
                off <= radius && (depth - z).abs() <= here.depth_step * z
            })
        })
    });
    covered.collect()
}
