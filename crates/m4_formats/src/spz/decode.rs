//! The blocks inside the gzip stream to splats.

use super::layout::{COLOUR_SCALE, Header, ROTATION_STEPS};
use crate::row::logit;
use m4_scene::{Column, SplatLayout, Splats};

/// Splats of blocks whose length is [`Header::payload_bytes`]; axes as in the file.
pub fn decode(header: &Header, payload: &[u8]) -> Splats {
    let n = header.splats as usize;
    let layout = SplatLayout {
        isotropic: false,
        sh_degree: usize::from(header.sh_degree),
        time_degree: 0,
    };
    let mut rest = payload;
    let blocks = header.widths().map(|width| {
        let (block, after) = rest.split_at(n * width);
        rest = after;
        block
    });
    let [positions, alphas, colours, scales, rotations, harmonics] = blocks;
    let mut splats = Splats::zeros(layout, n, 0);
    let unit = (-f64::from(header.fractional_bits)).exp2();
    for k in 0..3 {
        let column = splats.column_mut(Column::Mean, k);
        for (out, p) in column.iter_mut().zip(positions.as_chunks::<9>().0) {
            // to the upper three bytes, so that the shift back keeps the sign
            let steps = i32::from_le_bytes([0, p[3 * k], p[3 * k + 1], p[3 * k + 2]]) >> 8;
            *out = (f64::from(steps) * unit) as f32;
        }
        unweave(splats.column_mut(Column::LogScale, k), scales, 3, k, |v| {
            v / 16.0 - 10.0
        });
        let colour = |v: f32| (v / 255.0 - 0.5) / COLOUR_SCALE;
        unweave(splats.column_mut(Column::Colour, k), colours, 3, k, colour);
    }
    unweave(splats.column_mut(Column::Opacity, 0), alphas, 1, 0, |v| {
        logit(f64::from(v) / 255.0)
    });
    let width = 3 * header.rest_terms();
    for c in 0..width {
        let column = splats.column_mut(Column::Colour, 3 + c);
        unweave(column, harmonics, width, c, |v| (v - 128.0) / 128.0);
    }
    for i in 0..n {
        let q = if header.version == 2 {
            let [x, y, z] = std::array::from_fn(|k| f32::from(rotations[3 * i + k]) / 127.5 - 1.0);
            [(1.0 - x * x - y * y - z * z).max(0.0).sqrt(), x, y, z]
        } else {
            let bytes = &rotations[4 * i..4 * i + 4];
            smallest_three(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
        };
        for (k, v) in q.into_iter().enumerate() {
            splats.column_mut(Column::Quat, k)[i] = v;
        }
    }
    splats
}

/// Column `offset` of rows of `width` bytes.
fn unweave(column: &mut [f32], block: &[u8], width: usize, offset: usize, value: impl Fn(f32) -> f32) {
    for (out, byte) in column.iter_mut().zip(block.iter().skip(offset).step_by(width)) {
        *out = value(f32::from(*byte));
    }
}

/// The quaternion `(w, x, y, z)` of 32 bits.
fn smallest_three(mut packed: u32) -> [f32; 4] {
    let largest = (packed >> 30) as usize;
    let mut q = [0f32; 4];
    let mut squares = 0.0;
    for i in (0..4).rev().filter(|&i| i != largest) {
        let magnitude = (packed & 0x1ff) as f32 * std::f32::consts::FRAC_1_SQRT_2 / ROTATION_STEPS;
        q[i] = if packed >> 9 & 1 == 1 { -magnitude } else { magnitude };
        squares += magnitude * magnitude;
        packed >>= 10;
    }
    q[largest] = (1.0 - squares).max(0.0).sqrt();
    // three components of 1/sqrt(2) each leave nothing: any unit length will do
    let length = squares.max(1.0).sqrt();
    let [x, y, z, w] = q.map(|v| v / length);
    [w, x, y, z]
}
