//! The SIMD twin: an 8x8 tile lives in registers while its splats pass by.
//!
//! Four vectors of sixteen pixels (two rows each) hold a tile. No branch in the loops depends on a
//! pixel. A pixel that is finished keeps its transmittance with a *minus* sign: from then on it fails
//! the test `T (1 - alpha) >= T_MIN` by itself, and its value stays known.

use super::{
    ALPHA_MAX, ALPHA_MIN, T_MIN,
    planes::{BandGradient, BandPlace, BandPlanes, PIXELS},
};
use crate::{
    bin::cpu::{BAND_TILES, Band, Record},
    simd::{all, all3, each, exp2},
};
use fearless_simd::{Simd, f32x16, prelude::*};
use fearless_simd_macros::simd;

/// Vectors a tile.
const QUADS: usize = PIXELS / 16;
/// Column and row of each lane.
const COLUMN: [f32; 16] = [0., 1., 2., 3., 4., 5., 6., 7., 0., 1., 2., 3., 4., 5., 6., 7.];
const ROW: [f32; 16] = [0., 0., 0., 0., 0., 0., 0., 0., 1., 1., 1., 1., 1., 1., 1., 1.];
/// Columns after two vectors have been zipped together and the two rows added.
const COLUMN_ZIPPED: [f32; 16] = [0., 0., 1., 1., 2., 2., 3., 3., 4., 4., 5., 5., 6., 6., 7., 7.];

/// What a splat's gradient is made of: sums over pixels of
/// `omega = dL/d(alpha) alpha`, of `omega` times powers of `d = centre - pixel`, and of the channel
/// gradients times the weight of the splat.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C, align(64))]
pub(crate) struct Sums(pub(crate) [f32; 16]);

impl Sums {
    // the order in which the pairwise sums of `fold` come out
    pub(crate) const LEN: usize = 16;
    pub(crate) const WEIGHT: usize = 0;
    /// `dx`, `dy`.
    pub(crate) const FIRST: [usize; 2] = [6, 8];
    /// `dx dx`, `dx dy`, `dy dy`.
    pub(crate) const SECOND: [usize; 3] = [1, 14, 4];
    pub(crate) const RGB: [usize; 3] = [12, 2, 10];
    pub(crate) const DEPTH: usize = 5;
}

/// What sixteen pixels do with one splat.
#[derive(Clone, Copy)]
struct Blend<S: Simd> {
    /// Cut at [`ALPHA_MAX`]; 0 where the splat is not blended.
    alpha: f32x16<S>,
    /// `T alpha`.
    weight: f32x16<S>,
    /// The transmittance after it.
    t: f32x16<S>,
}

/// The pixels' constants, kept in registers.
#[derive(Clone, Copy)]
struct Limits<S: Simd> {
    e_min: f32x16<S>,
    alpha_max: f32x16<S>,
    t_min: f32x16<S>,
    zero: f32x16<S>,
}

impl<S: Simd> Limits<S> {
    #[inline(always)]
    fn new(s: S) -> Self {
        Self {
            e_min: all(s, (ALPHA_MIN as f32).log2()),
            alpha_max: all(s, ALPHA_MAX as f32),
            t_min: all(s, T_MIN as f32),
            zero: all(s, 0.0),
        }
    }

    /// Section 1.7, for the exponent `e` (base 2) and the transmittance `t` before the splat.
    ///
    /// `t` is at least [`T_MIN`] until the pixel is finished and negative from then on, so one test
    /// decides everything: a pixel that the splat does not reach keeps its `t`, which passes; one that
    /// is finished cannot pass.
    #[inline(always)]
    fn blend(&self, s: S, e: f32x16<S>, t: f32x16<S>) -> Blend<S> {
        // where e is below its limit the power may be anything, NaN too: it is not selected
        let alpha = exp2(s, e).min(self.alpha_max);
        let alpha = e.simd_ge(self.e_min).select(alpha, self.zero);
        let weight = alpha * t;
        let next = t - weight;
        let pass = next.simd_ge(self.t_min);
        Blend {
            alpha: pass.select(alpha, self.zero),
            weight: pass.select(weight, self.zero),
            t: pass.select(next, -t.abs()),
        }
    }
}

/// One splat over a tile: what does not change from one pair of rows to the next.
#[derive(Clone, Copy)]
struct Brush<S: Simd> {
    dy: f32x16<S>,
    /// `log_opacity - a dx dx`.
    flat: f32x16<S>,
    /// `b dx`.
    shear: f32x16<S>,
    c: f32x16<S>,
}

