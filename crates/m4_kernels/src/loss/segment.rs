//! Computes loss and gradient for some rows of one channel in one sweep.
//!
//! Sixteen rows at a time run through four stages, one block of sixteen columns after another: blur
//! down the columns of `x`, `y`, `x^2 + y^2` and `x y`; blur along the rows, which gives the
//! moments, then SSIM and its derivatives with respect to them; blur those along the rows; and, one
//! block of rows later, when the rows below are there, down the columns, which gives the gradient.
//! So nothing leaves the caches but the images and the gradient. What lies outside the image is 0
//! in every stage.
//!
//! Between the blurs down the columns blocks are turned: a vector is sixteen rows of one column
//! there. So a blur along the rows is a sum of vectors too, where it would be ten shifts of each
//! vector, and a turn takes four permutations a vector.
//!
//! The windowed means of `x^2` and `y^2` occur as a sum alone, hence seven blurs, not eight.

use super::buffers::{BLOCK, Buffers, Line, RING, SPAN, Turned};
use super::{SSIM_C1, SSIM_C2, WINDOW, cpu::Target, window};
use crate::simd::{LANES, all, each, load, store, turn};
use fearless_simd::{Simd, f32x16, mask32x16, prelude::*};
use fearless_simd_macros::simd;
use std::ops::Range;

/// Taps to either side.
const REACH: usize = WINDOW / 2;
/// Vectors that a blur gives at a time: those that it reads fit into the registers.
const HALF: usize = BLOCK / 2;
/// Vectors that it reads.
const WIDE: usize = HALF + 2 * REACH;
/// Blocks by which the gradient lags behind: its rows need [`REACH`] more on both sides.
const LAG: usize = 1;

/// Rows of one channel.
#[derive(Debug)]
pub(super) struct Segment<'a> {
    pub(super) target: &'a Target,
    /// The image's plane.
    pub(super) x: &'a [f32],
    pub(super) channel: usize,
    pub(super) rows: Range<usize>,
    /// Of the means over all pixels and channels: what `|x - y|` counts, and SSIM.
    pub(super) factors: [f32; 2],
}

/// Makes a block of columns one outside the image.
#[inline(always)]
fn clear<const N: usize>(columns: &mut Turned<N, SPAN>, block: usize) {
    let at = block * BLOCK % SPAN;
    for columns in columns {
        columns[at..at + BLOCK].fill(Line::default());
    }
}

/// What does not change within a segment.
struct Frame<S: Simd> {
    /// Of the window up to its middle.
    taps: [f32x16<S>; REACH + 1],
    width: usize,
    /// Blocks of columns.
    blocks: usize,
    /// Lines of a row in a ring: odd, so that the rows of a block do not compete for the same lines
    /// of the cache.
    stride: usize,
    /// Rows are counted from the first that a block reads; the image's first row is this one.
    above: isize,
}

impl<S: Simd> Frame<S> {
    #[inline(always)]
    fn new(s: S, segment: &Segment<'_>) -> Self {
        let (taps, width) = (window(), segment.target.width());
        let blocks = width.div_ceil(BLOCK);
        Self {
            taps: each!(REACH + 1, k => all(s, taps[k] as f32)),
            width,
            blocks,
            stride: blocks | 1,
            above: 2 * REACH as isize - segment.rows.start as isize,
        }
    }

    /// The row of the image, if it is in there.
    #[inline(always)]
    fn row(&self, segment: &Segment<'_>, row: usize) -> Option<usize> {
        let y = usize::try_from(row as isize - self.above).ok()?;
        (y < segment.target.height()).then_some(y)
    }

    /// Where block `block` of the eighteen rows from `top` on is in a ring.
    #[inline(always)]
    fn places(&self, top: usize, block: usize) -> [usize; WIDE] {
        each!(WIDE, k => (top + k) % RING * self.stride + block)
    }

    /// Eighteen rows of ring `n`.
    #[inline(always)]
    fn rows(&self, s: S, rings: &[Line], n: usize, places: &[usize; WIDE]) -> [f32x16<S>; WIDE] {
        let ring = &rings[n * RING * self.stride..][..RING * self.stride];
        each!(18, k => ring[places[k]].get(s))
    }

