//! Some rows of one channel, from pictures to loss and gradient in one sweep.
//!
//! Eight rows at a time run through four stages, column block after column block: blur down the columns
//! of `x`, `y`, `x^2 + y^2` and `x y`; blur along the rows, which gives the moments, then SSIM and its
//! derivatives with respect to them; blur those along the rows; and, two blocks of rows later, when the
//! rows below are there, down the columns, which gives the gradient. So nothing leaves the caches but
//! the pictures and the gradient. What lies outside the image is 0 in every stage.
//!
//! The windowed means of `x^2` and `y^2` occur as a sum alone, hence seven blurs, not eight.

use super::{SSIM_C1, SSIM_C2, WINDOW, target::Target, window};
use crate::simd::{LANES, all, each, load, store};
use fearless_simd::{Simd, f32x16, prelude::*};
use fearless_simd_macros::simd;
use std::ops::Range;

/// Rows a block.
const BLOCK: usize = 8;
/// Taps to either side.
const REACH: usize = WINDOW / 2;
/// Rows that a block's blur down the columns reads.
const WIDE: usize = BLOCK + 2 * REACH;
/// Rows that are kept: from the gradient's first to the last that the moments need.
const RING: usize = 3 * BLOCK;
/// Blocks by which the gradient lags behind: its rows need [`REACH`] more on both sides.
const LAG: usize = 2;
/// Zeros to either side of a row.
const PAD: usize = LANES;

/// Rows of one channel.
#[derive(Debug)]
pub(super) struct Segment<'a> {
    pub(super) target: &'a Target,
    /// The picture's plane.
    pub(super) x: &'a [f32],
    pub(super) channel: usize,
    pub(super) rows: Range<usize>,
    /// Of the means over all pixels and channels: what `|x - y|` counts, and SSIM.
    pub(super) factors: [f32; 2],
}

/// Memory of a segment, kept from frame to frame. Nobody writes to the margins of the rows: they stay 0.
#[derive(Debug, Clone, Default)]
pub(super) struct Buffers {
    width: usize,
    /// Picture and target, `[2][RING][stride]`.
    pictures: Vec<f32>,
    /// Blurred down the columns, `[4][BLOCK][stride]`.
    moments: Vec<f32>,
    /// Derivatives with respect to mean, square and product, `[3][BLOCK][stride]`.
    slopes: Vec<f32>,
    /// The same blurred along the rows, `[3][RING][stride]`.
    pulls: Vec<f32>,
}

impl Buffers {
    /// Makes room for rows of another length.
    fn fit(&mut self, width: usize, stride: usize) {
        if self.width == width && !self.pictures.is_empty() {
            return;
        }
        self.width = width;
        for (buffer, rows) in [
            (&mut self.pictures, 2 * RING),
            (&mut self.moments, 4 * BLOCK),
            (&mut self.slopes, 3 * BLOCK),
            (&mut self.pulls, 3 * RING),
        ] {
            buffer.clear();
            buffer.resize(rows * stride, 0.0);
        }
    }
}

/// Sizes of the buffers, and the taps of the window up to its middle.
struct Frame<S: Simd> {
    taps: [f32x16<S>; REACH + 1],
    width: usize,
    /// Of a row in a buffer: an odd number of cache lines, so that the rows of a block do not compete for
    /// the same lines of the cache.
    stride: usize,
}

impl<S: Simd> Frame<S> {
    #[inline(always)]
    fn new(s: S, width: usize) -> Self {
        let taps = window();
        let lines = width.div_ceil(LANES) + 2;
        Self {
            taps: each!(REACH + 1, k => all(s, taps[k] as f32)),
            width,
            stride: (lines | 1) * LANES,
        }
    }

    /// Where column `x` of row `row` is.
    #[inline(always)]
    fn at(&self, row: usize, x: usize) -> usize {
        row * self.stride + PAD + x
    }

    /// Where column `x` of the eighteen rows from `top` on is in a ring.
    #[inline(always)]
    fn places(&self, top: usize, x: usize) -> [usize; WIDE] {
        let mut places = [0; WIDE];
        for (k, place) in places.iter_mut().enumerate() {
            *place = self.at((top + k) % RING, x);
        }
        places
    }

    /// Sixteen columns of eighteen rows of picture `n`.
    #[inline(always)]
    fn rows(&self, s: S, rings: &[f32], n: usize, places: &[usize; WIDE]) -> [f32x16<S>; WIDE] {
        let ring = &rings[n * RING * self.stride..][..RING * self.stride];
        each!(18, k => f32x16::from_slice(s, &ring[places[k]..places[k] + LANES]))
    }

    /// Down the columns: eight rows of the eighteen in `v`.
    #[inline(always)]
    fn down(&self, v: &[f32x16<S>; WIDE]) -> [f32x16<S>; BLOCK] {
        each!(8, row => {
            let mut sum = v[row + REACH] * self.taps[REACH];
            for k in 0..REACH {
                // the window is symmetric
                sum = (v[row + k] + v[row + WINDOW - 1 - k]).mul_add(self.taps[k], sum);
            }
            sum
        })
    }

