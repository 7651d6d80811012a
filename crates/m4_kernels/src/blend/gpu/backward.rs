//! Gradients of the ellipses: one cube of 32 units per bucket of 32 entries. The entries of a
//! bucket come one after the other, each on the pixels of its bounding box alone, which the units
//! share; what is left of each pixel's light stays in shared memory.
use super::{ALPHA_MAX, LOG2_ALPHA_MIN};
use crate::tile_binning::gpu::{BUCKETS, REACH, RECORD, SLACK_PX};
use cubecl::prelude::*;
use std::f32::consts::LN_2;

/// Sums of an entry over the pixels of its tile: weight, first and second moments, colours
/// (docs/spec/optimiser.md 1.7).
pub(crate) const SUMS: usize = 9;
/// Numbers of a record that are used here: all but the depth.
const USED: usize = RECORD - 1;
/// A sum's share of each unit, and one number so that they lie in different banks.
const ROW: usize = 33;
/// Units that add up a third of the shares of one sum each.
const ADDERS: u32 = 27;

/// Adds these sums up, from the image and the loss's gradient with respect to it.
#[cube(launch)]
pub(crate) fn blend_backward(
    records: &[f32],
    reaches: &[f32],
    splats: &[u32],
    slots: &[u32],
    ranges: &[u32],
    tile_of: &[u32],
    offsets: &[u32],
    totals: &[u32],
    checkpoints: &[f32],
    image: &[f32],
    gradient: &[f32],
    ends: &[u32],
    tile_ends: &[u32],
    sums: &mut [f32],
    width: u32,
    height: u32,
) {
    // of each pixel of the tile: the gradient, its end, the light that is left, and what is blended
    // behind along the gradient
    let mut d_reds = Shared::<[f32]>::new_slice(64usize);
    let mut d_greens = Shared::<[f32]>::new_slice(64usize);
    let mut d_blues = Shared::<[f32]>::new_slice(64usize);
    let mut lasts = Shared::<[u32]>::new_slice(64usize);
    let mut lights = Shared::<[f32]>::new_slice(64usize);
    let mut behinds = Shared::<[f32]>::new_slice(64usize);
    // of each entry
    let mut entries = Shared::<[f32]>::new_slice(32usize * USED);
    let mut boxes = Shared::<[u32]>::new_slice(64usize);
    // of the entry at hand and the one before
    let mut shares = Shared::<[f32]>::new_slice(2usize * SUMS * ROW);
    let mut thirds = Shared::<[f32]>::new_slice(54usize);
    let bucket = CUBE_POS as u32;
    if bucket < totals[BUCKETS] {
        let tile = tile_of[bucket as usize];
        let first = ranges[(2u32 * tile) as usize] + (bucket - offsets[tile as usize]) * 32u32;
        let end = ranges[(2u32 * tile + 1u32) as usize];
        let tile_end = tile_ends[tile as usize];
        let across = (width + 7u32) / 8u32;
        let (left, top) = ((tile % across) * 8u32, (tile / across) * 8u32);
        let (x0, y0) = (f32::cast_from(left), f32::cast_from(top));
        // entries that every pixel hides have no gradient
        let mut count = 0u32;
        if first < tile_end {
            count = (tile_end - first).min(32u32);
        }
        if UNIT_POS < count {
            let splat = splats[(first + UNIT_POS) as usize] as usize;
            #[unroll]
            for k in 0usize..USED {
                entries[UNIT_POS as usize * USED + k] = records[splat * RECORD + k];
            }
            let (packed, factor) = bounding_box(reaches, splat, left, top, width, height);
            boxes[2 * UNIT_POS as usize] = packed;
            boxes[2 * UNIT_POS as usize + 1] = factor;
        }
        if count > 0u32 {
            let all = (width * height) as usize;
            let mut p = UNIT_POS;
            while p < 64u32 {
                let (x, y) = (left + p % 8u32, top + p / 8u32);
                if x < width && y < height {
                    let at = (y * width + x) as usize;
                    let k = (bucket * 64u32 + p) as usize * 4;
                    let (gr, gg, gb) = (gradient[at], gradient[all + at], gradient[2 * all + at]);
                    let shown = gr * image[at] + gg * image[all + at] + gb * image[2 * all + at];
                    lasts[p as usize] = ends[at];
                    d_reds[p as usize] = gr;
                    d_greens[p as usize] = gg;
                    d_blues[p as usize] = gb;
                    lights[p as usize] = checkpoints[k];
                    behinds[p as usize] = shown
                        - (gr * checkpoints[k + 1]
                            + gg * checkpoints[k + 2]
                            + gb * checkpoints[k + 3]);
                }
                p += 32u32;
            }
        }
        sync_cube();
        for e in 0u32..count {
            let r = e as usize * USED;
            let (u, v) = (entries[r], entries[r + 1]);
            let (a, b, c) = (entries[r + 2], entries[r + 3], entries[r + 4]);
            let log_opacity = entries[r + 5];
            let (red, green, blue) = (entries[r + 6], entries[r + 7], entries[r + 8]);
            let (packed, factor) = (boxes[2 * e as usize], boxes[2 * e as usize + 1]);
            let (box_x, box_y) = (packed & 255u32, (packed >> 8u32) & 255u32);
            let columns = (packed >> 16u32) & 255u32;
            let pixels = columns * (packed >> 24u32);
            let mut weight = 0.0f32;
            let mut wx = 0.0f32;
            let mut wy = 0.0f32;
            let mut wxx = 0.0f32;
            let mut wxy = 0.0f32;
            let mut wyy = 0.0f32;
            let mut d_red = 0.0f32;
            let mut d_green = 0.0f32;
            let mut d_blue = 0.0f32;
            let mut q = UNIT_POS;
            while q < pixels {
                // q / columns
                let row = (q * factor) >> 16u32;
                let (px, py) = (box_x + q - row * columns, box_y + row);
                let at = (8u32 * py + px) as usize;
                // rounded as in the forward pass
                let dx = u - (x0 + f32::cast_from(px));
                let dy = v - (y0 + f32::cast_from(py));
                let power = a * dx * dx + b * dx * dy + c * dy * dy;
                let exponent = log_opacity - power;
                if first + e < lasts[at] && power >= 0.0f32 && exponent >= LOG2_ALPHA_MIN {
                    let (gr, gg, gb) = (d_reds[at], d_greens[at], d_blues[at]);
                    let light = lights[at];
                    let raw = (exponent * LN_2).exp();
                    let alpha = raw.min(ALPHA_MAX);
                    let blended = light * alpha;
                    let d_blended = gr * red + gg * green + gb * blue;
                    d_red += blended * gr;
                    d_green += blended * gg;
                    d_blue += blended * gb;
                    let behind = behinds[at] - blended * d_blended;
                    if raw < ALPHA_MAX {
                        let omega = (light * d_blended - behind / (1.0f32 - alpha)) * alpha;
                        weight += omega;
                        wx += omega * dx;
                        wy += omega * dy;
                        wxx += omega * dx * dx;
                        wxy += omega * dx * dy;
                        wyy += omega * dy * dy;
                    }
                    behinds[at] = behind;
                    lights[at] = light * (1.0f32 - alpha);
                }
                q += 32u32;
            }
            let half = (e % 2u32) as usize;
            let mine = half * SUMS * ROW + UNIT_POS as usize;
            shares[mine] = weight;
            shares[mine + ROW] = wx;
            shares[mine + 2 * ROW] = wy;
            shares[mine + 3 * ROW] = wxx;
            shares[mine + 4 * ROW] = wxy;
            shares[mine + 5 * ROW] = wyy;
            shares[mine + 6 * ROW] = d_red;
            shares[mine + 7 * ROW] = d_green;
            shares[mine + 8 * ROW] = d_blue;
            // one barrier an entry: what the units write after it lies in the other half
            sync_cube();
            if e > 0u32 {
                write_sums(
                    &thirds,
                    1usize - half,
                    slots[(first + e - 1u32) as usize],
                    sums,
                );
            }
            if UNIT_POS < ADDERS {
                let from = half * SUMS * ROW + (UNIT_POS % 9u32) as usize * ROW;
                let start = (UNIT_POS / 9u32) * 11u32;
                let mut sum = 0.0f32;
                for k in start..(start + 11u32).min(32u32) {
                    sum += shares[from + k as usize];
                }
                thirds[half * 27 + UNIT_POS as usize] = sum;
            }
        }
        sync_cube();
        if count > 0u32 {
            let last = count - 1u32;
            write_sums(
                &thirds,
                (last % 2u32) as usize,
                slots[(first + last) as usize],
                sums,
            );
        }
        if UNIT_POS >= count && first + UNIT_POS < end {
            let s = slots[(first + UNIT_POS) as usize] as usize * SUMS;
            for k in 0usize..SUMS {
                sums[s + k] = 0.0f32;
            }
        }
    }
}

