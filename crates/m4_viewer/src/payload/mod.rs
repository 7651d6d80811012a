//! The payload of the page: the splats of a scene as quantised columns, without visible loss.
//!
//! Everything is little endian. A header of [`HEADER_BYTES`] bytes:
//!
//! | offset | type | what |
//! |---|---|---|
//! | 0 | 4 bytes | `M4SP` |
//! | 4 | u32 | version, [`VERSION`] |
//! | 8 | u32 | static splats |
//! | 12 | u32 | dynamic splats |
//! | 16 | u8 | `sh_degree`, 0..=3 |
//! | 17 | u8 | `time_degree`, 0..=2 |
//! | 18 | u8 | 1 if isotropic, else 0 |
//! | 19 | 5 bytes | 0 |
//! | 24 | 3 x f64 | `mean_centre`, world units |
//! | 48 | f64 | `mean_spread`, world units |
//! | 56 | f64 | `mean_step` |
//! | 64 | 2 x f64 | `scale_low`, `scale_step` |
//! | 80 | f64 | `colour_step` |
//! | 88 | 2 x f64 | `time_low`, `time_step`, frames |
//! | 104 | 2 x f64 | `sd_low`, `sd_step` |
//! | 120 | f64 | `velocity_spread`, world units per frame |
//! | 128 | f64 | `velocity_step` |
//!
//! Then the parameters in this order, `n` = static + dynamic splats, static ones first. A parameter
//! has components, each an unsigned integer `q` of this many bytes. For each component in turn, and
//! for each of its bytes in turn (the least significant first), there is one plane with a byte a
//! splat: the upper bytes, which hardly differ, lie together and all but vanish under gzip.
//!
//! | parameter | components | bytes | splats | value |
//! |---|---|---|---|---|
//! | mean | 3 | 3 | n | `mean_centre + mean_spread sinh(mean_step (q - 2^23))` |
//! | scale | 3 (isotropic: 1) | 1 | n | `exp(scale_low + scale_step q)`, standard deviation, world units |
//! | rotation | 1 (isotropic: none) | 4 | n | see below |
//! | opacity | 1 | 1 | n | `q / 255` at the peak in time |
//! | colour | 3 x terms | 2 | n | `colour_step (q - 2^15)`, component `3 term + channel` |
//! | time mean | 1 | 2 | dynamic | `time_low + time_step q`, frames |
//! | time sd | 1 | 1 | dynamic | `exp(sd_low + sd_step q)`, frames |
//! | velocity | 3 | 2 | dynamic | `velocity_spread sinh(velocity_step (q - 2^15))`, world units per frame |
//!
//! `terms = (sh_degree + 1)^2 (time_degree + 1)`, temporal index major, as in
//! [`m4_core::Column::Colour`]. Nothing follows the last plane. A scene with splats that are bound
//! to nodes has more, see [`bound`].
//!
//! A rotation is a unit quaternion without its largest component, which is made positive: bits 30
//! and 31 say which of `(w, x, y, z)` that is; bits `10 k ..= 10 k + 9` hold the component `k + 1`
//! places after it (cyclically), as `(v sqrt(2) + 1) / 2 x 1023`.
//!
//! # Why these steps
//!
//! A coordinate needs to be known to a share of the distance from which it is seen, so means and
//! velocities are spaced evenly in `asinh`: evenly near the cameras, by a constant ratio far from
//! them. Constants of [`encode()`] say how fine. Where the numbers end is measured, not assumed: a
//! scene goes through [`encode()`] and [`decode()`], is rendered from its source cameras and
//! compared (`crates/minute4d/tests/main.rs`).

pub mod bound;
mod decode;
mod encode;
#[cfg(test)]
mod tests;

pub use bound::VERSION_BOUND;
pub use decode::{PayloadError, decode};
pub use encode::{Payload, encode};

use m4_core::SplatLayout;

/// Bytes before the first plane.
pub const HEADER_BYTES: usize = 136;
/// Version of the layout described here, of a scene without bound splats.
pub const VERSION: u32 = 1;
const MAGIC: &[u8; 4] = b"M4SP";
/// Splats are not drawn where their temporal marginal is at most this (docs/spec/optimiser.md 1.3).
const MARGINAL_MIN: f64 = 0.05;
/// Standard deviations in time that a splat is drawn for, to either side: `sqrt(-2 ln 0.05)`.
const LIFE_SDS: f64 = 2.447_746_830_680_816;
/// `q` of the value 0 of components of three and of two bytes.
const MIDDLE_24: f64 = (1u32 << 23) as f64;
const MIDDLE_16: f64 = (1u32 << 15) as f64;

/// Components and bytes of each parameter that every splat has: mean, scale, rotation, opacity,
/// colour.
fn shared_parts(layout: SplatLayout) -> [(usize, usize); 5] {
    let (scales, rotations) = if layout.isotropic { (1, 0) } else { (3, 1) };
    [
        (3, 3),
        (scales, 1),
        (rotations, 4),
        (1, 1),
        (3 * layout.colour_terms(), 2),
    ]
}

