//! Colours by 4D spherindrical harmonics, forward and backward.
use super::{C0, C1, C2, C3};
use crate::gpu::vector::{V3, add_scaled, dot, scaled, v3};
use crate::slice::gpu::{Carried, posed_number};
use cubecl::prelude::*;
use std::f32::consts::TAU;

// Factors of the harmonics, named after what they multiply.
const Y0: f32 = C0 as f32;
const Y1: f32 = C1 as f32;
const MINUS_Y1: f32 = -Y1;
const Y_XY: f32 = C2[0] as f32;
const Y_YZ: f32 = C2[1] as f32;
const Y_ZZ: f32 = C2[2] as f32;
const Y_XX_YY: f32 = C2[4] as f32;
const Y_XXX: f32 = C3[0] as f32;
const Y_XYZ: f32 = C3[1] as f32;
const Y_ZZY: f32 = C3[2] as f32;
const Y_ZZZ: f32 = C3[3] as f32;
const Y_ZXX: f32 = C3[5] as f32;

/// Real harmonic `l` at a unit direction.
#[cube]
fn harmonic(#[comptime] l: u32, d: &V3) -> f32 {
    let (x, y, z) = (d.x, d.y, d.z);
    match comptime!(l) {
        0u32 => f32::new(Y0),
        1u32 => MINUS_Y1 * y,
        2u32 => Y1 * z,
        3u32 => MINUS_Y1 * x,
        4u32 => Y_XY * x * y,
        5u32 => Y_YZ * y * z,
        6u32 => Y_ZZ * (2.0f32 * z * z - x * x - y * y),
        7u32 => Y_YZ * x * z,
        8u32 => Y_XX_YY * (x * x - y * y),
        9u32 => Y_XXX * y * (3.0f32 * x * x - y * y),
        10u32 => Y_XYZ * x * y * z,
        11u32 => Y_ZZY * y * (4.0f32 * z * z - x * x - y * y),
        12u32 => Y_ZZZ * z * (2.0f32 * z * z - 3.0f32 * x * x - 3.0f32 * y * y),
        13u32 => Y_ZZY * x * (4.0f32 * z * z - x * x - y * y),
        14u32 => Y_ZXX * z * (x * x - y * y),
        _ => Y_XXX * x * (x * x - 3.0f32 * y * y),
    }
}

/// Its gradient as a polynomial.
#[cube]
fn harmonic_slope(#[comptime] l: u32, d: &V3) -> V3 {
    let (x, y, z) = (d.x, d.y, d.z);
    match comptime!(l) {
        0u32 => v3(0.0f32, 0.0f32, 0.0f32),
        1u32 => v3(0.0f32, MINUS_Y1, 0.0f32),
        2u32 => v3(0.0f32, 0.0f32, Y1),
        3u32 => v3(MINUS_Y1, 0.0f32, 0.0f32),
        4u32 => scaled(&v3(y, x, 0.0f32), Y_XY),
        5u32 => scaled(&v3(0.0f32, z, y), Y_YZ),
        6u32 => scaled(&v3(-2.0f32 * x, -2.0f32 * y, 4.0f32 * z), Y_ZZ),
        7u32 => scaled(&v3(z, 0.0f32, x), Y_YZ),
        8u32 => scaled(&v3(2.0f32 * x, -2.0f32 * y, 0.0f32), Y_XX_YY),
        9u32 => scaled(&v3(6.0f32 * x * y, 3.0f32 * (x * x - y * y), 0.0f32), Y_XXX),
        10u32 => scaled(&v3(y * z, x * z, x * y), Y_XYZ),
        11u32 => scaled(
            &v3(
                -2.0f32 * x * y,
                4.0f32 * z * z - x * x - 3.0f32 * y * y,
                8.0f32 * y * z,
            ),
            Y_ZZY,
        ),
        12u32 => scaled(
            &v3(
                -6.0f32 * x * z,
                -6.0f32 * y * z,
                6.0f32 * z * z - 3.0f32 * (x * x + y * y),
            ),
            Y_ZZZ,
        ),
        13u32 => scaled(
            &v3(
                4.0f32 * z * z - 3.0f32 * x * x - y * y,
                -2.0f32 * x * y,
                8.0f32 * x * z,
            ),
            Y_ZZY,
        ),
        14u32 => scaled(&v3(2.0f32 * x * z, -2.0f32 * y * z, x * x - y * y), Y_ZXX),
        _ => scaled(
            &v3(3.0f32 * (x * x - y * y), -6.0f32 * x * y, 0.0f32),
            Y_XXX,
        ),
    }
}

