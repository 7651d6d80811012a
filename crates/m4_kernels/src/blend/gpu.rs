//! Blends tile lists into an image (Minute4D Eq. 3): one cube per tile, one unit per pixel.

use crate::{gpu::vector::BACKGROUND, project::gpu::RECORD};
use cubecl::prelude::*;
use std::f32::consts::LN_2;

pub(crate) mod backward;

const ALPHA_MAX: f32 = super::ALPHA_MAX as f32;
pub(crate) const LOG2_ALPHA_MIN: f32 = super::LOG2_ALPHA_MIN as f32;
const T_MIN: f32 = super::T_MIN as f32;

#[cube(launch)]
pub(crate) fn blend(
    records: &[f32],
    splats: &[u32],
    ranges: &[u32],
    eye: &[f32],
    offsets: &[u32],
    image: &mut [f32],
    checkpoints: &mut [f32],
    ends: &mut [u32],
    width: u32,
    height: u32,
    #[comptime] with_depth: bool,
    #[comptime] training: bool,
) {
    let mut batch = Shared::<[f32]>::new_slice(256usize * RECORD);
    let tile = CUBE_POS as u32;
    let across = (width + 15u32) / 16u32;
    let x = (tile % across) * 16u32 + UNIT_POS % 16u32;
    let y = (tile / across) * 16u32 + UNIT_POS / 16u32;
    let inside = x < width && y < height;
    let (px, py) = (f32::cast_from(x), f32::cast_from(y));
    let start = ranges[(2u32 * tile) as usize];
    let end = ranges[(2u32 * tile + 1u32) as usize];
    let mut light = 1.0f32;
    let mut red = 0.0f32;
    let mut green = 0.0f32;
    let mut blue = 0.0f32;
    let mut depth = 0.0f32;
    let mut going = inside;
    let mut last = start;
    let mut bucket = 0u32;
    if comptime!(training) {
        bucket = offsets[tile as usize];
    }
    let batches = (end - start + 255u32) / 256u32;
    for b in 0u32..batches {
        let first = start + b * 256u32;
        let entry = first + UNIT_POS;
        sync_cube();
        if entry < end {
            let from = splats[entry as usize] as usize * RECORD;
            let to = UNIT_POS as usize * RECORD;
            #[unroll]
            for k in 0usize..RECORD {
                batch[to + k] = records[from + k];
            }
        }
        sync_cube();
        let count = (end - first).min(256u32);
        let mut k = 0u32;
        while k < count && going {
            if comptime!(training) {
                if k % 32u32 == 0u32 {
                    let to = ((bucket + b * 8u32 + k / 32u32) * 256u32 + UNIT_POS) as usize * 4;
                    if to < checkpoints.len() {
                        checkpoints[to] = light;
                        checkpoints[to + 1] = red;
                        checkpoints[to + 2] = green;
                        checkpoints[to + 3] = blue;
                    }
                }
            }
            let r = k as usize * RECORD;
            let dx = batch[r] - px;
            let dy = batch[r + 1] - py;
            let power = batch[r + 2] * dx * dx + batch[r + 3] * dx * dy + batch[r + 4] * dy * dy;
            let exponent = batch[r + 5] - power;
            if power >= 0.0f32 && exponent >= LOG2_ALPHA_MIN {
                let alpha = (exponent * LN_2).exp().min(ALPHA_MAX);
                let behind = light * (1.0f32 - alpha);
                if behind < T_MIN {
                    going = false;
                } else {
                    let weight = light * alpha;
                    red += weight * batch[r + 6];
                    green += weight * batch[r + 7];
                    blue += weight * batch[r + 8];
                    if comptime!(with_depth) {
                        depth += weight * batch[r + 9];
                    }
                    light = behind;
                    last = first + k + 1u32;
                }
            }
            k += 1u32;
        }
    }
    if inside {
        let pixels = (width * height) as usize;
        let at = (y * width + x) as usize;
        image[at] = red + light * eye[BACKGROUND];
        image[pixels + at] = green + light * eye[BACKGROUND + 1];
        image[2 * pixels + at] = blue + light * eye[BACKGROUND + 2];
        image[3 * pixels + at] = light;
        if comptime!(training) {
            ends[at] = last;
        }
        if comptime!(with_depth) {
            image[4 * pixels + at] = depth;
        }
    }
}

/// Fills `out`: red, green, blue, and all that is blended along the gradient; planes.
#[cube(launch)]
pub(crate) fn pixels(image: &[f32], gradient: &[f32], out: &mut [f32], count: u32) {
    let i = ABSOLUTE_POS as u32;
    if i < count {
        let at = i as usize;
        let n = count as usize;
        let (r, g, b) = (gradient[at], gradient[n + at], gradient[2 * n + at]);
        out[at] = r;
        out[n + at] = g;
        out[2 * n + at] = b;
        out[3 * n + at] = r * image[at] + g * image[n + at] + b * image[2 * n + at];
    }
}