impl<S: Simd> Brush<S> {
    #[inline(always)]
    fn new(s: S, r: &Record, x0: f32, y0: f32, column: f32x16<S>, row: f32x16<S>) -> Self {
        let dx = all(s, r.x - x0) - column;
        Self {
            dy: all(s, r.y - y0) - row,
            flat: (dx * all(s, -r.a)).mul_add(dx, all(s, r.log_opacity)),
            shear: all(s, r.b) * dx,
            c: all(s, r.c),
        }
    }

    /// Vertical distance and exponent in the pair of rows `q`.
    #[inline(always)]
    fn exponent(&self, s: S, q: usize) -> (f32x16<S>, f32x16<S>) {
        let dy = self.dy - all(s, 2.0 * q as f32);
        (dy, (-dy).mul_add(self.c.mul_add(dy, self.shear), self.flat))
    }
}

#[inline(always)]
fn quad<S: Simd>(s: S, tile: &[f32; PIXELS], q: usize) -> f32x16<S> {
    f32x16::from_slice(s, &tile[16 * q..16 * q + 16])
}

/// `1 / x`: the processor's estimate and a step of Newton's, good to a few units in the last place.
#[inline(always)]
fn reciprocal<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
    let y = x.approximate_recip();
    y * (-x).mul_add(y, all(s, 2.0))
}

#[inline(always)]
fn unfinished<S: Simd>(t: &[f32x16<S>; QUADS], zero: f32x16<S>) -> bool {
    t[0].max(t[1]).max(t[2].max(t[3])).simd_gt(zero).any_true()
}

/// Draws a band; `used[tile]` is how much of its list each tile needed.
#[inline(always)]
pub(crate) fn forward<S: Simd>(
    s: S,
    band: &Band,
    place: BandPlace,
    background: [f32; 3],
    out: &mut BandPlanes<'_>,
    used: &mut Vec<u32>,
) {
    if out.depth.is_empty() {
        band_forward::<S, false>(s, band, place, background, out, used);
    } else {
        band_forward::<S, true>(s, band, place, background, out, used);
    }
}

#[simd]
fn band_forward<S: Simd, const DEPTH: bool>(
    s: S,
    band: &Band,
    place: BandPlace,
    background: [f32; 3],
    out: &mut BandPlanes<'_>,
    used: &mut Vec<u32>,
) {
    used.clear();
    used.resize(place.tiles_x() * BAND_TILES, 0);
    for (tile, x0, y0, window) in place.tiles() {
        let fresh = window.fresh();
        let mut pixels = [[0.0; PIXELS]; 5];
        let list = band.list(tile);
        let count = tile_forward::<S, DEPTH>(s, list, &band.records, x0, y0, &fresh, background, &mut pixels);
        used[tile] = count as u32;
        for (pixels, plane) in pixels.iter().zip(&mut out.rgb) {
            window.store(pixels, plane);
        }
        window.store(&pixels[3], out.transmittance);
        if DEPTH {
            window.store(&pixels[4], out.depth);
        }
    }
}

/// Fills red, green, blue, transmittance and depth; returns how many splats it took.
#[inline(always)]
fn tile_forward<S: Simd, const DEPTH: bool>(
    s: S,
    list: &[u32],
    records: &[Record],
    x0: f32,
    y0: f32,
    fresh: &[f32; PIXELS],
    background: [f32; 3],
    out: &mut [[f32; PIXELS]; 5],
) -> usize {
    let limits = Limits::new(s);
    let (column, row) = (f32x16::from_slice(s, &COLUMN), f32x16::from_slice(s, &ROW));
    let zero = limits.zero;
    let mut t: [f32x16<S>; QUADS] = each!(QUADS, q => quad(s, fresh, q));
    let mut sum = [[zero; QUADS]; 3];
    let mut depth = [zero; QUADS];
    let mut count = list.len();
    for (n, &index) in list.iter().enumerate() {
        let r = &records[index as usize];
        let brush = Brush::new(s, r, x0, y0, column, row);
        let rgb = all3(s, &r.rgb);
        for q in 0..QUADS {
            let (_, e) = brush.exponent(s, q);
            let b = limits.blend(s, e, t[q]);
            for c in 0..3 {
                sum[c][q] = b.weight.mul_add(rgb[c], sum[c][q]);
            }
            if DEPTH {
                depth[q] = b.weight.mul_add(all(s, r.depth), depth[q]);
            }
            t[q] = b.t;
        }
        if n % 8 == 7 && !unfinished(&t, zero) {
            count = n + 1;
            break;
        }
    }
    for q in 0..QUADS {
        let at = 16 * q..16 * q + 16;
        let left = t[q].abs();
        for c in 0..3 {
            left.mul_add(all(s, background[c]), sum[c][q])
                .store_slice(&mut out[c][at.clone()]);
        }
        left.store_slice(&mut out[3][at.clone()]);
        if DEPTH {
            depth[q].store_slice(&mut out[4][at]);
        }
    }
    count
}

