//! Gradients of the ellipses: one cube per bucket of 32 entries, one unit per entry. Pixels are passed from unit to unit.
use super::{ALPHA_MAX, LOG2_ALPHA_MIN};
use crate::project::gpu::RECORD;
use cubecl::prelude::*;
use std::f32::consts::LN_2;

/// Buckets of each tile.
#[cube(launch)]
pub(crate) fn bucket_counts(ranges: &[u32], counts: &mut [u32], tiles: u32) {
    let tile = ABSOLUTE_POS as u32;
    if tile < tiles {
        let t = tile as usize;
        counts[t] = (ranges[2 * t + 1] - ranges[2 * t] + 31u32) / 32u32;
    }
}

/// Which tile each bucket belongs to.
#[cube(launch)]
pub(crate) fn bucket_tiles(counts: &[u32], offsets: &[u32], tile_of: &mut [u32], tiles: u32) {
    let tile = ABSOLUTE_POS as u32;
    if tile < tiles {
        let first = offsets[tile as usize];
        for k in 0u32..counts[tile as usize] {
            if first + k < tile_of.len() as u32 {
                tile_of[(first + k) as usize] = tile;
            }
        }
    }
}

/// Sums of an entry over the pixels of its tile: weight, first and second moments, colours (docs/spec/optimiser.md 1.7).
pub(crate) const SUMS: usize = 9;

/// Adds these sums up.
#[cube(launch)]
pub(crate) fn blend_backward(
    records: &[f32],
    splats: &[u32],
    slots: &[u32],
    ranges: &[u32],
    tile_of: &[u32],
    offsets: &[u32],
    bucket_count: &[u32],
    checkpoints: &[f32],
    pixels: &[f32],
    ends: &[u32],
    sums: &mut [f32],
    width: u32,
    height: u32,
) {
    let mut state = Shared::<[f32]>::new_slice(64usize);
    let bucket = CUBE_POS as u32;
    if bucket < bucket_count[0] {
        let tile = tile_of[bucket as usize];
        let start = ranges[(2u32 * tile) as usize];
        let first = start + (bucket - offsets[tile as usize]) * 32u32;
        let entry = first + UNIT_POS;
        let on = entry < ranges[(2u32 * tile + 1u32) as usize];
        let across = (width + 15u32) / 16u32;
        let (left, top) = ((tile % across) * 16u32, (tile / across) * 16u32);
        let all = (width * height) as usize;
        let mut u = 0.0f32;
        let mut v = 0.0f32;
        let mut a = 0.0f32;
        let mut b = 0.0f32;
        let mut c = 0.0f32;
        let mut log_opacity = f32::new(-100.0f32);
        let mut red = 0.0f32;
        let mut green = 0.0f32;
        let mut blue = 0.0f32;
        if on {
            let r = splats[entry as usize] as usize * RECORD;
            u = records[r];
            v = records[r + 1];
            a = records[r + 2];
            b = records[r + 3];
            c = records[r + 4];
            log_opacity = records[r + 5];
            red = records[r + 6];
            green = records[r + 7];
            blue = records[r + 8];
        }
        let mut weight = 0.0f32;
        let mut wx = 0.0f32;
        let mut wy = 0.0f32;
        let mut wxx = 0.0f32;
        let mut wxy = 0.0f32;
        let mut wyy = 0.0f32;
        let mut d_red = 0.0f32;
        let mut d_green = 0.0f32;
        let mut d_blue = 0.0f32;
        let unit = UNIT_POS as usize;
        for step in 0u32..287u32 {
            // what the unit before left for this one's pixel
            let mut light = 0.0f32;
            let mut behind = 0.0f32;
            if UNIT_POS > 0u32 {
                light = state[2 * unit - 2];
                behind = state[2 * unit - 1];
            }
            sync_cube();
            if step >= UNIT_POS && step - UNIT_POS < 256u32 {
                let p = step - UNIT_POS;
                let (x, y) = (left + p % 16u32, top + p / 16u32);
                if x < width && y < height {
                    let at = (y * width + x) as usize;
                    let (gr, gg, gb) = (pixels[at], pixels[all + at], pixels[2 * all + at]);
                    if UNIT_POS == 0u32 {
                        let k = (bucket * 256u32 + p) as usize * 4;
                        light = checkpoints[k];
                        behind = pixels[3 * all + at]
                            - (gr * checkpoints[k + 1] + gg * checkpoints[k + 2] + gb * checkpoints[k + 3]);
                    }
                    let dx = u - f32::cast_from(x);
                    let dy = v - f32::cast_from(y);
                    let power = a * dx * dx + b * dx * dy + c * dy * dy;
                    let exponent = log_opacity - power;
                    if on && entry < ends[at] && power >= 0.0f32 && exponent >= LOG2_ALPHA_MIN {
                        let raw = (exponent * LN_2).exp();
                        let alpha = raw.min(ALPHA_MAX);
                        let blended = light * alpha;
                        let seen = gr * red + gg * green + gb * blue;
                        d_red += blended * gr;
                        d_green += blended * gg;
                        d_blue += blended * gb;
                        behind -= blended * seen;
                        if raw < ALPHA_MAX {
                            let omega = (light * seen - behind / (1.0f32 - alpha)) * alpha;
                            weight += omega;
                            wx += omega * dx;
                            wy += omega * dy;
                            wxx += omega * dx * dx;
                            wxy += omega * dx * dy;
                            wyy += omega * dy * dy;
                        }
                        light *= 1.0f32 - alpha;
                    }
                }
            }
            state[2 * unit] = light;
            state[2 * unit + 1] = behind;
            sync_cube();
        }
        if on {
            let s = slots[entry as usize] as usize * SUMS;
            sums[s] = weight;
            sums[s + 1] = wx;
            sums[s + 2] = wy;
            sums[s + 3] = wxx;
            sums[s + 4] = wxy;
            sums[s + 5] = wyy;
            sums[s + 6] = d_red;
            sums[s + 7] = d_green;
            sums[s + 8] = d_blue;
        }
    }
}
