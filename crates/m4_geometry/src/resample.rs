//! Images and planes at other sizes. Coordinates are measured from the corner.

use m4_core::{Plane, RgbImage};
use rayon::prelude::*;

/// The size whose longest side is `side`, or the size itself if it is smaller.
pub(crate) fn working_size(width: usize, height: usize, side: usize) -> (usize, usize) {
    let longest = width.max(height);
    if longest <= side {
        return (width, height);
    }
    let scaled = |n: usize| ((n * side + longest / 2) / longest).max(1);
    (scaled(width), scaled(height))
}

/// The part of `image` from the upper left corner.
pub(crate) fn crop<T: Copy>(image: &Plane<T>, (width, height): (usize, usize)) -> Plane<T> {
    Plane::from_fn(width, height, |x, y| image.row(y)[x])
}

/// What share of source sample `i` lies in target cell `cell` of `n` source samples shared by `m`
/// cells.
fn overlap(cell: usize, n: usize, m: usize) -> Vec<(usize, f32)> {
    let (start, end) = (
        cell as f64 * n as f64 / m as f64,
        (cell + 1) as f64 * n as f64 / m as f64,
    );
    (start as usize..(end.ceil() as usize).min(n))
        .map(|i| {
            let share = (end.min((i + 1) as f64) - start.max(i as f64)).max(0.0);
            (i, (share / (end - start)) as f32)
        })
        .collect()
}

/// The image at another size by areas, and its luma 0..255, not rounded.
pub(crate) fn rgb_and_grey(
    image: &RgbImage,
    width: usize,
    height: usize,
) -> (Vec<[u8; 3]>, Vec<f32>) {
    let exact = means(image, width, height);
    let luma = |c: &[f32; 3]| 0.299 * c[0] + 0.587 * c[1] + 0.114 * c[2];
    let grey = exact.iter().map(luma).collect();
    (
        exact.iter().map(|c| c.map(|v| v.round() as u8)).collect(),
        grey,
    )
}

/// The image at `width` x `height` pixels (at least 1 each): each the mean of the area that it
/// covers, rounded. OpenCV's INTER_AREA within a count.
#[must_use]
pub fn resize_area(image: &RgbImage, width: usize, height: usize) -> RgbImage {
    if image.size() == (width, height) {
        return image.clone();
    }
    let exact = means(image, width, height);
    Plane::from_fn(width, height, |x, y| {
        exact[y * width + x].map(|v| v.round() as u8)
    })
}

/// The mean of the area that each pixel of another size covers.
fn means(image: &RgbImage, width: usize, height: usize) -> Vec<[f32; 3]> {
    let columns: Vec<_> = (0..width)
        .map(|x| overlap(x, image.width(), width))
        .collect();
    let mut out = vec![[0.0f32; 3]; width * height];
    out.par_chunks_mut(width.max(1))
        .enumerate()
        .for_each(|(y, target)| {
            for (sy, wy) in overlap(y, image.height(), height) {
                let row = image.row(sy);
                for (t, column) in target.iter_mut().zip(&columns) {
                    for &(sx, wx) in column {
                        for (t, &v) in t.iter_mut().zip(&row[sx]) {
                            *t += wy * wx * f32::from(v);
                        }
                    }
                }
            }
        });
    out
}

/// The plane at `width` x `height` pixels, each the value of the source pixel in which its middle
/// lies ("nearest-exact").
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

/// The plane at `width` x `height` pixels, bilinear between the middles of pixels, constant beyond
/// the outer ones.
#[must_use]
pub fn resize_bilinear(plane: &Plane<f32>, width: usize, height: usize) -> Plane<f32> {
    let (sx, sy) = (
        plane.width() as f32 / width as f32,
        plane.height() as f32 / height as f32,
    );
    Plane::from_fn(width, height, |x, y| {
        bilinear(
            plane,
            (x as f32 + 0.5) * sx - 0.5,
            (y as f32 + 0.5) * sy - 0.5,
        )
    })
}

/// The value at column `x` and row `y`, whole numbers being the middles of pixels; constant beyond
/// the outer ones.
pub(crate) fn bilinear(plane: &Plane<f32>, x: f32, y: f32) -> f32 {
    let x = x.clamp(0.0, (plane.width() - 1) as f32);
    let y = y.clamp(0.0, (plane.height() - 1) as f32);
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = (
        (x0 + 1).min(plane.width() - 1),
        (y0 + 1).min(plane.height() - 1),
    );
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    let mix = |row: &[f32]| row[x0] * (1.0 - fx) + row[x1] * fx;
    mix(plane.row(y0)) * (1.0 - fy) + mix(plane.row(y1)) * fy
}
