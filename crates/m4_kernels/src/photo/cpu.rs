//! The SIMD twin: both passes of the window, and all that lies between, row by row.
//!
//! A row of a blurred picture is the weighted sum of eleven rows (columns stay apart: sixteen lanes),
//! and that of eleven shifted copies of the result. So nothing but three maps goes through memory
//! between the loss and its gradient; those of the target alone are kept from frame to frame.

use super::{SSIM_C1, SSIM_C2, WINDOW, window};
use crate::{
    SimdLevel,
    simd::{LANES, all, dispatch, each, load, store},
};
use fearless_simd::{Simd, f32x16, prelude::*};
use fearless_simd_macros::simd;
use m4_scene::ShapeError;
use rayon::prelude::*;

/// Rows a task: a multiple of [`BLOCK`] whose buffers fit the second-level cache.
const CHUNK_ROWS: usize = 16;
/// Rows that are blurred along the columns at once.
const BLOCK: usize = 4;
/// Taps to either side.
const REACH: usize = WINDOW / 2;
/// Zeros to either side of a row buffer.
const PAD: usize = LANES;

/// A picture to compare with, and what SSIM needs of it alone.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Target {
    width: usize,
    height: usize,
    rgb: [Vec<f32>; 3],
    /// Windowed mean of each channel.
    mean: [Vec<f32>; 3],
    /// Windowed variance of each channel.
    variance: [Vec<f32>; 3],
}

impl Target {
    /// Takes the planes of a picture, `[height][width]` each, 0..1.
    ///
    /// # Errors
    ///
    /// [`ShapeError`] if a plane does not hold `width * height` values.
    pub fn new(width: usize, height: usize, rgb: [Vec<f32>; 3]) -> Result<Self, ShapeError> {
        for plane in &rgb {
            ShapeError::check("target plane", width * height, plane.len())?;
        }
        let mut out = Self {
            width,
            height,
            rgb,
            mean: std::array::from_fn(|_| vec![0.0; width * height]),
            variance: std::array::from_fn(|_| vec![0.0; width * height]),
        };
        if width * height > 0 {
            out.moments();
        }
        Ok(out)
    }

    /// Becomes another picture, in the memory that is there: `fill` writes the planes, `[height][width]`
    /// each, 0..1, over whatever they hold.
    pub fn replace(&mut self, width: usize, height: usize, fill: impl FnOnce([&mut [f32]; 3])) {
        (self.width, self.height) = (width, height);
        let planes = self.rgb.iter_mut().chain(&mut self.mean).chain(&mut self.variance);
        planes.for_each(|plane| plane.resize(width * height, 0.0));
        fill(self.rgb.each_mut().map(Vec::as_mut_slice));
        if width * height > 0 {
            self.moments();
        }
    }

    /// Fills mean and variance, at the level that the process runs on; a name in the environment that
    /// is none is somebody else's error to report.
    fn moments(&mut self) {
        let level = SimdLevel::detect().unwrap_or_else(|_| SimdLevel::best()).level();
        let (width, height) = (self.width, self.height);
        let size = CHUNK_ROWS * width;
        let planes = self.mean.iter_mut().zip(&mut self.variance).zip(&self.rgb);
        let tasks: Vec<_> = planes
            .flat_map(|((mean, variance), rgb)| {
                let parts = mean.chunks_mut(size).zip(variance.chunks_mut(size));
                parts
                    .enumerate()
                    .map(move |(k, (m, v))| (k * CHUNK_ROWS, m, v, rgb.as_slice()))
            })
            .collect();
        tasks.into_par_iter().for_each(|(top, mean, variance, rgb)| {
            dispatch!(level, s => target_rows(s, rgb, width, height, top, mean, variance));
        });
    }

    /// Columns.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// The picture, one plane a channel.
    #[must_use]
    pub fn rgb(&self) -> &[Vec<f32>; 3] {
        &self.rgb
    }
}

/// Buffers kept from frame to frame.
#[derive(Debug, Clone, Default)]
pub struct PhotoScratch {
    /// For each channel: gradient of the mean SSIM with respect to the windowed mean, square and
    /// product.
    maps: [[Vec<f32>; 3]; 3],
}

/// The loss and its parts.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PhotoLoss {
    /// Mean absolute difference.
    pub l1: f64,
    /// Mean structural similarity, 1 for equal pictures.
    pub ssim: f64,
    /// `(1 - lambda) l1 + lambda (1 - ssim)`.
    pub total: f64,
}

