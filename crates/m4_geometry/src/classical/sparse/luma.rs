//! Grey images at working size, and pyramids of them.

use m4_core::{Plane, RgbImage};

/// Weights of red, green and blue in luma (ITU-R BT.601).
const BT601: [f32; 3] = [0.299, 0.587, 0.114];

/// Frames are shrunk so that their longest side is at most this, pixels. 640:
/// docs/spec/front-end.md 7.1.
pub(super) const LONGEST_SIDE_PX: usize = 640;

/// How working pixels relate to those of the input.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct WorkingSize {
    pub width: usize,
    pub height: usize,
    /// Columns and rows of the input.
    input: [f64; 2],
    /// Working pixels in one input pixel.
    pub scale: f64,
}

impl WorkingSize {
    /// The input size, shrunk so that the longest side is at most `longest_px`; never enlarged.
    pub fn new(width: usize, height: usize, longest_px: usize) -> Self {
        let scale = (longest_px as f64 / width.max(height).max(1) as f64).min(1.0);
        let side = |n: usize| ((n as f64 * scale).round() as usize).max(1);
        Self {
            width: side(width),
            height: side(height),
            input: [width as f64, height as f64],
            scale,
        }
    }

    /// From working pixels, measured from the image centre, to input pixels (centre of the first
    /// pixel: 0, 0).
    pub fn to_input(self, p: [f64; 2]) -> [f32; 2] {
        [0, 1].map(|k| (p[k] / self.scale + 0.5 * self.input[k] - 0.5) as f32)
    }

    pub fn to_corner(self, p: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| p[k] / self.scale + 0.5 * self.input[k])
    }

    /// The same as shares of the width and of the height, 0 to 1 within the image.
    pub fn share(self, p: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| self.to_corner(p)[k] / self.input[k])
    }

    /// The inverse of [`Self::centred`].
    pub fn pixel(self, p: [f64; 2]) -> [f32; 2] {
        let side = [self.width as f64, self.height as f64];
        [0, 1].map(|k| ((p[k] / (self.input[k] * self.scale) + 0.5) * side[k] - 0.5) as f32)
    }

    /// From pixels of the shrunk image (centre of the first pixel: 0, 0) to working pixels from the
    /// image centre. Rounding of the sides to whole pixels is undone: pixels come out square.
    pub fn centred(self, p: [f32; 2]) -> [f64; 2] {
        let side = [self.width as f64, self.height as f64];
        [0, 1].map(|k| ((f64::from(p[k]) + 0.5) / side[k] - 0.5) * self.input[k] * self.scale)
    }
}

/// Luma in 0..=255 at working size; every working pixel is the mean of the input area it covers.
pub(crate) fn luma(rgb: &RgbImage, size: WorkingSize) -> Plane<f32> {
    let full = rgb.map(|p| {
        BT601
            .iter()
            .zip(p)
            .fold(0.0, |sum, (weight, &value)| sum + weight * f32::from(value))
    });
    if (size.width, size.height) == rgb.size() {
        return full;
    }
    shrink_rows(
        &transpose(&shrink_rows(&transpose(&full), size.height)),
        size.width,
    )
}

fn transpose(plane: &Plane<f32>) -> Plane<f32> {
    Plane::from_fn(plane.height(), plane.width(), |x, y| plane[(y, x)])
}

/// Area resampling of every row to `width` columns.
fn shrink_rows(plane: &Plane<f32>, width: usize) -> Plane<f32> {
    let step = plane.width() as f64 / width as f64;
    Plane::from_fn(width, plane.height(), |x, y| {
        let row = plane.row(y);
        let (from, to) = (x as f64 * step, (x + 1) as f64 * step);
        let last = (to.ceil() as usize).min(row.len());
        let mut sum = 0.0;
        for (i, &value) in row.iter().enumerate().take(last).skip(from as usize) {
            let covered = (to.min((i + 1) as f64) - from.max(i as f64)).max(0.0);
            sum += covered * f64::from(value);
        }
        (sum / step) as f32
    })
}

/// Levels of a pyramid. 4: docs/spec/front-end.md 7.1.
const LEVELS: usize = 4;

