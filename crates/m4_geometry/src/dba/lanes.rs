//! The inner loops of the fast path: one edge, [`BLOCK`] pixels at a time, f32.
//!
//! With `x = X/Z`, `y = Y/Z`, `e = d/Z` the derivatives by the target's pose are
//! `fx (e, 0, -x e, -x y, 1 + x^2, -y)` and `fy (0, e, -y e, -1 - y^2, x y, x)`; those by the
//! source's pose are the same rows times a constant matrix, so no loop forms them. The v component
//! follows the u component in every row of an [`EdgeBlock`], so that both take part in one sum.

use super::options::{DbaOptions, WEIGHT_SCALE};
use super::problem::{Geometry, Grid, Pinhole};
use fearless_simd::Simd;
use fearless_simd::prelude::*;
use m4_core::nalgebra::DMatrix;

/// Pixels handled at once: their rows stay in the first or second level of cache.
pub(super) const BLOCK: usize = 128;

/// Both components of [`BLOCK`] pixels.
pub(super) const PAIR: usize = 2 * BLOCK;

/// One value a pixel.
pub(super) type Lane = [f32; BLOCK];

/// One value a pixel and component.
pub(super) type Row = [f32; PAIR];

/// `(u - cx)/fx` and `(v - cy)/fy` of every pixel, padded with zeros to whole blocks.
pub(super) struct Rays {
    x: Vec<f32>,
    y: Vec<f32>,
}

impl Rays {
    pub(super) fn new(grid: Grid, lens: &Pinhole<f64>) -> Self {
        let padded = grid.len().next_multiple_of(BLOCK);
        let mut rays = Self {
            x: vec![0.0; padded],
            y: vec![0.0; padded],
        };
        for n in 0..grid.len() {
            rays.x[n] = (((n % grid.width) as f64 - lens.cx) / lens.fx) as f32;
            rays.y[n] = (((n / grid.width) as f64 - lens.cy) / lens.fy) as f32;
        }
        rays
    }
}

/// What is constant over the pixels of an edge.
#[derive(Clone, Copy)]
pub(super) struct EdgeConstants {
    r: [[f32; 3]; 3],
    t: [f32; 3],
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    /// How a ray bends with the focal parameter, before the rotation.
    bend: [f32; 2],
    /// Change of `fx` and `fy` with the focal parameter.
    focal: [f32; 2],
    min_depth: f32,
    inverse_square: f32,
    scale: f32,
}

impl EdgeConstants {
    pub(super) fn new(
        geometry: &Geometry<f32>,
        source: usize,
        target: usize,
        options: &DbaOptions,
    ) -> Self {
        let g = geometry.relative(source, target).cast::<f32>();
        let lens = &geometry.lens;
        let rate = options.fy_rate(lens);
        Self {
            r: std::array::from_fn(|i| std::array::from_fn(|k| g.rotation[(i, k)])),
            t: std::array::from_fn(|i| g.translation[i]),
            fx: lens.fx as f32,
            fy: lens.fy as f32,
            cx: lens.cx as f32,
            cy: lens.cy as f32,
            bend: [
                (-2.0 * lens.cx / lens.fx) as f32,
                (-2.0 * lens.cx * rate / lens.fy) as f32,
            ],
            focal: [(2.0 * lens.cx) as f32, (2.0 * lens.cx * rate) as f32],
            min_depth: options.min_depth as f32,
            inverse_square: options.inverse_square() as f32,
            scale: WEIGHT_SCALE as f32,
        }
    }

    /// The same with weights that count in full, whatever the residual.
    pub(super) fn unscaled(self) -> Self {
        Self {
            inverse_square: 0.0,
            scale: 1.0,
            ..self
        }
    }
}