/// The loss of `rgb` against `target` and, in `gradient`, its gradient with respect to `rgb`
/// (overwritten, resized as needed). Of a picture without pixels both are 0.
///
/// # Panics
///
/// If a plane of `rgb` does not hold as many values as the target.
pub fn loss(
    level: SimdLevel,
    target: &Target,
    rgb: &[Vec<f32>; 3],
    lambda: f32,
    scratch: &mut PhotoScratch,
    gradient: &mut [Vec<f32>; 3],
) -> PhotoLoss {
    let (width, height) = (target.width, target.height);
    let pixels = width * height;
    for plane in rgb {
        assert_eq!(plane.len(), pixels, "loss: planes of the target's size");
    }
    for plane in scratch.maps.iter_mut().flatten().chain(gradient.iter_mut()) {
        plane.resize(pixels, 0.0);
    }
    if pixels == 0 {
        return PhotoLoss::default();
    }
    let size = CHUNK_ROWS * width;
    let mut tasks = Vec::new();
    for (channel, maps) in scratch.maps.iter_mut().enumerate() {
        let [a, b, c] = maps;
        let parts = a.chunks_mut(size).zip(b.chunks_mut(size)).zip(c.chunks_mut(size));
        tasks.extend(
            parts
                .enumerate()
                .map(|(k, ((a, b), c))| (channel, k * CHUNK_ROWS, [a, b, c])),
        );
    }
    let sums: Vec<[f64; 2]> = tasks
        .into_par_iter()
        .map_init(Buffers::default, |buffers, (channel, top, maps)| {
            let plane = Plane::new(target, rgb, channel);
            dispatch!(level.level(), s => map_rows(s, &plane, top, maps, buffers))
        })
        .collect();

    let count = (3 * pixels) as f64;
    let maps = &scratch.maps;
    let (of_l1, of_ssim) = ((1.0 - f64::from(lambda)) / count, -f64::from(lambda) / count);
    let factors = [of_l1 as f32, of_ssim as f32];
    let tasks: Vec<_> = gradient
        .iter_mut()
        .enumerate()
        .flat_map(|(channel, plane)| {
            let parts = plane.chunks_mut(size).enumerate();
            parts.map(move |(k, rows)| (channel, k * CHUNK_ROWS, rows))
        })
        .collect();
    tasks
        .into_par_iter()
        .for_each_init(Buffers::default, |buffers, (channel, top, rows)| {
            let plane = Plane::new(target, rgb, channel);
            let maps = &maps[channel];
            dispatch!(level.level(), s => gradient_rows(s, &plane, maps, top, factors, rows, buffers));
        });

    let (l1, ssim) = sums
        .iter()
        .fold((0.0, 0.0), |(l1, ssim), part| (l1 + part[0], ssim + part[1]));
    let (l1, ssim) = (l1 / count, ssim / count);
    let lambda = f64::from(lambda);
    PhotoLoss {
        l1,
        ssim,
        total: (1.0 - lambda) * l1 + lambda * (1.0 - ssim),
    }
}

/// The mean over the channels of `|rgb - target|`, `[height][width]` (the error map of paper eq. 6).
///
/// # Panics
///
/// If a plane of `rgb` does not hold as many values as the target.
pub fn error_map(level: SimdLevel, target: &Target, rgb: &[Vec<f32>; 3], out: &mut Vec<f32>) {
    let pixels = target.width * target.height;
    for plane in rgb {
        assert_eq!(plane.len(), pixels, "error_map: planes of the target's size");
    }
    out.resize(pixels, 0.0);
    let size = CHUNK_ROWS * target.width.max(1);
    out.par_chunks_mut(size).enumerate().for_each(|(k, rows)| {
        dispatch!(level.level(), s => error_rows(s, target, rgb, k * size, rows));
    });
}

#[simd]
fn error_rows<S: Simd>(s: S, target: &Target, rgb: &[Vec<f32>; 3], first: usize, out: &mut [f32]) {
    for at in (0..out.len()).step_by(LANES) {
        let mut sum = all(s, 0.0);
        for c in 0..3 {
            sum += (load(s, &rgb[c], first + at, 0.0) - load(s, &target.rgb[c], first + at, 0.0)).abs();
        }
        store(sum * all(s, 1.0 / 3.0), out, at);
    }
}