/// Levels of halving size; level 0 is the image itself. Coordinate `x` of level 0 is `x / 2^l` in
/// level `l` (pixel centres at integers).
#[derive(Debug, Clone)]
pub(crate) struct Pyramid {
    /// At least one, finest first.
    pub levels: Vec<Plane<f32>>,
    /// Level 0 at [`doubled`] resolution, for patches that are aligned to a hundredth of a pixel.
    pub fine: Plane<f32>,
}

impl Pyramid {
    /// As [`halvings`].
    pub fn new(base: Plane<f32>) -> Self {
        let fine = doubled(&base);
        let levels = halvings(base);
        Self { levels, fine }
    }
}

/// Levels of halving size, finest first: at most [`LEVELS`]; stops before a side falls under 16
/// pixels.
pub(crate) fn halvings(base: Plane<f32>) -> Vec<Plane<f32>> {
    let mut all = vec![base];
    while all.len() < LEVELS {
        let top = &all[all.len() - 1];
        if top.width().min(top.height()) < 32 {
            break;
        }
        all.push(halved(top));
    }
    all
}

/// Twice the resolution by cubic convolution (Keys 1981): pixel `x` becomes pixel `2 x`, so sizes
/// are `2 n - 1`; the border repeats.
///
/// Bilinear values between the pixels of the result are those of a smooth image; between those of
/// `plane` they are blurred by an amount that depends on the fraction of the pixel, which pulls
/// aligned patches towards whole pixels (docs/decisions/0011).
pub(crate) fn doubled(plane: &Plane<f32>) -> Plane<f32> {
    let halfway = |a: f32, b: f32, c: f32, d: f32| 0.5625 * (b + c) - 0.0625 * (a + d);
    let (w, h) = plane.size();
    let around = |i: usize, n: usize| [i.saturating_sub(1), i, i + 1, (i + 2).min(n - 1)];
    let mut rows = Plane::filled(2 * w - 1, h, 0.0);
    for y in 0..h {
        let (from, to) = (plane.row(y), rows.row_mut(y));
        for x in 0..w - 1 {
            let [a, b, c, d] = around(x, w).map(|i| from[i]);
            (to[2 * x], to[2 * x + 1]) = (b, halfway(a, b, c, d));
        }
        to[2 * w - 2] = from[w - 1];
    }
    let mut out = Plane::filled(2 * w - 1, 2 * h - 1, 0.0);
    for y in 0..h {
        out.row_mut(2 * y).copy_from_slice(rows.row(y));
    }
    for y in 0..h - 1 {
        let [a, b, c, d] = around(y, h).map(|i| rows.row(i));
        let above = b.iter().zip(c);
        for ((to, (&b, &c)), (&a, &d)) in out
            .row_mut(2 * y + 1)
            .iter_mut()
            .zip(above)
            .zip(a.iter().zip(d))
        {
            *to = halfway(a, b, c, d);
        }
    }
    out
}

/// Binomial blur (1 4 6 4 1)/16 in both directions, then every second pixel.
fn halved(plane: &Plane<f32>) -> Plane<f32> {
    const TAPS: [f32; 5] = [0.0625, 0.25, 0.375, 0.25, 0.0625];
    let (w, h) = plane.size();
    let (half_w, half_h) = (w.div_ceil(2), h.div_ceil(2));
    let at = |i: usize, k: usize, n: usize| (i + k).saturating_sub(2).min(n - 1);
    let rows = Plane::from_fn(half_w, h, |x, y| {
        let row = plane.row(y);
        (0..5).fold(0.0, |sum, k| sum + TAPS[k] * row[at(2 * x, k, w)])
    });
    Plane::from_fn(half_w, half_h, |x, y| {
        (0..5).fold(0.0, |sum, k| sum + TAPS[k] * rows[(x, at(2 * y, k, h))])
    })
}

