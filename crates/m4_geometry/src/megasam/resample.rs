//! Images and planes at other sizes. Coordinates are measured from the corner.

use super::size::CELL_PX;
use m4_core::{Plane, RgbImage};
use rayon::prelude::*;

/// The part of `image` from the upper left corner.
pub(super) fn crop<T: Copy>(image: &Plane<T>, (width, height): (usize, usize)) -> Plane<T> {
    Plane::from_fn(width, height, |x, y| image.row(y)[x])
}

/// What each target pixel takes of which source pixels: the share of the interval that it covers.
fn shares(from: usize, to: usize) -> Vec<(usize, Vec<f32>)> {
    let scale = from as f64 / to as f64;
    let one = |i: usize| {
        let (begin, end) = (i as f64 * scale, ((i + 1) as f64 * scale).min(from as f64));
        let first = (begin.floor() as usize).min(from - 1);
        let last = (end.ceil() as usize).clamp(first + 1, from);
        let part = |k: usize| ((k + 1) as f64).min(end) - (k as f64).max(begin);
        let parts = (first..last).map(|k| (part(k) / (end - begin)) as f32);
        (first, parts.collect())
    };
    (0..to).map(one).collect()
}

/// The image at `width` x `height` pixels (at least 1 each): each the mean of the area that it covers, rounded, halves up.
/// OpenCV's INTER_AREA within a count.
#[must_use]
pub fn resize_area(image: &RgbImage, width: usize, height: usize) -> RgbImage {
    if image.size() == (width, height) {
        return image.clone();
    }
    let columns = shares(image.width(), width);
    let rows = shares(image.height(), height);
    let line = |(first, parts): &(usize, Vec<f32>)| {
        let mut sums = vec![[0.0_f32; 3]; image.width()];
        for (k, part) in parts.iter().enumerate() {
            for (sum, pixel) in sums.iter_mut().zip(image.row(first + k)) {
                for c in 0..3 {
                    sum[c] += part * f32::from(pixel[c]);
                }
            }
        }
        let pixel = |(first, parts): &(usize, Vec<f32>)| {
            let mut mean = [0.0_f32; 3];
            for (k, part) in parts.iter().enumerate() {
                for c in 0..3 {
                    mean[c] += part * sums[first + k][c];
                }
            }
            mean.map(|v| (v + 0.5) as u8)
        };
        columns.iter().map(pixel).collect::<Vec<[u8; 3]>>()
    };
    let lines: Vec<Vec<[u8; 3]>> = rows.par_iter().map(line).collect();
    Plane::from_fn(width, height, |x, y| lines[y][x])
}

/// The plane at `width` x `height` pixels, each the value of the source pixel in which its middle lies ("nearest-exact").
#[must_use]
pub fn resize_nearest<T: Copy>(plane: &Plane<T>, width: usize, height: usize) -> Plane<T> {
    let at = |i: usize, to: usize, from: usize| {
        let middle = (i as f64 + 0.5) * from as f64 / to as f64;
        (middle as usize).min(from - 1)
    };
    Plane::from_fn(width, height, |x, y| {
        plane.row(at(y, height, plane.height()))[at(x, width, plane.width())]
    })
}

/// The plane at `width` x `height` pixels, bilinear between the middles of pixels, constant beyond the outer ones.
#[must_use]
pub fn resize_bilinear(plane: &Plane<f32>, width: usize, height: usize) -> Plane<f32> {
    let (sx, sy) = (
        plane.width() as f32 / width as f32,
        plane.height() as f32 / height as f32,
    );
    Plane::from_fn(width, height, |x, y| {
        bilinear(plane, (x as f32 + 0.5) * sx - 0.5, (y as f32 + 0.5) * sy - 0.5)
    })
}

/// A plane on the tracker's grid, whose cell `i` is pixel `8 i` of the images that are tracked, at `width` x `height` pixels
/// that cover `covered` pixels of those from the upper left corner; constant beyond the outer cells.
pub(super) fn from_grid(grid: &Plane<f32>, width: usize, height: usize, covered: (usize, usize)) -> Plane<f32> {
    let (sx, sy) = (covered.0 as f32 / width as f32, covered.1 as f32 / height as f32);
    // The middle of pixel i is (i + 0.5) scale from the corner.
    let cell = |i: usize, scale: f32| ((i as f32 + 0.5) * scale - 0.5) / CELL_PX as f32;
    Plane::from_fn(width, height, |x, y| bilinear(grid, cell(x, sx), cell(y, sy)))
}

/// The value at column `x` and row `y`, whole numbers being the middles of pixels; constant beyond the outer ones.
fn bilinear(plane: &Plane<f32>, x: f32, y: f32) -> f32 {
    let x = x.clamp(0.0, (plane.width() - 1) as f32);
    let y = y.clamp(0.0, (plane.height() - 1) as f32);
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(plane.width() - 1), (y0 + 1).min(plane.height() - 1));
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    let mix = |row: &[f32]| row[x0] * (1.0 - fx) + row[x1] * fx;
    mix(plane.row(y0)) * (1.0 - fy) + mix(plane.row(y1)) * fy
}

#[cfg(test)]
mod tests {
    use super::{from_grid, resize_area, resize_nearest};
    use m4_core::Plane;

    #[test]
    fn areas_keep_the_mean_and_the_place() {
        let ramp = Plane::from_fn(53, 37, |x, y| [(4 * x) as u8, (6 * y) as u8, 200]);
        let small = resize_area(&ramp, 29, 20);
        for y in 0..20 {
            for x in 0..29 {
                let middle = |i: usize, to: f64, from: f64| (i as f64 + 0.5) * from / to - 0.5;
                let [r, g, b] = small.row(y)[x].map(f64::from);
                assert!((r - 4.0 * middle(x, 29.0, 53.0)).abs() <= 1.2, "{x} {r}");
                assert!((g - 6.0 * middle(y, 20.0, 37.0)).abs() <= 1.5, "{y} {g}");
                assert_eq!(b, 200.0);
            }
        }
        assert_eq!(resize_area(&ramp, 53, 37), ramp);
    }

    #[test]
    fn nearest_takes_the_pixel_in_the_middle() {
        let plane = Plane::from_fn(8, 1, |x, _| x);
        assert_eq!(resize_nearest(&plane, 4, 1).data(), [1, 3, 5, 7]);
        assert_eq!(resize_nearest(&plane, 3, 1).data(), [1, 4, 6]);
    }

    #[test]
    fn a_grid_lies_on_every_eighth_pixel() {
        let grid = Plane::from_fn(5, 4, |x, y| (10 * x + 3 * y) as f32);
        let full = from_grid(&grid, 40, 32, (40, 32));
        assert_eq!((full.row(0)[0], full.row(16)[24]), (0.0, 36.0));
        assert!((full.row(0)[4] - 5.0).abs() < 1e-5);
        // Half the size: pixel 4 of it covers pixels 8 and 9, pixel 0 of it pixels 0 and 1.
        let half = from_grid(&grid, 20, 16, (40, 32));
        let want = (10.0 * 8.5 + 3.0 * 0.5) / 8.0;
        assert!((half.row(0)[4] - want).abs() < 1e-4, "{}", half.row(0)[4]);
    }
}