/// One channel of picture and target.
struct Plane<'a> {
    width: usize,
    height: usize,
    x: &'a [f32],
    y: &'a [f32],
    mean: &'a [f32],
    variance: &'a [f32],
}

impl<'a> Plane<'a> {
    fn new(target: &'a Target, rgb: &'a [Vec<f32>; 3], channel: usize) -> Self {
        Self {
            width: target.width,
            height: target.height,
            x: &rgb[channel],
            y: &target.rgb[channel],
            mean: &target.mean[channel],
            variance: &target.variance[channel],
        }
    }
}

/// Row buffers of the blurs; kept by a thread from task to task.
#[derive(Default)]
struct Buffers(Vec<f32>);

/// Blurs `N` pictures at once, some rows of them.
struct Blur<'a, S: Simd, const N: usize> {
    taps: [f32x16<S>; WINDOW],
    width: usize,
    height: usize,
    /// Of a row in the buffer.
    stride: usize,
    /// `[N][CHUNK_ROWS][stride]`, blurred along the columns.
    rows: &'a mut [f32],
}

impl<'a, S: Simd, const N: usize> Blur<'a, S, N> {
    #[inline(always)]
    fn new(s: S, width: usize, height: usize, buffers: &'a mut Buffers) -> Self {
        let stride = width.next_multiple_of(LANES) + 2 * PAD;
        buffers.0.resize(N * CHUNK_ROWS * stride, 0.0);
        let taps = window();
        Self {
            taps: each!(WINDOW, k => all(s, taps[k] as f32)),
            width,
            height,
            stride,
            rows: &mut buffers.0,
        }
    }

    /// Along the columns: rows `top..top + count` of the pictures of which `fetch(i)` gives sixteen
    /// values each, from pixel `i` on; [`BLOCK`] rows at once, so that a pixel is read less than four
    /// times for its eleven uses.
    #[inline(always)]
    fn columns(&mut self, s: S, top: usize, count: usize, fetch: impl Fn(usize) -> [f32x16<S>; N]) {
        let zero = all(s, 0.0);
        // zeros before and after: a row of the window that a row of the block does not see
        let mut padded = [zero; WINDOW + 2 * (BLOCK - 1)];
        padded[BLOCK - 1..BLOCK - 1 + WINDOW].copy_from_slice(&self.taps);
        for block in (0..count).step_by(BLOCK) {
            for x in (0..self.width).step_by(LANES) {
                let mut sum = [[zero; N]; BLOCK];
                for k in 0..WINDOW + BLOCK - 1 {
                    // wraps above the picture, which is then out of it as well
                    let y = (top + block + k).wrapping_sub(REACH);
                    if y >= self.height {
                        continue;
                    }
                    let values = fetch(y * self.width + x);
                    for row in 0..BLOCK {
                        let tap = padded[k + BLOCK - 1 - row];
                        for n in 0..N {
                            sum[row][n] = values[n].mul_add(tap, sum[row][n]);
                        }
                    }
                }
                for row in 0..BLOCK {
                    for n in 0..N {
                        let at = (n * CHUNK_ROWS + block + row) * self.stride + PAD + x;
                        sum[row][n].store_slice(&mut self.rows[at..at + LANES]);
                    }
                }
            }
        }
        // past the end of a row the lanes above saw the next one; and before it, an older picture
        for row in self.rows.chunks_exact_mut(self.stride) {
            row[..PAD].fill(0.0);
            row[PAD + self.width..].fill(0.0);
        }
    }

    /// Along row `row` of those: sixteen columns from `x` on.
    #[inline(always)]
    fn at(&self, s: S, row: usize, x: usize) -> [f32x16<S>; N] {
        each!(N, n => {
            let from = (n * CHUNK_ROWS + row) * self.stride + PAD + x - REACH;
            let row = &self.rows[from..from + WINDOW - 1 + LANES];
            let mut sum = f32x16::from_slice(s, &row[REACH..REACH + LANES]) * self.taps[REACH];
            for k in 0..REACH {
                // the window is symmetric
                let left = f32x16::from_slice(s, &row[k..k + LANES]);
                let right = f32x16::from_slice(s, &row[WINDOW - 1 - k..WINDOW - 1 - k + LANES]);
                sum = (left + right).mul_add(self.taps[k], sum);
            }
            sum
        })
    }
}