/// The `side` x `side` samples whose first is at `(x, y)`, bilinear, one pixel apart; outside the
/// image the nearest pixel counts.
pub(crate) fn sample_square(plane: &Plane<f32>, x: f32, y: f32, side: usize, out: &mut [f32]) {
    let (w, h) = plane.size();
    let (fx, fy) = (x.floor(), y.floor());
    let (ax, ay) = (x - fx, y - fy);
    let weights = [
        (1.0 - ax) * (1.0 - ay),
        ax * (1.0 - ay),
        (1.0 - ax) * ay,
        ax * ay,
    ];
    let (ix, iy) = (fx as isize, fy as isize);
    let inside = ix >= 0 && iy >= 0 && ix as usize + side < w && iy as usize + side < h;
    let clamp = |i: isize, n: usize| i.clamp(0, n as isize - 1) as usize;
    for r in 0..side {
        let line = &mut out[r * side..(r + 1) * side];
        let upper = plane.row(clamp(iy + r as isize, h));
        let lower = plane.row(clamp(iy + r as isize + 1, h));
        if inside {
            let first = ix as usize;
            let (upper, lower) = (
                &upper[first..first + side + 1],
                &lower[first..first + side + 1],
            );
            for c in 0..side {
                line[c] = weights[0] * upper[c]
                    + weights[1] * upper[c + 1]
                    + weights[2] * lower[c]
                    + weights[3] * lower[c + 1];
            }
        } else {
            for c in 0..side {
                let (a, b) = (clamp(ix + c as isize, w), clamp(ix + c as isize + 1, w));
                line[c] = weights[0] * upper[a]
                    + weights[1] * upper[b]
                    + weights[2] * lower[a]
                    + weights[3] * lower[b];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Pyramid, WorkingSize, doubled, luma, sample_square};
    use m4_core::Plane;

    #[test]
    fn shrinking_keeps_the_mean_and_linear_ramps() {
        let rgb = Plane::from_fn(100, 60, |x, y| {
            [(2 * x) as u8, (2 * x) as u8, (x + y) as u8]
        });
        let size = WorkingSize::new(100, 60, 40);
        assert_eq!((size.width, size.height), (40, 24));
        let small = luma(&rgb, size);
        let full = luma(&rgb, WorkingSize::new(100, 60, 100));
        let mean = |p: &Plane<f32>| p.data().iter().sum::<f32>() / p.data().len() as f32;
        assert!((mean(&small) - mean(&full)).abs() < 0.01);
        // Corner-based coordinates: working column 10 covers input columns 25 to 27.5, centre 25.75
        // from 0.
        let want = 0.886 * 2.0 * 25.75 + 0.114 * (25.75 + (12.5 * 2.5 - 0.5));
        assert!(
            (small[(10, 12)] - want).abs() < 0.1,
            "{} {want}",
            small[(10, 12)]
        );
    }

    #[test]
    fn doubling_keeps_pixels_and_finds_those_between_them() {
        let wave = |x: f32, y: f32| (0.6 * x).sin() + (0.5 * y + 0.2 * x).cos();
        let fine = doubled(&Plane::from_fn(30, 20, |x, y| wave(x as f32, y as f32)));
        assert_eq!(fine.size(), (59, 39));
        for y in 3..36 {
            for x in 3..56 {
                let want = wave(0.5 * x as f32, 0.5 * y as f32);
                let near = if x % 2 == 0 && y % 2 == 0 { 1e-6 } else { 0.01 };
                assert!(
                    (fine[(x, y)] - want).abs() < near,
                    "{x}, {y}: {} {want}",
                    fine[(x, y)]
                );
            }
        }
        assert_eq!(doubled(&Plane::filled(2, 1, 5.0)), Plane::filled(3, 1, 5.0));
    }

    #[test]
    fn a_pyramid_level_has_half_the_coordinates() {
        let base = Plane::from_fn(128, 96, |x, y| x as f32 + 2.0 * y as f32);
        let pyramid = Pyramid::new(base);
        assert_eq!(pyramid.levels[2].size(), (32, 24));
        assert!((pyramid.levels[2][(10, 7)] - (40.0 + 56.0)).abs() < 1e-3);
    }

    #[test]
    fn samples_interpolate_and_repeat_the_border() {
        let plane = Plane::from_fn(8, 8, |x, y| (x + 10 * y) as f32);
        let mut out = [0.0; 4];
        sample_square(&plane, 2.25, 3.5, 2, &mut out);
        assert_eq!(out, [37.25, 38.25, 47.25, 48.25]);
        sample_square(&plane, -5.0, 3.0, 2, &mut out);
        assert_eq!(out, [30.0, 30.0, 40.0, 40.0]);
    }

    #[test]
    fn positions_round_trip_through_the_working_size() {
        let size = WorkingSize::new(1280, 720, 640);
        let p = size.to_input(size.centred([100.0, 50.0]));
        assert!((p[0] - 200.5).abs() < 1e-4 && (p[1] - 100.5).abs() < 1e-4);
    }
}