    /// Eighteen columns, the middle eight of which start at `first`.
    #[inline(always)]
    fn columns(&self, s: S, columns: &[Line; SPAN], first: usize) -> [f32x16<S>; WIDE] {
        let from = first + SPAN - REACH;
        each!(18, k => columns[(from + k) % SPAN].get(s))
    }

    /// Eight vectors blurred, of eighteen.
    #[inline(always)]
    fn blur(&self, v: &[f32x16<S>; WIDE]) -> [f32x16<S>; HALF] {
        each!(8, at => {
            let mut sum = v[at + REACH] * self.taps[REACH];
            for k in 0..REACH {
                // the window is symmetric
                sum = (v[at + k] + v[at + WINDOW - 1 - k]).mul_add(self.taps[k], sum);
            }
            sum
        })
    }
}

/// Writes the gradient of the rows, `[rows][width]`, and returns the sums of `|x - y|` and of SSIM
/// over them.
#[simd]
pub(super) fn run<S: Simd>(
    s: S,
    segment: &Segment<'_>,
    buffers: &mut Buffers,
    out: &mut [f32],
) -> [f64; 2] {
    let f = Frame::new(s, segment);
    buffers.fit(f.width, f.blocks, f.stride);
    let rows = segment.rows.len();
    // blocks of rows of the gradient, and of what it needs
    let (blocks, needed) = (rows.div_ceil(BLOCK), (rows + 2 * REACH).div_ceil(BLOCK));
    let mut total = [0.0f64; 2];
    let mut read = 0;
    for at in 0..blocks + LAG {
        if at < needed {
            let end = at * BLOCK + BLOCK + 2 * REACH;
            for row in read..end {
                if let Some(y) = f.row(segment, row) {
                    touch(&segment.x[y * f.width..][..f.width]);
                }
            }
            while read < end {
                read_row(s, &f, segment, read, buffers);
                read += 1;
            }
            total[1] += block_row(s, &f, segment, at * BLOCK, buffers);
        }
        if let Some(done) = at.checked_sub(LAG) {
            touch(&out[done * BLOCK * f.width..rows.min(at * BLOCK) * f.width]);
            for block in 0..f.blocks {
                for top in [done * BLOCK, done * BLOCK + HALF] {
                    if top < rows {
                        total[0] += gradient(s, &f, segment, top, block, buffers, out);
                    }
                }
            }
        }
    }
    total
}

/// Sixteen rows from images to pulls; `top` is the first that is read. Returns the sum of SSIM.
#[inline(always)]
fn block_row<S: Simd>(
    s: S,
    f: &Frame<S>,
    segment: &Segment<'_>,
    top: usize,
    buffers: &mut Buffers,
) -> f64 {
    // a block of columns to the left is outside the image, and one to the right
    clear(&mut buffers.moments, SPAN / BLOCK - 1);
    clear(&mut buffers.slopes, SPAN / BLOCK - 1);
    let row =
        f32x16::from_fn(s, |lane| lane as f32) + all(s, ((top + REACH) as isize - f.above) as f32);
    let inside = within(s, row, &(0..segment.target.height()));
    let counted = within(s, row, &segment.rows);
    let mut total = all(s, 0.0);
    for step in 0..f.blocks + 2 {
        if step < f.blocks {
            down(s, f, top, step, buffers);
        } else if step == f.blocks {
            clear(&mut buffers.moments, step);
        } else {
            clear(&mut buffers.slopes, f.blocks);
        }
        if (1..=f.blocks).contains(&step) {
            total += similarity(s, f, step - 1, [inside, counted], buffers);
        }
        if let Some(block) = step.checked_sub(2) {
            pull(s, f, top, block, buffers);
        }
    }
    f64::from(total.reduce_sum())
}

/// Reads a value of each cache line. What another kernel left or is to find comes into the near
/// caches much faster in such bunches of independent reads than block after block.
#[inline(always)]
fn touch(values: &[f32]) {
    for value in values.iter().step_by(LANES) {
        std::hint::black_box(*value);
    }
}

/// Which rows are some of `rows`.
#[inline(always)]
fn within<S: Simd>(s: S, row: f32x16<S>, rows: &Range<usize>) -> mask32x16<S> {
    row.simd_ge(all(s, rows.start as f32)) & row.simd_lt(all(s, rows.end as f32))
}