#[simd]
fn target_rows<S: Simd>(
    s: S,
    y: &[f32],
    width: usize,
    height: usize,
    top: usize,
    mean: &mut [f32],
    variance: &mut [f32],
) {
    let mut buffers = Buffers::default();
    let mut blur = Blur::<S, 2>::new(s, width, height, &mut buffers);
    let rows = mean.len() / width;
    blur.columns(
        s,
        top,
        rows,
        #[inline(always)]
        |i| {
            let v = load(s, y, i, 0.0);
            [v, v * v]
        },
    );
    for row in 0..rows {
        for x in (0..width).step_by(LANES) {
            let [m, square] = blur.at(s, row, x);
            store(m, mean, row * width + x);
            store(square - m * m, variance, row * width + x);
        }
    }
}

/// Fills the three maps and returns the sums of `|x - y|` and of SSIM over the rows.
#[simd]
fn map_rows<S: Simd>(s: S, p: &Plane<'_>, top: usize, maps: [&mut [f32]; 3], buffers: &mut Buffers) -> [f64; 2] {
    let k = |v: f64| all(s, v as f32);
    let (two, c1, c2) = (k(2.0), k(SSIM_C1), k(SSIM_C2));
    let lane = f32x16::from_fn(s, |i| i as f32);
    let zero = k(0.0);
    let mut blur = Blur::<S, 3>::new(s, p.width, p.height, buffers);
    let [of_mean, of_square, of_product] = maps;
    let rows = of_mean.len() / p.width;
    blur.columns(
        s,
        top,
        rows,
        #[inline(always)]
        |i| {
            let (x, y) = (load(s, p.x, i, 0.0), load(s, p.y, i, 0.0));
            [x, x * x, x * y]
        },
    );
    let mut total = [0.0f64; 2];
    for row in 0..rows {
        let (mut l1, mut ssim) = (zero, zero);
        for x in (0..p.width).step_by(LANES) {
            let from = (top + row) * p.width + x;
            let [a, b, c] = blur.at(s, row, x);
            let (m, v) = (load(s, p.mean, from, 0.0), load(s, p.variance, from, 0.0));
            let am = a * m;
            let n1 = two.mul_add(am, c1);
            let n2 = two.mul_add(c - am, c2);
            let i1 = k(1.0) / (a * a + m * m + c1);
            let i2 = k(1.0) / (b - a * a + v + c2);
            let value = n1 * n2 * i1 * i2;
            let d_square = -(value * i2);
            let d_product = two * n1 * i1 * i2;
            let d_mean = two * (m * n2 * i1 * i2 - a * value * i1 - a * d_square) - m * d_product;
            let at = row * p.width + x;
            store(d_mean, of_mean, at);
            store(d_square, of_square, at);
            store(d_product, of_product, at);
            let inside = lane.simd_lt(all(s, (p.width - x) as f32));
            let difference = (load(s, p.x, from, 0.0) - load(s, p.y, from, 0.0)).abs();
            l1 += inside.select(difference, zero);
            ssim += inside.select(value, zero);
        }
        total[0] += f64::from(l1.reduce_sum());
        total[1] += f64::from(ssim.reduce_sum());
    }
    total
}

#[simd]
fn gradient_rows<S: Simd>(
    s: S,
    p: &Plane<'_>,
    maps: &[Vec<f32>; 3],
    top: usize,
    factors: [f32; 2],
    out: &mut [f32],
    buffers: &mut Buffers,
) {
    let zero = all(s, 0.0);
    let (of_l1, of_ssim) = (all(s, factors[0]), all(s, factors[1]));
    let mut blur = Blur::<S, 3>::new(s, p.width, p.height, buffers);
    let [of_mean, of_square, of_product] = maps;
    let rows = out.len() / p.width;
    blur.columns(
        s,
        top,
        rows,
        #[inline(always)]
        |i| {
            [
                load(s, of_mean, i, 0.0),
                load(s, of_square, i, 0.0),
                load(s, of_product, i, 0.0),
            ]
        },
    );
    for row in 0..rows {
        for column in (0..p.width).step_by(LANES) {
            let from = (top + row) * p.width + column;
            let (x, y) = (load(s, p.x, from, 0.0), load(s, p.y, from, 0.0));
            let [a, b, c] = blur.at(s, row, column);
            let d = x - y;
            let sign = d.simd_gt(zero).select(of_l1, d.simd_lt(zero).select(-of_l1, zero));
            let ssim = a + (x + x) * b + y * c;
            store(ssim.mul_add(of_ssim, sign), out, row * p.width + column);
        }
    }
}