    /// Writes eight rows of picture `n`.
    #[inline(always)]
    fn put(&self, buffer: &mut [f32], n: usize, column: usize, rows: &[f32x16<S>; BLOCK]) {
        for row in 0..BLOCK {
            let at = self.at(n * BLOCK + row, column);
            rows[row].store_slice(&mut buffer[at..at + LANES]);
        }
    }

    /// Along a row: sixteen columns, the first of which is at `at` in `buffer`.
    #[inline(always)]
    fn along(&self, s: S, buffer: &[f32], at: usize) -> f32x16<S> {
        // shifted in registers: a load that straddles two cache lines costs two
        let row = &buffer[at - LANES..at + 2 * LANES];
        let left = f32x16::from_slice(s, &row[..LANES]);
        let here = f32x16::from_slice(s, &row[LANES..2 * LANES]);
        let right = f32x16::from_slice(s, &row[2 * LANES..]);
        // the window is symmetric
        let t = &self.taps;
        let ends = (left.slide::<11>(here) + here.slide::<5>(right)) * t[0];
        let sum = (left.slide::<12>(here) + here.slide::<4>(right)).mul_add(t[1], ends);
        let sum = (left.slide::<13>(here) + here.slide::<3>(right)).mul_add(t[2], sum);
        let sum = (left.slide::<14>(here) + here.slide::<2>(right)).mul_add(t[3], sum);
        let sum = (left.slide::<15>(here) + here.slide::<1>(right)).mul_add(t[4], sum);
        here.mul_add(t[5], sum)
    }
}

/// Writes the gradient of the rows, `[rows][width]`, and returns the sums of `|x - y|` and of SSIM over
/// them.
#[simd]
pub(super) fn run<S: Simd>(s: S, segment: &Segment<'_>, buffers: &mut Buffers, out: &mut [f32]) -> [f64; 2] {
    let f = Frame::new(s, segment.target.width());
    buffers.fit(f.width, f.stride);
    let columns = f.width.div_ceil(LANES);
    // rows are counted from the first that a block reads; the image's first row is row `above`
    let above = 2 * REACH as isize - segment.rows.start as isize;
    let blocks = segment.rows.len().div_ceil(BLOCK);
    let mut total = [0.0f64; 2];
    let mut read = 0;
    for block in 0..blocks + LAG {
        while read < block * BLOCK + WIDE {
            read_row(s, &f, segment, read as isize - above, read % RING, buffers);
            read += 1;
        }
        for column in 0..columns + 2 {
            if column < columns {
                down(s, &f, block * BLOCK, column * LANES, buffers);
            }
            if (1..=columns).contains(&column) {
                let first = (block * BLOCK + REACH) as isize - above;
                total[1] += similarity(s, &f, segment, first, (column - 1) * LANES, buffers);
            }
            if column >= 2 {
                for n in 0..3 {
                    for row in 0..BLOCK {
                        let x = (column - 2) * LANES;
                        let pull = f.along(s, &buffers.slopes, f.at(n * BLOCK + row, x));
                        let to = f.at(n * RING + (block * BLOCK + row) % RING, x);
                        pull.store_slice(&mut buffers.pulls[to..to + LANES]);
                    }
                }
            }
        }
        if let Some(done) = block.checked_sub(LAG) {
            for column in 0..columns {
                total[0] += gradient(s, &f, segment, done * BLOCK, column * LANES, buffers, out);
            }
        }
    }
    total
}

/// Fills a row of the ring with row `y` of both pictures.
#[inline(always)]
fn read_row<S: Simd>(s: S, f: &Frame<S>, segment: &Segment<'_>, y: isize, slot: usize, buffers: &mut Buffers) {
    let (x, target) = buffers.pictures.split_at_mut(RING * f.stride);
    let at = f.at(slot, 0)..f.at(slot, f.width);
    match usize::try_from(y) {
        Ok(y) if y < segment.target.height() => {
            x[at.clone()].copy_from_slice(&segment.x[y * f.width..][..f.width]);
            segment.target.read(s, segment.channel, y * f.width, &mut target[at]);
        }
        _ => {
            x[at.clone()].fill(0.0);
            target[at].fill(0.0);
        }
    }
}

/// Sixteen columns of the moments of eight rows, down the columns; `top` is the first row read.
#[inline(always)]
fn down<S: Simd>(s: S, f: &Frame<S>, top: usize, column: usize, buffers: &mut Buffers) {
    let (pictures, moments) = (&buffers.pictures, &mut buffers.moments);
    let places = f.places(top, column);
    let x = f.rows(s, pictures, 0, &places);
    let y = f.rows(s, pictures, 1, &places);
    f.put(moments, 0, column, &f.down(&x));
    f.put(moments, 1, column, &f.down(&y));
    f.put(
        moments,
        2,
        column,
        &f.down(&each!(18, k => x[k].mul_add(x[k], y[k] * y[k]))),
    );
    f.put(moments, 3, column, &f.down(&each!(18, k => x[k] * y[k])));
}