/// Adds up a band's gradient: `sums[i]` for its record `i`; returns the gradient with respect to the
/// background. `used` is what [`forward`] left.
#[inline(always)]
pub(crate) fn backward<S: Simd>(
    s: S,
    band: &Band,
    place: BandPlace,
    used: &[u32],
    g: &BandGradient<'_>,
    sums: &mut Vec<Sums>,
) -> [f64; 3] {
    if g.d_alpha.is_empty() && g.d_depth.is_empty() {
        band_backward::<S, false>(s, band, place, used, g, sums)
    } else {
        band_backward::<S, true>(s, band, place, used, g, sums)
    }
}

/// A tile's part of [`BandGradient`].
struct TileGradient {
    /// `<g, C>`, all channels together.
    behind: [f32; PIXELS],
    rgb: [[f32; PIXELS]; 3],
    alpha: [f32; PIXELS],
    depth: [f32; PIXELS],
}

#[simd]
fn band_backward<S: Simd, const EXTRA: bool>(
    s: S,
    band: &Band,
    place: BandPlace,
    used: &[u32],
    g: &BandGradient<'_>,
    sums: &mut Vec<Sums>,
) -> [f64; 3] {
    sums.clear();
    sums.resize(band.records.len(), Sums::default());
    // the tiles look records up out of order: read in order they come into the cache much faster, and
    // there they stay for the band
    std::hint::black_box(band.records.iter().fold(0.0, |sum, r| sum + r.x));
    let mut background = [0.0f64; 3];
    let mut tile_gradient = TileGradient {
        behind: [0.0; PIXELS],
        rgb: [[0.0; PIXELS]; 3],
        alpha: [0.0; PIXELS],
        depth: [0.0; PIXELS],
    };
    for (tile, x0, y0, window) in place.tiles() {
        let fresh = window.fresh();
        let v = &mut tile_gradient;
        let left = window.load(g.transmittance);
        v.behind = [0.0; PIXELS];
        for c in 0..3 {
            v.rgb[c] = window.load(g.d_rgb[c]);
            let colour = window.load(g.rgb[c]);
            let mut sum = 0.0;
            for p in 0..PIXELS {
                v.behind[p] += v.rgb[c][p] * colour[p];
                sum += v.rgb[c][p] * left[p];
            }
            background[c] += f64::from(sum);
        }
        if EXTRA {
            if !g.d_alpha.is_empty() {
                v.alpha = window.load(g.d_alpha);
                for p in 0..PIXELS {
                    v.behind[p] += v.alpha[p] * (1.0 - left[p]);
                }
            }
            if !g.d_depth.is_empty() {
                v.depth = window.load(g.d_depth);
                let depth = window.load(g.depth);
                for p in 0..PIXELS {
                    v.behind[p] += v.depth[p] * depth[p];
                }
            }
        }
        let list = &band.list(tile)[..used[tile] as usize];
        tile_backward::<S, EXTRA>(s, list, &band.records, x0, y0, &fresh, v, sums);
    }
    background
}

