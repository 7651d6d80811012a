//! Bound splats ([`m4_core::Binding`]) in the payload: version 2 of the layout, which pages and
//! programs that read version 1 alone refuse.
//!
//! A scene with bound splats has [`VERSION_BOUND`] in its header, and behind the header of version
//! 1
//!
//! | offset | type | what |
//! |---|---|---|
//! | 136 | u32 | `bound`: splats that are bound, the first of the dynamic ones; at least one |
//! | 140 | u32 | `windows` |
//! | 144 | 2 x f64 | `life_low`, `life_step`, frames |
//! | 160 | 2 x f64 | `residual_spread`, world units per frame; `residual_step` |
//! | 176 | 2 x f64 | `trend_spread`, per frame; `trend_step` |
//! | 192 | `windows` x 3 x u32 | of each window: bound splats, keys, nodes |
//!
//! Bound splats lie in the order of their windows, those of a window in that of their nodes. The
//! planes begin behind that table. Time mean, time sd and velocity are those of the other dynamic
//! splats alone ("free"). The opacity of a bound splat is at most 1 - 1/2048, so that it can fade
//! in optical depth. Behind the planes of free splats, in the same form:
//!
//! | parameter | components | bytes | splats | value |
//! |---|---|---|---|---|
//! | residual velocity | 3 | 2 | bound | `residual_spread sinh(residual_step (q - 2^15))`, world units per frame |
//! | trend | 3 | 1 | bound | `trend_spread sinh(trend_step (q - 2^7))`, change of the first coefficient of a channel per frame |
//! | birth | 1 | 2 | bound | time mean: key `q` of the window |
//! | life | 2 | 2 | bound | begin, end: `life_low + life_step q`, frames; a begin of 0 is `-inf`, an end of 65535 is `inf` |
//! | nodes | 4 | 2 | bound | nodes of the window |
//! | weights | 3 | 1 | bound | `q / 255`; the fourth is 1 less their sum |
//!
//! Then the windows: the keys of all of them as f32, frames, and planes with a value a node,
//! windows one after the other, their rows one after the other:
//!
//! | parameter | components | bytes | rows of a window | value |
//! |---|---|---|---|---|
//! | position | 3 | 3 | anchors, then one a key | as means |
//! | left out | 1 | 1 | one a key | which of `(w, x, y, z)` is the largest: it is positive and follows from the others |
//! | rotation | 3 | 2 | one a key | the component `k + 1` places after it: `(2 q / 16383 - 1) / sqrt(2)` |
//!
//! Nodes move steadily: of positions and rotations there is `2 d` or `-2 d - 1` for `d >= 0` or
//! `d < 0` instead of `q`, where `d` is `q` less that of the same node in the row before (0 before
//! the first), both modulo 2^24 or 2^14.
//!
//! A coordinate is off by at most a 64th of a pixel at the median depth, a rotation by at most
//! 0.0003 radians: a hundredth of a pixel at a distance of 30 pixels from the node. A splat whose
//! time mean is not a key is moved to the nearest one, with its residual velocity and trend.
//! Windows without splats are left out.

mod decode;
mod encode;

pub(super) use decode::{Table, fill};
pub(super) use encode::{Bound, Codes, reborn};

use super::{HEADER_BYTES, Sinh};
use m4_core::Window;

/// Version of the layout of a scene with bound splats.
pub const VERSION_BOUND: u32 = 2;
/// Bytes of the header of this version before its table of windows.
const FIXED_BYTES: usize = HEADER_BYTES + 56;
/// Bytes of a window in that table.
const TABLE_BYTES: usize = 12;
/// Half the time in which a splat fades in or out, as a share of the mean time between keys
/// (`m4_kernels::pose`).
const FADE: f64 = 0.6;
/// A splat that is present by less is not drawn (likewise).
const LEAST_PRESENCE: f64 = 1e-3;
/// The last code of a begin or an end.
const LIFE_TOP: u32 = 65535;
/// Sum of the codes of the weights.
const WEIGHT_SUM: u32 = 255;
/// The last code of a component of a node's rotation, which has a power of two of them.
const TURN_TOP: u32 = (1 << 14) - 1;
const MIDDLE_8: f64 = (1u32 << 7) as f64;