/// Fills a row of the rings.
#[inline(always)]
fn read_row<S: Simd>(s: S, f: &Frame<S>, segment: &Segment<'_>, row: usize, buffers: &mut Buffers) {
    let (images, targets) = buffers.images.split_at_mut(RING * f.stride);
    let at = row % RING * f.stride;
    let (image, target) = (
        &mut images[at..at + f.blocks],
        &mut targets[at..at + f.blocks],
    );
    match f.row(segment, row) {
        Some(y) => {
            let from = y * f.width;
            let x = &segment.x[from..from + f.width];
            segment
                .target
                .read(s, segment.channel, from, &mut buffers.row[..f.width]);
            let y = &buffers.row;
            let whole = f.width / BLOCK;
            for block in 0..whole {
                let at = block * BLOCK..(block + 1) * BLOCK;
                image[block].set(f32x16::from_slice(s, &x[at.clone()]));
                target[block].set(f32x16::from_slice(s, &y[at]));
            }
            if whole < f.blocks {
                image[whole].set(load(s, x, whole * BLOCK, 0.0));
                target[whole].set(f32x16::from_slice(s, &y[whole * BLOCK..]));
            }
        }
        None => {
            image.fill(Line::default());
            target.fill(Line::default());
        }
    }
}

/// The moments of a block down the columns; `top` is the first row read.
#[inline(always)]
fn down<S: Simd>(s: S, f: &Frame<S>, top: usize, block: usize, buffers: &mut Buffers) {
    let images = &buffers.images;
    let places = [f.places(top, block), f.places(top + HALF, block)];
    let [of_x, of_y, of_square, of_product] = &mut buffers.moments;
    // images are loaded again for each moment: all at once they do not fit into the registers
    for (n, moments) in [of_x, of_y].into_iter().enumerate() {
        let halves: [_; 2] = each!(2, half => f.blur(&f.rows(s, images, n, &places[half])));
        set_turned(moments, block, &halves);
    }
    let halves: [_; 2] = each!(2, half => {
        let (x, y) = (f.rows(s, images, 0, &places[half]), f.rows(s, images, 1, &places[half]));
        f.blur(&each!(18, k => x[k].mul_add(x[k], y[k] * y[k])))
    });
    set_turned(of_square, block, &halves);
    let halves: [_; 2] = each!(2, half => {
        let (x, y) = (f.rows(s, images, 0, &places[half]), f.rows(s, images, 1, &places[half]));
        f.blur(&each!(18, k => x[k] * y[k]))
    });
    set_turned(of_product, block, &halves);
}

/// Writes sixteen rows of a block as columns.
#[inline(always)]
fn set_turned<S: Simd>(columns: &mut [Line; SPAN], block: usize, halves: &[[f32x16<S>; HALF]; 2]) {
    let turned = turn(&join(halves));
    let at = block * BLOCK % SPAN;
    for k in 0..BLOCK {
        columns[at + k].set(turned[k]);
    }
}

#[inline(always)]
fn join<S: Simd>(halves: &[[f32x16<S>; HALF]; 2]) -> [f32x16<S>; BLOCK] {
    let mut all = [halves[0][0]; BLOCK];
    all[..HALF].copy_from_slice(&halves[0]);
    all[HALF..].copy_from_slice(&halves[1]);
    all
}

/// SSIM's derivatives for a block; returns the sum of SSIM. Of the rows, some are inside the image,
/// and some are counted.
#[inline(always)]
fn similarity<S: Simd>(
    s: S,
    f: &Frame<S>,
    block: usize,
    [inside, counted]: [mask32x16<S>; 2],
    buffers: &mut Buffers,
) -> f32x16<S> {
    let k = |v: f64| all(s, v as f32);
    let (two, one, zero, c1, c2) = (k(2.0), k(1.0), k(0.0), k(SSIM_C1), k(SSIM_C2));
    // two loops, because the processor looks only a limited number of operations ahead: much of the
    // second is waiting
    for (moments, blurred) in buffers.moments.iter().zip(&mut buffers.blurred) {
        for half in [0, HALF] {
            let columns = f.blur(&f.columns(s, moments, block * BLOCK + half));
            for k in 0..HALF {
                blurred[half + k].set(columns[k]);
            }
        }
    }
    let mut total = zero;
    let at = block * BLOCK % SPAN;
    let [of_mean, of_square, of_product] = &mut buffers.slopes;
    for column in 0..BLOCK {
        let [a, b, square, product]: [f32x16<S>; 4] =
            each!(4, n => buffers.blurred[n][column].get(s));
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
        // a column past the end of the rows
        let past = block * BLOCK + column >= f.width;
        let counts = if past {
            zero
        } else {
            counted.select(value, zero)
        };
        total += counts;
        let slopes: [f32x16<S>; 3] = each!(3, n => {
            let slope = [d_mean, d_square + d_square, d_product][n];
            if past { zero } else { inside.select(slope, zero) }
        });
        of_mean[at + column].set(slopes[0]);
        of_square[at + column].set(slopes[1]);
        of_product[at + column].set(slopes[2]);
    }
    total
}