/// Writes the sums of an entry: nine units add three thirds each.
#[cube]
fn write_sums(thirds: &Shared<[f32]>, half: usize, slot: u32, sums: &mut [f32]) {
    if UNIT_POS < 9u32 {
        let from = half * 27 + UNIT_POS as usize;
        sums[slot as usize * SUMS + UNIT_POS as usize] =
            thirds[from] + thirds[from + 9] + thirds[from + 18];
    }
}

/// The pixels of a tile that an ellipse may change: first column, first row, columns and rows, a
/// byte each, and the factor that divides numbers of pixels by the columns (65,536 of them make 1).
#[cube]
fn bounding_box(
    reaches: &[f32],
    splat: usize,
    left: u32,
    top: u32,
    width: u32,
    height: u32,
) -> (u32, u32) {
    let r = splat * REACH;
    let (x0, y0) = (f32::cast_from(left), f32::cast_from(top));
    let half_x = (reaches[r + 5] * reaches[r + 2]).sqrt() + SLACK_PX;
    let half_y = (reaches[r + 5] * reaches[r + 4]).sqrt() + SLACK_PX;
    let right = f32::cast_from(width.min(left + 8u32)) - 1.0f32;
    let bottom = f32::cast_from(height.min(top + 8u32)) - 1.0f32;
    let x_first = (reaches[r] - half_x).ceil().max(x0);
    let y_first = (reaches[r + 1] - half_y).ceil().max(y0);
    let x_last = (reaches[r] + half_x).floor().min(right);
    let y_last = (reaches[r + 1] + half_y).floor().min(bottom);
    let mut packed = 0u32;
    let mut factor = 0u32;
    if x_first <= x_last && y_first <= y_last {
        let (x, y) = (u32::cast_from(x_first - x0), u32::cast_from(y_first - y0));
        let columns = u32::cast_from(x_last - x_first) + 1u32;
        let rows = u32::cast_from(y_last - y_first) + 1u32;
        packed = x | (y << 8u32) | (columns << 16u32) | (rows << 24u32);
        factor = (65_535u32 + columns) / columns;
    }
    (packed, factor)
}