/// Components and bytes of what bound splats have beside what all have: residual velocity, trend,
/// birth, life, nodes, weights.
pub(super) const BOUND_PARTS: [(usize, usize); 6] =
    [(3, 2), (3, 1), (1, 2), (2, 2), (4, 2), (3, 1)];
/// Bytes of a node at a key, and of its anchor.
const POSE_BYTES: u64 = 3 * 3 + 1 + 3 * 2;
const ANCHOR_BYTES: u64 = 3 * 3;

impl Sinh {
    pub(super) fn trend(spread: f64, step: f64) -> Self {
        Self {
            centre: 0.0,
            spread,
            step,
            middle: MIDDLE_8,
        }
    }
}

/// A node's rotation as the place of its largest component and the codes of the other three.
fn turn_code([w, x, y, z]: [f32; 4]) -> (u32, [u32; 3]) {
    let quat = [w, x, y, z].map(f64::from);
    let length = quat.iter().map(|v| v * v).sum::<f64>().sqrt();
    let largest = (1..4).fold(0, |best, k| {
        if quat[k].abs() > quat[best].abs() {
            k
        } else {
            best
        }
    });
    let scale = quat[largest].signum() * std::f64::consts::SQRT_2 / length;
    let top = f64::from(TURN_TOP);
    let code = |k: usize| {
        ((quat[(largest + k + 1) % 4] * scale + 1.0) / 2.0 * top)
            .round()
            .clamp(0.0, top) as u32
    };
    (largest as u32, std::array::from_fn(code))
}

/// The unit quaternion of [`turn_code`]; `largest` is at most 3.
fn turn_value(largest: u32, codes: [u32; 3]) -> [f32; 4] {
    let (mut quat, mut rest) = ([0.0f64; 4], 1.0);
    for (k, q) in codes.into_iter().enumerate() {
        let v = (f64::from(q) / f64::from(TURN_TOP) * 2.0 - 1.0) * std::f64::consts::FRAC_1_SQRT_2;
        quat[(largest as usize + k + 1) % 4] = v;
        rest -= v * v;
    }
    quat[largest as usize] = rest.max(0.0).sqrt();
    let length = quat.iter().map(|v| v * v).sum::<f64>().sqrt();
    quat.map(|v| (v / length) as f32)
}

/// The difference of two codes, as a code that is small where they are alike; all of `top + 1`, a
/// power of two.
fn step_code(before: u32, q: u32, top: u32) -> u32 {
    let d = q.wrapping_sub(before) & top;
    if d > top / 2 {
        2 * (top - d) + 1
    } else {
        2 * d
    }
}

/// The second code of [`step_code`], for any number.
fn step_value(before: u32, step: u32, top: u32) -> u32 {
    let half = step >> 1;
    before.wrapping_add(if step & 1 == 1 { !half } else { half }) & top
}

/// How much of a splat is there at `t`, frames (`m4_kernels::pose`).
fn presence(t: f64, [begin, end]: [f32; 2], half: f64) -> f64 {
    let step = |x: f64| {
        let s = (0.5 + 0.5 * x).clamp(0.0, 1.0);
        s * s * (3.0 - 2.0 * s)
    };
    step((t - f64::from(begin)) / half) * step((f64::from(end) - t) / half)
}

/// From when to when the splats of a window are carried at all, frames (`m4_kernels::pose`).
fn reach(window: &Window) -> [f64; 2] {
    let (keys, far) = (window.keys(), 2.0 * (0.5 + FADE) * f64::from(window.gap()));
    match keys {
        [first, .., last] => [f64::from(*first) - far, f64::from(*last) + far],
        _ => [f64::NEG_INFINITY, f64::INFINITY],
    }
}