/// Sixteen columns of SSIM's derivatives for eight rows, the first of which is row `top` of the image;
/// returns the sum of SSIM.
#[inline(always)]
fn similarity<S: Simd>(
    s: S,
    f: &Frame<S>,
    segment: &Segment<'_>,
    top: isize,
    column: usize,
    buffers: &mut Buffers,
) -> f64 {
    let k = |v: f64| all(s, v as f32);
    let (two, one, zero, c1, c2) = (k(2.0), k(1.0), k(0.0), k(SSIM_C1), k(SSIM_C2));
    let lane = f32x16::from_fn(s, |i| i as f32);
    let inside = lane.simd_lt(all(s, (f.width - column) as f32));
    let mut total = zero;
    for row in 0..BLOCK {
        let y = usize::try_from(top + row as isize).ok();
        let mut slopes = [zero; 3];
        if y.is_some_and(|y| y < segment.target.height()) {
            let [a, b, square, product] = each!(4, n => f.along(s, &buffers.moments, f.at(n * BLOCK + row, column)));
            let (ab, aa_bb) = (a * b, a.mul_add(a, b * b));
            let n1 = two.mul_add(ab, c1);
            let n2 = two.mul_add(product - ab, c2);
            let (d1, d2) = (aa_bb + c1, square - aa_bb + c2);
            // one division for both reciprocals
            let inverse = one / (d1 * d2);
            let (i1, i2) = (inverse * d2, inverse * d1);
            let value = n1 * n2 * inverse;
            let d_square = -(value * i2);
            let d_product = two * n1 * inverse;
            let d_mean = two * (b * n2 * inverse - a * (value * i1 + d_square)) - b * d_product;
            slopes = [d_mean, d_square, d_product];
            slopes = each!(3, n => inside.select(slopes[n], zero));
            if y.is_some_and(|y| segment.rows.contains(&y)) {
                total += inside.select(value, zero);
            }
        }
        for n in 0..3 {
            let at = f.at(n * BLOCK + row, column);
            slopes[n].store_slice(&mut buffers.slopes[at..at + LANES]);
        }
    }
    f64::from(total.reduce_sum())
}

/// Sixteen columns of the gradient of eight rows, the first of which is row `top` of the segment; returns
/// the sum of `|x - y|`.
#[inline(always)]
fn gradient<S: Simd>(
    s: S,
    f: &Frame<S>,
    segment: &Segment<'_>,
    top: usize,
    column: usize,
    buffers: &Buffers,
    out: &mut [f32],
) -> f64 {
    let zero = all(s, 0.0);
    let (of_l1, of_ssim) = (all(s, segment.factors[0]), all(s, segment.factors[1]));
    let places = f.places(top, column);
    let pulls: [[f32x16<S>; BLOCK]; 3] = each!(3, n => f.down(&f.rows(s, &buffers.pulls, n, &places)));
    let mut total = zero;
    for row in 0..BLOCK.min(segment.rows.len() - top) {
        // the pictures' rows start REACH above those of the pulls
        let at = f.at((top + 2 * REACH + row) % RING, column);
        let x = f32x16::from_slice(s, &buffers.pictures[at..at + LANES]);
        let at = at + RING * f.stride;
        let y = f32x16::from_slice(s, &buffers.pictures[at..at + LANES]);
        let d = x - y;
        let sign = d.simd_gt(zero).select(of_l1, d.simd_lt(zero).select(-of_l1, zero));
        let ssim = pulls[0][row] + (x + x) * pulls[1][row] + y * pulls[2][row];
        let line = &mut out[(top + row) * f.width..][..f.width];
        store(ssim.mul_add(of_ssim, sign), line, column);
        // both are 0 past the end of a row
        total += d.abs();
    }
    f64::from(total.reduce_sum())
}

/// The mean over the channels of `|rgb - target|` for pixels `from..from + out.len()`.
#[simd]
pub(super) fn errors<S: Simd>(s: S, target: &Target, rgb: &[Vec<f32>; 3], from: usize, out: &mut [f32]) {
    let mut row = vec![0.0; out.len()];
    out.fill(0.0);
    for channel in 0..3 {
        target.read(s, channel, from, &mut row);
        for at in (0..out.len()).step_by(LANES) {
            let d = load(s, &rgb[channel][from..from + out.len()], at, 0.0) - load(s, &row, at, 0.0);
            let sum = d.abs().mul_add(all(s, 1.0 / 3.0), load(s, out, at, 0.0));
            store(sum, out, at);
        }
    }
}
