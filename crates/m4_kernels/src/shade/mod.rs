//! The colour of a splat seen from a camera at an instant: 4D spherindrical harmonics
//! (docs/spec/optimiser.md 1.8).
//!
//! ```text
//! colour = max(0, 1/2 + sum_n sum_l K[n, l] cos(2 pi n dt / period) Y_l(direction))
//! direction = (m(t) - centre) / |m(t) - centre|,  dt = t - time_mean
//! ```
//!
//! `m(t)` is the *shifted* mean, forward and backward. Coefficients come three channels at a time,
//! temporal index major: `K[n * sh_terms + l][channel]`, `n <= 2`, `l < (degree + 1)^2`,
//! `degree <= 3`. The order and signs of `Y` are those of the 3DGS family ([`C0`], [`C1`], [`C2`],
//! [`C3`]). Static splats have `dt = 0`: every cosine is 1. Where the sum is not above 0 the colour
//! is 0 and has no gradient.

pub(crate) mod cpu;
#[cfg(feature = "gpu")]
pub(crate) mod gpu;
pub mod reference;

/// `Y_0`.
pub const C0: f64 = 0.282_094_791_773_878_14;
/// Degree 1: factors of `-y, z, -x`.
pub const C1: f64 = 0.488_602_511_902_919_9;
/// Degree 2: factors of `xy, yz, 2zz - xx - yy, xz, xx - yy`.
pub const C2: [f64; 5] = [
    1.092_548_430_592_079_2,
    -1.092_548_430_592_079_2,
    0.315_391_565_252_520_05,
    -1.092_548_430_592_079_2,
    0.546_274_215_296_039_6,
];
/// Degree 3: factors of `y(3xx - yy), xyz, y(4zz - xx - yy), z(2zz - 3xx - 3yy), x(4zz - xx - yy),
/// z(xx - yy), x(xx - 3yy)`.
pub const C3: [f64; 7] = [
    -0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    -0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    -0.457_045_799_464_465_8,
    1.445_305_721_320_277,
    -0.590_043_589_926_643_5,
];