#[inline(always)]
fn tile_backward<S: Simd, const EXTRA: bool>(
    s: S,
    list: &[u32],
    records: &[Record],
    x0: f32,
    y0: f32,
    fresh: &[f32; PIXELS],
    v: &TileGradient,
    sums: &mut [Sums],
) {
    let limits = Limits::new(s);
    let (column, row) = (f32x16::from_slice(s, &COLUMN), f32x16::from_slice(s, &ROW));
    let zipped = f32x16::from_slice(s, &COLUMN_ZIPPED);
    let (zero, one) = (limits.zero, all(s, 1.0));
    // above it alpha was cut
    let e_max = all(s, (ALPHA_MAX as f32).log2());
    let mut t: [f32x16<S>; QUADS] = each!(QUADS, q => quad(s, fresh, q));
    let mut behind: [f32x16<S>; QUADS] = each!(QUADS, q => quad(s, &v.behind, q));
    for &index in list {
        let r = &records[index as usize];
        let brush = Brush::new(s, r, x0, y0, column, row);
        let rgb = all3(s, &r.rgb);
        let depth = all(s, r.depth);
        let (mut acc, mut of_depth) = ([zero; 6], zero);
        for q in 0..QUADS {
            let (dy, e) = brush.exponent(s, q);
            let b = limits.blend(s, e, t[q]);
            let (vr, vg, vb) = (quad(s, &v.rgb[0], q), quad(s, &v.rgb[1], q), quad(s, &v.rgb[2], q));
            let mut along = rgb[0].mul_add(vr, rgb[1].mul_add(vg, rgb[2] * vb));
            if EXTRA {
                let vd = quad(s, &v.depth, q);
                along = depth.mul_add(vd, along + quad(s, &v.alpha, q));
                of_depth = b.weight.mul_add(vd, of_depth);
            }
            behind[q] = (-b.weight).mul_add(along, behind[q]);
            // alpha dL/d(alpha), 0 where nothing is blended and where alpha was cut
            let omega = b
                .weight
                .mul_add(along, -(behind[q] * (b.alpha * reciprocal(s, one - b.alpha))));
            let omega = e.simd_lt(e_max).select(omega, zero);
            t[q] = b.t;
            let omega_y = omega * dy;
            if q == 0 {
                // adding to zero is not free
                acc = [
                    omega,
                    omega_y,
                    omega_y * dy,
                    b.weight * vr,
                    b.weight * vg,
                    b.weight * vb,
                ];
                continue;
            }
            acc[0] += omega;
            acc[1] += omega_y;
            acc[2] = omega_y.mul_add(dy, acc[2]);
            acc[3] = b.weight.mul_add(vr, acc[3]);
            acc[4] = b.weight.mul_add(vg, acc[4]);
            acc[5] = b.weight.mul_add(vb, acc[5]);
        }
        let total = fold::<S, EXTRA>(&acc, of_depth, all(s, r.x - x0) - zipped);
        let sum = &mut sums[index as usize].0;
        (f32x16::from_slice(s, sum) + total).store_slice(sum);
    }
}

/// Adds the lanes of all sums at once, by a tree of pairwise sums; `dx` is that of the zipped columns.
/// The result is in the order of [`Sums`].
#[inline(always)]
fn fold<S: Simd, const EXTRA: bool>(acc: &[f32x16<S>; 6], depth: f32x16<S>, dx: f32x16<S>) -> f32x16<S> {
    // halves of both added: sums of a in the even lanes, of b in the odd ones
    let pair = |a: f32x16<S>, b: f32x16<S>| a.zip_low(b) + a.zip_high(b);
    let p0 = pair(acc[0], acc[1]);
    let p1 = pair(acc[2], acc[3]);
    let p2 = pair(acc[4], acc[5]);
    let p3 = p0 * dx;
    let p4 = p3 * dx;
    let p5 = if EXTRA { pair(depth, depth) } else { depth };
    let q2 = pair(p4, p5);
    let r0 = pair(pair(p0, p1), pair(p2, p3));
    pair(r0, pair(q2, q2))
}

/// Adds to `scores[i]`, one a record, the weights of the pixels that record `i` is blended on.
#[inline(always)]
pub(crate) fn score<S: Simd>(s: S, band: &Band, place: BandPlace, used: &[u32], weight: &[f32], scores: &mut Vec<f32>) {
    band_score(s, band, place, used, weight, scores);
}

#[simd]
fn band_score<S: Simd>(s: S, band: &Band, place: BandPlace, used: &[u32], weight: &[f32], scores: &mut Vec<f32>) {
    scores.clear();
    scores.resize(band.records.len(), 0.0);
    let limits = Limits::new(s);
    let (column, row) = (f32x16::from_slice(s, &COLUMN), f32x16::from_slice(s, &ROW));
    for (tile, x0, y0, window) in place.tiles() {
        let fresh = window.fresh();
        let weight = window.load(weight);
        let mut t: [f32x16<S>; QUADS] = each!(QUADS, q => quad(s, &fresh, q));
        for &index in &band.list(tile)[..used[tile] as usize] {
            let brush = Brush::new(s, &band.records[index as usize], x0, y0, column, row);
            let mut sum = limits.zero;
            for q in 0..QUADS {
                let b = limits.blend(s, brush.exponent(s, q).1, t[q]);
                sum += b.alpha.simd_gt(limits.zero).select(quad(s, &weight, q), limits.zero);
                t[q] = b.t;
            }
            scores[index as usize] += sum.reduce_sum();
        }
    }
}
