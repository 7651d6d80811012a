//! The memory order of splats, computed on the device: the GPU version of [`crate::morton_order`].

use super::{Bound, DeviceSplats, gathered_words, parts};
use crate::gpu::Gpu;
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::keys::{float_of, key_of};
use crate::gpu::sort::{Pairs, Sort};
use crate::launch;
use cubecl::prelude::*;
use m4_core::Column;

/// The smallest normal number: no division by 0.
const SMALLEST: f32 = f32::MIN_POSITIVE;
/// Bits of a place along the curve: ten an axis.
const PLACE_BITS: u32 = 32;
/// Slots: one of static splats and 64 of time, besides those of windows.
const SLOTS: usize = 1 + 64;

/// Bits of a slot, a multiple of what a pass of the sort takes.
fn slot_bits(windows: usize) -> u32 {
    (usize::BITS - (SLOTS + windows - 1).leading_zeros()).next_multiple_of(4)
}

/// The rows of `splats` in the order of memory: static splats along a Morton curve, then bound ones
/// by their window, then free ones by coarse time, along a Morton curve within each window and slot
/// of time.
pub fn morton_order(gpu: &Gpu, splats: &DeviceSplats) -> Buffer {
    let (n, n_static) = (splats.n, splats.n_static);
    let client = &gpu.client;
    let layout = splats.layout;
    let all = Buffer::words(client, &[n as u32]);
    let sort = Sort::new(client, n);
    let limits = Buffer::empty(client, 8);
    let mean = layout.column(Column::Mean);
    let time = layout.column(Column::TimeMean) - parts(layout)[2].start;
    let columns = [
        (&splats.geometry, mean * n, n),
        (&splats.geometry, (mean + 1) * n, n),
        (&splats.geometry, (mean + 2) * n, n),
        (&splats.time, time * (n - n_static), n - n_static),
    ];
    for (axis, (buffer, first, rows)) in columns.into_iter().enumerate() {
        let pairs = Pairs::empty(client, n);
        let count = Buffer::words(client, &[rows as u32]);
        launch!(
            client,
            keys_of::launch,
            (cubes(n, 256), units()),
            [buffer, pairs.keys],
            [first as u32, rows as u32]
        );
        let sorted = sort.run(client, &pairs, &count, 32);
        launch!(
            client,
            take_limits::launch,
            (cubes(1, 1), CubeDim::new_1d(1)),
            [sorted.keys, limits],
            [axis as u32, rows as u32]
        );
    }
    let windows = splats
        .bound
        .as_ref()
        .map_or(0, |bound| bound.windows().len());
    let (places, slots) = (Pairs::empty(client, n), Buffer::empty(client, n));
    launch!(
        client,
        codes::launch,
        (cubes(n, 256), units()),
        [
            splats.geometry,
            splats.time,
            splats.bound.as_ref().map_or(&limits, Bound::bindings),
            limits,
            places.keys,
            places.values,
            slots
        ],
        [
            n as u32,
            n_static as u32,
            splats.n_still() as u32,
            windows as u32,
            (mean * n) as u32,
            (time * (n - n_static)) as u32
        ]
    );
    let by_place = sort.run(client, &places, &all, PLACE_BITS);
    let by_slot = Pairs {
        keys: gathered_words(gpu, &slots, &by_place.values, n),
        values: by_place.values.clone(),
    };
    Sort::new(client, n)
        .run(client, &by_slot, &all, slot_bits(windows))
        .values
        .clone()
}

/// Numbers that sort as the floats of a column do.
#[cube(launch)]
fn keys_of(column: &[f32], keys: &mut [u32], first: u32, rows: u32) {
    let i = ABSOLUTE_POS as u32;
    if i < rows {
        keys[i as usize] = key_of(column[(first + i) as usize]);
    }
}

/// The values below which 1 % and 99 % of a column lie; 0 and 1 of none.
#[cube(launch)]
fn take_limits(keys: &[u32], limits: &mut [f32], axis: u32, rows: u32) {
    if ABSOLUTE_POS == 0 {
        let at = (2u32 * axis) as usize;
        limits[at] = 0.0f32;
        limits[at + 1] = 1.0f32;
        if rows > 0u32 {
            let low = rows / 100u32;
            limits[at] = float_of(keys[low as usize]);
            limits[at + 1] = float_of(keys[(rows - 1u32 - low) as usize]);
        }
    }
}

/// Which of `last + 1` equal steps between the limits of an axis holds `value`.
#[cube]
fn cell(value: f32, limits: &[f32], axis: u32, last: f32) -> u32 {
    let at = (2u32 * axis) as usize;
    let low = limits[at];
    let share = (value - low) / (limits[at + 1] - low).max(SMALLEST);
    u32::cast_from(share.clamp(0.0f32, 1.0f32) * last)
}

/// Two zero bits between the bits of a 10-bit number.
#[cube]
fn spread(v: u32) -> u32 {
    let v = (v | (v << 16u32)) & 0x0300_00ffu32;
    let v = (v | (v << 8u32)) & 0x0300_f00fu32;
    let v = (v | (v << 4u32)) & 0x030c_30c3u32;
    (v | (v << 2u32)) & 0x0924_9249u32
}

/// Place along the curve and slot of time of every splat.
#[cube(launch)]
fn codes(
    geometry: &[f32],
    time: &[f32],
    bindings: &[u32],
    limits: &[f32],
    places: &mut [u32],
    rows: &mut [u32],
    slots: &mut [u32],
    n: u32,
    n_static: u32,
    n_still: u32,
    windows: u32,
    mean: u32,
    time_mean: u32,
) {
    let i = ABSOLUTE_POS as u32;
    if i < n {
        let mut place = 0u32;
        for k in 0u32..3u32 {
            let value = geometry[(mean + k * n + i) as usize];
            place |= spread(cell(value, limits, k, 1023.0f32)) << k;
        }
        let mut slot = 0u32;
        if i >= n_static {
            let value = time[(time_mean + i - n_static) as usize];
            slot = 1u32 + windows + cell(value, limits, 3u32, 63.0f32);
            if i < n_still {
                // the first column
                slot = 1u32 + bindings[(i - n_static) as usize];
            }
        }
        places[i as usize] = place;
        rows[i as usize] = i;
        slots[i as usize] = slot;
    }
}