/// The derivatives and residuals of one edge at one block.
pub(super) struct EdgeBlock {
    /// By the twist of the target's pose.
    pub j: [Row; 6],
    /// By the disparity.
    pub jz: Row,
    /// By the focal parameter.
    pub jf: Row,
    /// Target minus projection, pixels.
    pub r: Row,
    /// Weight, 0 where the point is not valid.
    pub w: Row,
}

impl EdgeBlock {
    pub(super) fn new() -> Box<Self> {
        Box::new(Self {
            j: [[0.0; PAIR]; 6],
            jz: [0.0; PAIR],
            jf: [0.0; PAIR],
            r: [0.0; PAIR],
            w: [0.0; PAIR],
        })
    }
}

/// Copies a block of a plane, padding the last one with zeros.
#[inline(always)]
pub(super) fn load(plane: &[f32], start: usize) -> Lane {
    let mut lane = [0.0; BLOCK];
    let end = plane.len().min(start + BLOCK);
    lane[..end - start].copy_from_slice(&plane[start..end]);
    lane
}

/// A block of a plane where it lies; the last one is copied to `padded`.
#[inline(always)]
fn lane<'a>(plane: &'a [f32], start: usize, padded: &'a mut Lane) -> &'a Lane {
    match plane[start..].first_chunk::<BLOCK>() {
        Some(whole) => whole,
        None => {
            *padded = load(plane, start);
            padded
        }
    }
}

/// Fills `out` for the pixels from `start` on.
#[inline(always)]
pub(super) fn linearise(
    edge: &EdgeConstants,
    target_px: &[Vec<f32>; 2],
    weight: &[Vec<f32>; 2],
    rays: &Rays,
    disparity: &Lane,
    start: usize,
    out: &mut EdgeBlock,
) {
    let [mut pad0, mut pad1, mut pad2, mut pad3, mut pad4, mut pad5] = [[0.0; BLOCK]; 6];
    let (rx, ry) = (
        lane(&rays.x, start, &mut pad0),
        lane(&rays.y, start, &mut pad1),
    );
    let tu = lane(&target_px[0], start, &mut pad2);
    let tv = lane(&target_px[1], start, &mut pad3);
    let wu = lane(&weight[0], start, &mut pad4);
    let wv = lane(&weight[1], start, &mut pad5);
    let EdgeConstants { r, t, fx, fy, .. } = *edge;
    for l in 0..BLOCK {
        let d = disparity[l];
        let px = r[0][0] * rx[l] + r[0][1] * ry[l] + r[0][2] + t[0] * d;
        let py = r[1][0] * rx[l] + r[1][1] * ry[l] + r[1][2] + t[1] * d;
        let pz = r[2][0] * rx[l] + r[2][1] * ry[l] + r[2][2] + t[2] * d;
        let visible = pz > edge.min_depth;
        let iz = 1.0 / if visible { pz } else { 1.0 };
        let (x, y, e) = (px * iz, py * iz, d * iz);
        let (ru, rv) = (tu[l] - (fx * x + edge.cx), tv[l] - (fy * y + edge.cy));
        let robust = 1.0 / (1.0 + (ru * ru + rv * rv) * edge.inverse_square);
        let keep = if visible { edge.scale * robust } else { 0.0 };
        out.w[l] = wu[l] * keep;
        out.w[BLOCK + l] = wv[l] * keep;
        out.r[l] = ru;
        out.r[BLOCK + l] = rv;
        out.j[0][l] = fx * e;
        out.j[0][BLOCK + l] = 0.0;
        out.j[1][l] = 0.0;
        out.j[1][BLOCK + l] = fy * e;
        out.j[2][l] = -fx * x * e;
        out.j[2][BLOCK + l] = -fy * y * e;
        out.j[3][l] = -fx * x * y;
        out.j[3][BLOCK + l] = -fy * (1.0 + y * y);
        out.j[4][l] = fx * (1.0 + x * x);
        out.j[4][BLOCK + l] = fy * x * y;
        out.j[5][l] = -fx * y;
        out.j[5][BLOCK + l] = fy * x;
        out.jz[l] = fx * iz * (t[0] - x * t[2]);
        out.jz[BLOCK + l] = fy * iz * (t[1] - y * t[2]);
        let (bx, by) = (edge.bend[0] * rx[l], edge.bend[1] * ry[l]);
        let qx = r[0][0] * bx + r[0][1] * by;
        let qy = r[1][0] * bx + r[1][1] * by;
        let qz = r[2][0] * bx + r[2][1] * by;
        out.jf[l] = edge.focal[0] * x + fx * iz * (qx - x * qz);
        out.jf[BLOCK + l] = edge.focal[1] * y + fy * iz * (qy - y * qz);
    }
}

