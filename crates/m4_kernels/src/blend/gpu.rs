//! Blends tile lists into an image: one cube per tile of 8x8 pixels, one unit per pixel.

use crate::{ellipse, gpu::vector::BACKGROUND, tile_binning::gpu::RECORD};
use cubecl::prelude::*;
use std::f32::consts::LN_2;

pub(crate) mod backward;

const ALPHA_MAX: f32 = ellipse::ALPHA_MAX as f32;
const LOG2_ALPHA_MIN: f32 = ellipse::LOG2_ALPHA_MIN as f32;
const T_MIN: f32 = ellipse::T_MIN as f32;

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
    tile_ends: &mut [u32],
    width: u32,
    height: u32,
    #[comptime] with_depth: bool,
    #[comptime] training: bool,
) {
    let mut batch = Shared::<[f32]>::new_slice(64usize * RECORD);
    let mut alive = Shared::<[u32]>::new_slice(1usize);
    let farthest = Shared::<[Atomic<u32>]>::new_slice(1usize);
    let tile = CUBE_POS as u32;
    let across = (width + 7u32) / 8u32;
    let top = (tile / across) * 8u32;
    let x = (tile % across) * 8u32 + UNIT_POS % 8u32;
    let y = top + UNIT_POS / 8u32;
    let inside = x < width && y < height;
    let (px, py) = (f32::cast_from(x), f32::cast_from(y));
    let mut start = 0u32;
    let mut end = 0u32;
    // the grid may have a few cubes more
    if top < height {
        start = ranges[(2u32 * tile) as usize];
        end = ranges[(2u32 * tile + 1u32) as usize];
    }
    let mut light = 1.0f32;
    let mut red = 0.0f32;
    let mut green = 0.0f32;
    let mut blue = 0.0f32;
    let mut depth = 0.0f32;
    let mut going = inside;
    let mut last = start;
    let mut bucket = 0u32;
    if comptime!(training) {
        if end > start {
            bucket = offsets[tile as usize];
        }
    }
    let batches = (end - start + 63u32) / 64u32;
    let mut b = 0u32;
    let mut open = batches > 0u32;
    // the record of the next batch is fetched while this one is blended
    let mut ahead = Array::<f32>::new(RECORD);
    if start + UNIT_POS < end {
        fetch(records, splats, start + UNIT_POS, &mut ahead);
    }
    while open {
        let first = start + b * 64u32;
        let entry = first + UNIT_POS;
        sync_cube();
        if UNIT_POS == 0u32 {
            alive[0] = 0u32;
        }
        if entry < end {
            let to = UNIT_POS as usize * RECORD;
            #[unroll]
            for k in 0usize..RECORD {
                batch[to + k] = ahead[k];
            }
        }
        sync_cube();
        if entry + 64u32 < end {
            fetch(records, splats, entry + 64u32, &mut ahead);
        }
        let count = (end - first).min(64u32);
        let mut k = 0u32;
        while k < count && going {
            if comptime!(training) {
                if k % 32u32 == 0u32 {
                    let to = ((bucket + b * 2u32 + k / 32u32) * 64u32 + UNIT_POS) as usize * 4;
                    if to < checkpoints.len() {
                        checkpoints[to] = light;
                        checkpoints[to + 1] = red;
                        checkpoints[to + 2] = green;
                        checkpoints[to + 3] = blue;
                    }
                }
            }
            // none of the four depends on another
            let mut exponents = Array::<f32>::new(4usize);
            #[unroll]
            for j in 0u32..4u32 {
                exponents[j as usize] = exponent_at(&batch, k + j, count, px, py);
            }
            #[unroll]
            for j in 0u32..4u32 {
                let exponent = exponents[j as usize];
                if going && exponent >= LOG2_ALPHA_MIN {
                    let alpha = (exponent * LN_2).exp().min(ALPHA_MAX);
                    let behind = light * (1.0f32 - alpha);
                    if behind < T_MIN {
                        going = false;
                    } else {
                        let r = (k + j) as usize * RECORD;
                        let weight = light * alpha;
                        red += weight * batch[r + 6];
                        green += weight * batch[r + 7];
                        blue += weight * batch[r + 8];
                        if comptime!(with_depth) {
                            depth += weight * batch[r + 9];
                        }
                        light = behind;
                        last = first + k + j + 1u32;
                    }
                }
            }
            k += 4u32;
        }
        if going {
            // all writers write the same value
            alive[0] = 1u32;
        }
        b += 1u32;
        // until every pixel is opaque
        open = workgroup_uniform_load(&alive[0]) != 0u32 && b < batches;
    }
    if comptime!(training) {
        if UNIT_POS == 0u32 {
            farthest[0].store(0u32);
        }
        sync_cube();
        if inside {
            farthest[0].fetch_max(last);
        }
        sync_cube();
        if UNIT_POS == 0u32 && top < height {
            tile_ends[tile as usize] = farthest[0].load();
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

/// The record of an entry.
#[cube]
fn fetch(records: &[f32], splats: &[u32], entry: u32, out: &mut Array<f32>) {
    let from = splats[entry as usize] as usize * RECORD;
    #[unroll]
    for k in 0usize..RECORD {
        out[k] = records[from + k];
    }
}

/// The logarithm of the opacity, to base 2, of entry `k` at a pixel; too little to be seen after
/// the last entry.
#[cube]
fn exponent_at(batch: &Shared<[f32]>, k: u32, count: u32, px: f32, py: f32) -> f32 {
    let r = k as usize * RECORD;
    let dx = batch[r] - px;
    let dy = batch[r + 1] - py;
    let power = batch[r + 2] * dx * dx + batch[r + 3] * dx * dy + batch[r + 4] * dy * dy;
    let mut exponent = batch[r + 5] - power;
    // not so where a number is not finite
    let is_seen = k < count && power >= 0.0f32;
    if !is_seen {
        exponent = f32::new(-1000.0f32);
    }
    exponent
}