/// Blurs a block's derivatives along the rows and turns it back; `top` is the first row.
#[inline(always)]
fn pull<S: Simd>(s: S, f: &Frame<S>, top: usize, block: usize, buffers: &mut Buffers) {
    for (n, slopes) in buffers.slopes.iter().enumerate() {
        let halves: [_; 2] =
            each!(2, half => f.blur(&f.columns(s, slopes, block * BLOCK + half * HALF)));
        let rows = turn(&join(&halves));
        let first = (n * RING + top % RING) * f.stride + block;
        for k in 0..BLOCK {
            buffers.pulls[first + k * f.stride].set(rows[k]);
        }
    }
}

/// Sixteen columns of the gradient of eight rows, the first of which is row `top` of the segment;
/// returns the sum of `|x - y|`.
#[inline(always)]
fn gradient<S: Simd>(
    s: S,
    f: &Frame<S>,
    segment: &Segment<'_>,
    top: usize,
    block: usize,
    buffers: &Buffers,
    out: &mut [f32],
) -> f64 {
    let zero = all(s, 0.0);
    let (of_l1, of_ssim) = (all(s, segment.factors[0]), all(s, segment.factors[1]));
    // the images' rows start REACH above those of the pulls
    let at: [usize; HALF] = each!(8, row => (top + 2 * REACH + row) % RING * f.stride + block);
    let (images, targets) = buffers.images.split_at(RING * f.stride);
    let places = f.places(top, block);
    // one after the other: all at once they do not fit into the registers
    let mut ssim = f.blur(&f.rows(s, &buffers.pulls, 0, &places));
    let pull = f.blur(&f.rows(s, &buffers.pulls, 1, &places));
    for row in 0..HALF {
        ssim[row] = images[at[row]].get(s).mul_add(pull[row], ssim[row]);
    }
    let pull = f.blur(&f.rows(s, &buffers.pulls, 2, &places));
    for row in 0..HALF {
        ssim[row] = targets[at[row]].get(s).mul_add(pull[row], ssim[row]);
    }
    let mut total = zero;
    for row in 0..HALF.min(segment.rows.len() - top) {
        let d = images[at[row]].get(s) - targets[at[row]].get(s);
        let sign = d
            .simd_gt(zero)
            .select(of_l1, d.simd_lt(zero).select(-of_l1, zero));
        let line = &mut out[(top + row) * f.width..][..f.width];
        store(ssim[row].mul_add(of_ssim, sign), line, block * BLOCK);
        // both are 0 past the end of a row
        total += d.abs();
    }
    f64::from(total.reduce_sum())
}

/// The mean over the channels of `|rgb - target|` for pixels `from..from + out.len()`.
#[simd]
pub(super) fn errors<S: Simd>(
    s: S,
    target: &Target,
    rgb: &[Vec<f32>; 3],
    from: usize,
    out: &mut [f32],
) {
    let mut row = vec![0.0; out.len()];
    out.fill(0.0);
    for channel in 0..3 {
        target.read(s, channel, from, &mut row);
        for at in (0..out.len()).step_by(LANES) {
            let d =
                load(s, &rgb[channel][from..from + out.len()], at, 0.0) - load(s, &row, at, 0.0);
            let sum = d.abs().mul_add(all(s, 1.0 / 3.0), load(s, out, at, 0.0));
            store(sum, out, at);
        }
    }
}
