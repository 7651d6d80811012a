//! Vectors of three numbers.

#![expect(missing_docs, reason = "`cube` generates items beside those that it is written at")]

use cubecl::prelude::*;

/// A vector or a row of a matrix.
#[derive(CubeType, Clone, Copy)]
pub struct V3 {
    /// First.
    pub x: f32,
    /// Second.
    pub y: f32,
    /// Third.
    pub z: f32,
}

/// A vector of its numbers.
#[cube]
pub fn v3(x: f32, y: f32, z: f32) -> V3 {
    V3 { x, y, z }
}

/// `a . b`.
#[cube]
pub fn dot(a: &V3, b: &V3) -> f32 {
    a.x * b.x + a.y * b.y + a.z * b.z
}

/// `a x b`.
#[cube]
pub(crate) fn cross(a: &V3, b: &V3) -> V3 {
    v3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)
}

/// `s a`.
#[cube]
pub(crate) fn scaled(a: &V3, s: f32) -> V3 {
    v3(a.x * s, a.y * s, a.z * s)
}

/// `a + s b`.
#[cube]
pub(crate) fn add_scaled(a: &V3, s: f32, b: &V3) -> V3 {
    v3(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z)
}

/// Entry by entry.
#[cube]
pub(crate) fn times(a: &V3, b: &V3) -> V3 {
    v3(a.x * b.x, a.y * b.y, a.z * b.z)
}

/// `rows^T v`.
#[cube]
pub(crate) fn transposed(r0: &V3, r1: &V3, r2: &V3, v: &V3) -> V3 {
    v3(r0.x * v.x + r1.x * v.y + r2.x * v.z, r0.y * v.x + r1.y * v.y + r2.y * v.z, r0.z * v.x + r1.z * v.y + r2.z * v.z)
}