/// The same for what dynamic splats have beside: time mean, time sd, velocity.
const TIME_PARTS: [(usize, usize); 3] = [(1, 2), (1, 1), (3, 2)];

/// Bytes of a static splat and of a dynamic one that is not bound.
pub fn bytes_per_splat(layout: SplatLayout) -> (usize, usize) {
    let sum = |parts: &[(usize, usize)]| {
        parts
            .iter()
            .map(|&(components, bytes)| components * bytes)
            .sum::<usize>()
    };
    let shared = sum(&shared_parts(layout));
    (shared, shared + sum(&TIME_PARTS))
}

/// Bytes of a bound splat, without its window.
pub fn bytes_per_bound_splat(layout: SplatLayout) -> usize {
    let (shared, _) = bytes_per_splat(layout);
    shared
        + bound::BOUND_PARTS
            .iter()
            .map(|&(components, bytes)| components * bytes)
            .sum::<usize>()
}

/// Appends the planes of one component, values of `width` bytes.
fn push_planes(bytes: &mut Vec<u8>, width: usize, values: &[u32]) {
    for k in 0..width {
        bytes.extend(values.iter().map(|q| (q >> (8 * k)) as u8));
    }
}

/// `centre + spread sinh(step (q - middle))`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sinh {
    pub centre: f64,
    pub spread: f64,
    pub step: f64,
    pub middle: f64,
}

impl Sinh {
    pub fn mean(centre: f64, spread: f64, step: f64) -> Self {
        Self {
            centre,
            spread,
            step,
            middle: MIDDLE_24,
        }
    }

    pub fn velocity(spread: f64, step: f64) -> Self {
        Self {
            centre: 0.0,
            spread,
            step,
            middle: MIDDLE_16,
        }
    }

    /// The nearest `q`; the last one where the value lies beyond.
    pub fn code(&self, value: f32) -> u32 {
        let x = (f64::from(value) - self.centre) / self.spread;
        // `asinh` of the standard library takes three times as long for the same bits that count
        // here
        let y = (x.abs() + (x * x + 1.0).sqrt()).ln().copysign(x);
        (y / self.step + self.middle)
            .round()
            .clamp(0.0, 2.0 * self.middle - 1.0) as u32
    }

    pub fn value(&self, q: u32) -> f32 {
        (self.centre + self.spread * (self.step * (f64::from(q) - self.middle)).sinh()) as f32
    }
}

/// `low + step q` with `q <= top`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Linear {
    pub low: f64,
    pub step: f64,
    pub top: f64,
}

impl Linear {
    /// From the smallest to the largest of `values`, with steps of at most `coarsest`: where that
    /// is not enough the smallest values are raised.
    pub fn over(values: impl Iterator<Item = f32>, top: f64, coarsest: f64) -> Self {
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(f64::from(v)), high.max(f64::from(v)))
        });
        if low > high {
            return Self {
                low: 0.0,
                step: 1.0,
                top,
            };
        }
        let step = ((high - low) / top).min(coarsest);
        Self {
            low: high - top * step,
            step,
            top,
        }
    }

    /// The nearest `q`.
    pub fn code(&self, value: f32) -> u32 {
        if self.step > 0.0 {
            ((f64::from(value) - self.low) / self.step)
                .round()
                .clamp(0.0, self.top) as u32
        } else {
            0
        }
    }

    pub fn value(&self, q: u32) -> f64 {
        self.low + self.step * f64::from(q)
    }
}

/// A quaternion of any length but 0 as 32 bits; that of no rotation where it has no direction.
pub(super) fn rotation_code(quat: [f32; 4]) -> u32 {
    let length = quat
        .iter()
        .map(|v| f64::from(*v).powi(2))
        .sum::<f64>()
        .sqrt();
    if !(length.is_finite() && length > 0.0) {
        return rotation_code([1.0, 0.0, 0.0, 0.0]);
    }
    let largest = (1..4).fold(0, |best, k| {
        if quat[k].abs() > quat[best].abs() {
            k
        } else {
            best
        }
    });
    let sign = f64::from(quat[largest]).signum();
    (0..3).fold((largest as u32) << 30, |bits, k| {
        let v = sign * f64::from(quat[(largest + k + 1) % 4]) / length;
        let q = ((v * std::f64::consts::SQRT_2 + 1.0) / 2.0 * 1023.0)
            .round()
            .clamp(0.0, 1023.0) as u32;
        bits | q << (10 * k)
    })
}

/// The unit quaternion of [`rotation_code`].
pub(super) fn rotation_value(bits: u32) -> [f32; 4] {
    let largest = (bits >> 30) as usize;
    let (mut quat, mut rest) = ([0.0f64; 4], 1.0);
    for k in 0..3 {
        let q = f64::from((bits >> (10 * k)) & 1023);
        let v = (q / 1023.0 * 2.0 - 1.0) * std::f64::consts::FRAC_1_SQRT_2;
        quat[(largest + k + 1) % 4] = v;
        rest -= v * v;
    }
    quat[largest] = rest.max(0.0).sqrt();
    let length = quat.iter().map(|v| v * v).sum::<f64>().sqrt();
    quat.map(|v| (v / length) as f32)
}