/// Adds `a b^T` to the lower triangle of `sums`, for two lists of rows whose length is a multiple
/// of three. Of the blocks on the diagonal all nine entries are added.
#[inline(always)]
pub(super) fn outer_products<S: Simd>(s: S, a: &[Lane], b: &[Lane], sums: &mut DMatrix<f64>) {
    for (i, a) in a.as_chunks::<3>().0.iter().enumerate() {
        for (j, b) in b.as_chunks::<3>().0[..=i].iter().enumerate() {
            let block = three_by_three(s, a.each_ref(), b.each_ref());
            for c in 0..3 {
                for r in 0..3 {
                    sums[(3 * i + r, 3 * j + c)] += f64::from(block[r][c]);
                }
            }
        }
    }
}

/// The nine inner products of three rows with three: nine sums and the six vectors they come from
/// fit into sixteen registers.
#[inline(always)]
pub(super) fn three_by_three<S: Simd, const N: usize>(
    s: S,
    a: [&[f32; N]; 3],
    b: [&[f32; N]; 3],
) -> [[f32; 3]; 3] {
    let width = S::f32s::LEN;
    let zero = S::f32s::splat(s, 0.0);
    let ([mut s00, mut s01, mut s02], [mut s10, mut s11, mut s12], [mut s20, mut s21, mut s22]) =
        ([zero; 3], [zero; 3], [zero; 3]);
    for k in (0..N).step_by(width) {
        let (b0, b1, b2) = (vector(s, b[0], k), vector(s, b[1], k), vector(s, b[2], k));
        let x = vector(s, a[0], k);
        (s00, s01, s02) = (x.mul_add(b0, s00), x.mul_add(b1, s01), x.mul_add(b2, s02));
        let x = vector(s, a[1], k);
        (s10, s11, s12) = (x.mul_add(b0, s10), x.mul_add(b1, s11), x.mul_add(b2, s12));
        let x = vector(s, a[2], k);
        (s20, s21, s22) = (x.mul_add(b0, s20), x.mul_add(b1, s21), x.mul_add(b2, s22));
    }
    // Written out: closures do not inherit the instruction set.
    [
        [s00.reduce_sum(), s01.reduce_sum(), s02.reduce_sum()],
        [s10.reduce_sum(), s11.reduce_sum(), s12.reduce_sum()],
        [s20.reduce_sum(), s21.reduce_sum(), s22.reduce_sum()],
    ]
}

/// The inner product of two rows.
#[inline(always)]
pub(super) fn dot<S: Simd, const N: usize>(s: S, a: &[f32; N], b: &[f32; N]) -> f64 {
    let width = S::f32s::LEN;
    let zero = S::f32s::splat(s, 0.0);
    let (mut even, mut odd) = (zero, zero);
    for k in (0..N).step_by(2 * width) {
        even = vector(s, a, k).mul_add(vector(s, b, k), even);
        odd = vector(s, a, k + width).mul_add(vector(s, b, k + width), odd);
    }
    f64::from((even + odd).reduce_sum())
}

#[inline(always)]
fn vector<S: Simd, const N: usize>(s: S, row: &[f32; N], at: usize) -> S::f32s {
    S::f32s::from_slice(s, &row[at..at + S::f32s::LEN])
}
