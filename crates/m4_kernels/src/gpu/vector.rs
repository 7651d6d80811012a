//! Vectors of three numbers, and where the numbers of a camera at an instant lie.
#![expect(
    missing_docs,
    reason = "`cube` generates items beside those that it is written at"
)]

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
    v3(
        a.y * b.z - a.z * b.y,
        a.z * b.x - a.x * b.z,
        a.x * b.y - a.y * b.x,
    )
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
    v3(
        r0.x * v.x + r1.x * v.y + r2.x * v.z,
        r0.y * v.x + r1.y * v.y + r2.y * v.z,
        r0.z * v.x + r1.z * v.y + r2.z * v.z,
    )
}

/// Where each number lies: the rotation from world to camera takes 0 to 8, row by row.
pub(crate) const CENTRE: usize = 9;
pub(crate) const FOCAL: usize = 12;
/// Principal point, the centre of the first pixel at 0.
pub(crate) const MIDDLE: usize = 14;
/// Within which the Jacobian is evaluated.
pub(crate) const LIMITS: usize = 16;
pub(crate) const TIME: usize = 20;
pub(crate) const INVERSE_PERIOD: usize = 21;
pub(crate) const NEAR: usize = 22;
pub(crate) const SIZE: usize = 23;
pub(crate) const BACKGROUND: usize = 25;
/// How many numbers there are.
pub(crate) const EYE: usize = 28;
