//! The SIMD twin: both passes of the window, and all that lies between, row by row.
//!
//! A row of a blurred picture is the weighted sum of eleven rows (columns stay apart: sixteen lanes),
//! and that of eleven shifted copies of the result. So nothing but three maps goes through memory
//! between the loss and its gradient; those of the target alone are kept from frame to frame.

use super::{SSIM_C1, SSIM_C2, WINDOW, window};
use crate::{
    SimdLevel,
    simd::{LANES, all, load, store},
};
use fearless_simd::{Simd, dispatch, f32x16, prelude::*};
use fearless_simd_macros::simd;
use m4_scene::ShapeError;
use rayon::prelude::*;

/// Rows a task.
const CHUNK_ROWS: usize = 24;
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
        .map(|(channel, top, maps)| {
            let plane = Plane::new(target, rgb, channel);
            dispatch!(level.level(), s => map_rows(s, &plane, top, maps))
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
    tasks.into_par_iter().for_each(|(channel, top, rows)| {
        let plane = Plane::new(target, rgb, channel);
        dispatch!(level.level(), s => gradient_rows(s, &plane, &maps[channel], top, factors, rows));
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
        let sum = (0..3).fold(all(s, 0.0), |sum, c| {
            sum + (load(s, &rgb[c], first + at, 0.0) - load(s, &target.rgb[c], first + at, 0.0)).abs()
        });
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

/// Blurs `N` pictures at once: `fetch(i)` gives sixteen values of each from pixel `i` on.
struct Blur<S: Simd, const N: usize> {
    taps: [f32x16<S>; WINDOW],
    width: usize,
    height: usize,
    rows: [Vec<f32>; N],
}

impl<S: Simd, const N: usize> Blur<S, N> {
    #[inline(always)]
    fn new(s: S, width: usize, height: usize) -> Self {
        let len = width.next_multiple_of(LANES) + 2 * PAD;
        Self {
            taps: window().map(|tap| all(s, tap as f32)),
            width,
            height,
            rows: std::array::from_fn(|_| vec![0.0; len]),
        }
    }

    /// Along the columns: fills the row buffers with row `y`.
    #[inline(always)]
    fn row(&mut self, s: S, y: usize, fetch: impl Fn(usize) -> [f32x16<S>; N]) {
        let first = y.saturating_sub(REACH);
        let last = (y + REACH).min(self.height - 1);
        for x in (0..self.width).step_by(LANES) {
            let mut sum = [all(s, 0.0); N];
            for from in first..=last {
                let tap = self.taps[from + REACH - y];
                let values = fetch(from * self.width + x);
                for n in 0..N {
                    sum[n] = values[n].mul_add(tap, sum[n]);
                }
            }
            for n in 0..N {
                sum[n].store_slice(&mut self.rows[n][PAD + x..PAD + x + LANES]);
            }
        }
        // past the end of the row the lanes above saw the next one
        for row in &mut self.rows {
            row[PAD + self.width..].fill(0.0);
        }
    }

    /// Along the row: sixteen columns from `x` on.
    #[inline(always)]
    fn at(&self, s: S, x: usize) -> [f32x16<S>; N] {
        std::array::from_fn(|n| {
            let row = &self.rows[n][PAD + x - REACH..PAD + x + REACH + LANES];
            let get = |k: usize| f32x16::from_slice(s, &row[k..k + LANES]);
            let mut sum = get(REACH) * self.taps[REACH];
            for k in 0..REACH {
                // the window is symmetric
                sum = (get(k) + get(WINDOW - 1 - k)).mul_add(self.taps[k], sum);
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
    let mut blur = Blur::<S, 2>::new(s, width, height);
    for row in 0..mean.len() / width {
        blur.row(s, top + row, |i| {
            let v = load(s, y, i, 0.0);
            [v, v * v]
        });
        for x in (0..width).step_by(LANES) {
            let [m, square] = blur.at(s, x);
            store(m, mean, row * width + x);
            store(square - m * m, variance, row * width + x);
        }
    }
}

/// Fills the three maps and returns the sums of `|x - y|` and of SSIM over the rows.
#[simd]
fn map_rows<S: Simd>(s: S, p: &Plane<'_>, top: usize, maps: [&mut [f32]; 3]) -> [f64; 2] {
    let k = |v: f64| all(s, v as f32);
    let (two, c1, c2) = (k(2.0), k(SSIM_C1), k(SSIM_C2));
    let lane = f32x16::from_fn(s, |i| i as f32);
    let zero = k(0.0);
    let mut blur = Blur::<S, 3>::new(s, p.width, p.height);
    let [of_mean, of_square, of_product] = maps;
    let mut total = [0.0f64; 2];
    for row in 0..of_mean.len() / p.width {
        blur.row(s, top + row, |i| {
            let (x, y) = (load(s, p.x, i, 0.0), load(s, p.y, i, 0.0));
            [x, x * x, x * y]
        });
        let (mut l1, mut ssim) = (zero, zero);
        for x in (0..p.width).step_by(LANES) {
            let from = (top + row) * p.width + x;
            let [a, b, c] = blur.at(s, x);
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
fn gradient_rows<S: Simd>(s: S, p: &Plane<'_>, maps: &[Vec<f32>; 3], top: usize, factors: [f32; 2], out: &mut [f32]) {
    let zero = all(s, 0.0);
    let (of_l1, of_ssim) = (all(s, factors[0]), all(s, factors[1]));
    let mut blur = Blur::<S, 3>::new(s, p.width, p.height);
    let [of_mean, of_square, of_product] = maps;
    for row in 0..out.len() / p.width {
        blur.row(s, top + row, |i| {
            [
                load(s, of_mean, i, 0.0),
                load(s, of_square, i, 0.0),
                load(s, of_product, i, 0.0),
            ]
        });
        for column in (0..p.width).step_by(LANES) {
            let from = (top + row) * p.width + column;
            let (x, y) = (load(s, p.x, from, 0.0), load(s, p.y, from, 0.0));
            let [a, b, c] = blur.at(s, column);
            let d = x - y;
            let sign = d.simd_gt(zero).select(of_l1, d.simd_lt(zero).select(-of_l1, zero));
            let ssim = a + (x + x) * b + y * c;
            store(ssim.mul_add(of_ssim, sign), out, row * p.width + column);
        }
    }
}
