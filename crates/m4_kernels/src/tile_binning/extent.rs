//! Exact extents: the tiles of each tile row that an ellipse reaches (docs/spec/optimiser.md 5.2).

use super::{TILE, cpu::BAND_TILES, handover::Reach};
use crate::{
    blend::ALPHA_MIN,
    project::cpu::{Ellipse, Eye},
    simd::{all, each},
};
use fearless_simd::{Simd, f32x16, i32x16, mask32x16, prelude::*, u32x16};
use std::ops::RangeInclusive;

/// Which tile rows sixteen ellipses reach, and where.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Extent<S: Simd> {
    /// Lanes that may reach the image.
    pub(crate) on: mask32x16<S>,
    /// Squared Mahalanobis radius at which alpha falls under the threshold.
    radius: f32x16<S>,
    half_height: f32x16<S>,
    /// Vertical offset of the rightmost point.
    right_at: f32x16<S>,
    /// Variance across at a fixed row, slope of the conditional mean.
    across: f32x16<S>,
    slope: f32x16<S>,
    inverse_11: f32x16<S>,
    /// First and last tile row; where a lane is off none is between them.
    top: f32x16<S>,
    bottom: f32x16<S>,
}

/// The edge of a tile and its inverse.
const EDGE: f32 = TILE as f32;
const INVERSE_EDGE: f32 = 1.0 / EDGE;
/// Covers the rounding of coordinates, pixels.
const SLACK_PX: f32 = 0.005;
/// Covers the rounding of alpha, relative.
const SLACK: f32 = 0.002;

impl<S: Simd> Extent<S> {
    #[inline(always)]
    pub(crate) fn new(s: S, eye: &Eye, e: &Ellipse<S>, log_opacity: f32x16<S>, on: mask32x16<S>) -> Self {
        let k = |v: f32| all(s, v);
        let [v00, v01, v11] = e.covariance;
        let strength = on.select(log_opacity, k(0.0)) - k((ALPHA_MIN as f32).log2());
        let radius = (strength * k(2.0 * std::f32::consts::LN_2) + k(SLACK)).max(k(0.0));
        let (reach_x, reach_y) = ((radius * v00).sqrt(), (radius * v11).sqrt());
        let (half_width, half_height) = (reach_x + k(SLACK_PX), reach_y + k(SLACK_PX));
        let inverse_11 = k(1.0) / v11;
        let (w, h) = (eye.width as f32, eye.height as f32);
        let top = (e.v - half_height).ceil().max(k(0.0));
        let bottom = (e.v + half_height).floor().min(k(h - 1.0));
        let left = (e.u - half_width).ceil().max(k(0.0));
        let right = (e.u + half_width).floor().min(k(w - 1.0));
        let on = on & top.simd_le(bottom) & left.simd_le(right);
        Self {
            on,
            radius,
            half_height,
            right_at: v01 * reach_x / v00,
            across: e.det * inverse_11,
            slope: v01 * inverse_11,
            inverse_11,
            top: on.select((top * k(INVERSE_EDGE)).floor(), k(f32::MAX)),
            bottom: on.select((bottom * k(INVERSE_EDGE)).floor(), k(-1.0)),
        }
    }

    /// Middle and half width at the vertical offset `y`.
    #[inline(always)]
    fn across(&self, s: S, e: &Ellipse<S>, y: f32x16<S>) -> (f32x16<S>, f32x16<S>) {
        let left = (self.radius - y * y * self.inverse_11) * self.across;
        let reach = left.max(all(s, 0.0)).sqrt() + all(s, SLACK_PX);
        (e.u + self.slope * y, reach)
    }

    /// The bands from the first to the last that one may reach; a lane must be on.
    #[inline(always)]
    pub(crate) fn bands(&self) -> RangeInclusive<usize> {
        let (first, last) = (self.top.reduce_min() as usize, self.bottom.reduce_max() as usize);
        first / BAND_TILES..=last / BAND_TILES
    }

    /// Whether one may reach a band.
    #[inline(always)]
    pub(crate) fn may_reach(&self, s: S, band: usize) -> bool {
        let row = (band * BAND_TILES) as f32;
        let above = self.top.simd_le(all(s, row + (BAND_TILES - 1) as f32));
        (above & self.bottom.simd_ge(all(s, row))).any_true()
    }

    /// The tiles of a band.
    #[inline(always)]
    pub(crate) fn reach(&self, s: S, eye: &Eye, e: &Ellipse<S>, band: usize) -> Reach<S> {
        let k = |v: f32| all(s, v);
        let (w, zero) = (k(eye.width as f32 - 1.0), k(0.0));
        let mut out = Reach::none(s);
        for row in 0..BAND_TILES {
            let tile = (band * BAND_TILES + row) as f32;
            let first = k(EDGE * tile) - e.v;
            let low = first.max(-self.half_height);
            let high = (first + k(EDGE - 1.0)).min(self.half_height);
            let (middle, reach) = self.across(s, e, self.right_at.max(low).min(high));
            let right = (middle + reach).floor().min(w);
            let (middle, reach) = self.across(s, e, (-self.right_at).max(low).min(high));
            let left = (middle - reach).ceil().max(zero);
            let hit = self.bottom.simd_ge(k(tile)) & low.simd_le(high) & left.simd_le(right);
            let edges: [i32x16<S>; 2] = each!(2, n => ([left, right + k(EDGE)][n] * k(INVERSE_EDGE)).to_int());
            let [first, end]: [u32x16<S>; 2] = each!(2, n => edges[n].bitcast());
            out.set(row, hit, first, end);
        }
        out
    }
}