/// Red, green, blue before the cut at 0 (Minute4D Eq. 2).
#[cube]
pub(crate) fn raw_colour(
    colour: &[f32],
    posed: &[f32],
    carried: &Carried,
    at: usize,
    rows: usize,
    direction: &V3,
    turns: f32,
    #[comptime] sh_terms: u32,
    #[comptime] time_terms: u32,
    #[comptime] bound: bool,
) -> V3 {
    let mut red = 0.5f32;
    let mut green = 0.5f32;
    let mut blue = 0.5f32;
    #[unroll]
    for term in 0u32..time_terms {
        let mut wave = 1.0f32;
        if comptime!(term > 0) {
            wave = (TAU * f32::cast_from(term) * turns).cos();
        }
        #[unroll]
        for l in 0u32..sh_terms {
            let w = wave * harmonic(l, direction);
            let k = comptime!((3 * (term * sh_terms + l)) as usize);
            let mut r = colour[k * rows + at];
            let mut g = colour[(k + 1) * rows + at];
            let mut b = colour[(k + 2) * rows + at];
            if comptime!(bound && term == 0 && l == 0) {
                if carried.on {
                    r = posed_number(posed, carried, 8usize);
                    g = posed_number(posed, carried, 9usize);
                    b = posed_number(posed, carried, 10usize);
                }
            }
            red += w * r;
            green += w * g;
            blue += w * b;
        }
    }
    v3(red, green, blue)
}

/// What colours pass on to geometry.
#[derive(CubeType, Clone, Copy)]
pub(crate) struct SightGradient {
    /// With respect to the vector from the camera's centre to the splat.
    pub offset: V3,
    /// With respect to `time_mean`, through the cosines alone.
    pub time_mean: f32,
}

/// Writes the gradient of the coefficients; `g` is that of the colour.
#[cube]
pub(crate) fn shade_backward(
    colour: &[f32],
    posed: &[f32],
    carried: &Carried,
    at: usize,
    rows: usize,
    direction: &V3,
    inverse_distance: f32,
    turns: f32,
    inverse_period: f32,
    g: &V3,
    out: &mut [f32],
    #[comptime] sh_terms: u32,
    #[comptime] time_terms: u32,
    #[comptime] bound: bool,
) -> SightGradient {
    let value = raw_colour(
        colour, posed, carried, at, rows, direction, turns, sh_terms, time_terms, bound,
    );
    let mut lr = 0.0f32;
    let mut lg = 0.0f32;
    let mut lb = 0.0f32;
    if value.x > 0.0f32 {
        lr = g.x;
    }
    if value.y > 0.0f32 {
        lg = g.y;
    }
    if value.z > 0.0f32 {
        lb = g.z;
    }
    let mut px = 0.0f32;
    let mut py = 0.0f32;
    let mut pz = 0.0f32;
    let mut time_mean = 0.0f32;
    #[unroll]
    for term in 0u32..time_terms {
        let mut cos = 1.0f32;
        let mut tilt = 0.0f32;
        if comptime!(term > 0) {
            let omega = TAU * f32::cast_from(term);
            cos = (omega * turns).cos();
            tilt = omega * inverse_period * (omega * turns).sin();
        }
        #[unroll]
        for l in 0u32..sh_terms {
            let k = comptime!((3 * (term * sh_terms + l)) as usize);
            let basis = harmonic(l, direction);
            let w = cos * basis;
            out[k * rows + at] = w * lr;
            out[(k + 1) * rows + at] = w * lg;
            out[(k + 2) * rows + at] = w * lb;
            if comptime!(l > 0 || term > 0) {
                let along = lr * colour[k * rows + at]
                    + lg * colour[(k + 1) * rows + at]
                    + lb * colour[(k + 2) * rows + at];
                let slope = harmonic_slope(l, direction);
                px += cos * along * slope.x;
                py += cos * along * slope.y;
                pz += cos * along * slope.z;
                time_mean += tilt * basis * along;
            }
        }
    }
    let d = v3(px, py, pz);
    let along = dot(direction, &d);
    SightGradient {
        offset: scaled(&add_scaled(&d, -along, direction), inverse_distance),
        time_mean,
    }
}
