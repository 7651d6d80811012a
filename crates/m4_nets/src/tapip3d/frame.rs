//! A frame as the network works with it: maps of features and of points, from fine to coarse.

use super::Net;
use super::encoder::STRIDE;
use super::window::Moments;
use crate::ops::{Kernels, resampled, tensor};
use burn_core::tensor::module::avg_pool2d;
use burn_core::tensor::ops::AvgPoolOptions;
use burn_core::tensor::{DType, Device, Int, Tensor, TensorData};
use m4_core::nalgebra::Vector3;
use m4_core::{Camera, RgbImage, Se3};
use rayon::prelude::*;

/// Columns and rows of the maps of a frame of `size`: a quarter, and each the half of the one
/// before.
pub fn map_sizes(size: (usize, usize), levels: usize) -> Vec<(usize, usize)> {
    let first = (size.0 / STRIDE, size.1 / STRIDE);
    std::iter::successors(Some(first), |&(w, h)| Some((w / 2, h / 2)))
        .take(levels)
        .collect()
}

/// Where the pixels of a frame are.
#[derive(Debug)]
pub struct Geometry {
    pub lens: PosedPinhole,
    /// A map per level, `[h][w]`. A pixel without depth is at the camera's centre, as upstream has
    /// it.
    pub points: Vec<Vec<[f32; 3]>>,
    /// Of all pixels whose depth counts.
    pub moments: Moments,
}

impl Geometry {
    /// Of depth `z` `[h][w]` in `size` seen through `lens`; depths within `range` count.
    pub fn new(
        lens: PosedPinhole,
        z: &[f32],
        size: (usize, usize),
        range: [f32; 2],
        levels: usize,
    ) -> Self {
        let (w, h) = size;
        let centre = lens.unproject([0.0; 2], 0.0);
        let about = [centre.x, centre.y, centre.z];
        let rows: Vec<Moments> = (0..h)
            .into_par_iter()
            .map(|y| {
                let (mut n, mut sums, mut squares) = (0, [0.0; 3], [0.0; 3]);
                for (x, &z) in z[y * w..(y + 1) * w].iter().enumerate() {
                    if z >= range[0] && z <= range[1] {
                        let p = lens.unproject([x as f64, y as f64], f64::from(z)) - centre;
                        n += 1;
                        for axis in 0..3 {
                            sums[axis] += p[axis];
                            squares[axis] += p[axis] * p[axis];
                        }
                    }
                }
                Moments::of_sums(n, about, sums, squares)
            })
            .collect();
        let map = |(to_w, to_h): (usize, usize)| -> Vec<[f32; 3]> {
            let (columns, rows) = (nearest_exact(w, to_w), nearest_exact(h, to_h));
            let all = rows
                .iter()
                .flat_map(|&y| columns.iter().map(move |&x| (x, y)));
            all.map(|(x, y)| {
                let p = lens.unproject([x as f64, y as f64], f64::from(z[y * w + x]));
                [p.x as f32, p.y as f32, p.z as f32]
            })
            .collect()
        };
        Self {
            lens,
            points: map_sizes(size, levels).into_iter().map(map).collect(),
            moments: rows.iter().fold(Moments::default(), Moments::with),
        }
    }
}

/// The pixels of a row of `from` that one of `to` takes: those at the centres of the new ones.
fn nearest_exact(from: usize, to: usize) -> Vec<usize> {
    let scale = from as f32 / to as f32;
    let at = |i: usize| ((i as f32 + 0.5) * scale) as usize;
    (0..to).map(|i| at(i).min(from.saturating_sub(1))).collect()
}

/// `image` in `size` as the encoder takes it, `[1, 3, h, w]`.
pub fn image_tensor(
    image: &RgbImage,
    size: (usize, usize),
    device: &Device,
    dtype: DType,
) -> Tensor<4> {
    let (w, h) = image.size();
    let plane = |c: usize| image.data().iter().map(move |p| f32::from(p[c]));
    let mut planes: Vec<f32> = (0..3).flat_map(plane).collect();
    if (w, h) != size {
        let (columns, rows) = (Kernels::linear(w, size.0), Kernels::linear(h, size.1));
        planes = resampled(&planes, w, h, &columns, &rows);
        // upstream keeps whole numbers
        planes.iter_mut().for_each(|x| *x = x.round());
    }
    planes
        .iter_mut()
        .for_each(|x| *x = (*x / 255.0 - 0.5) / 0.5);
    tensor(planes, [1, 3, size.1, size.0], device).cast(dtype)
}

/// Features of an image `[1, 3, h, w]`: a map per level, `[pixels, channels]`.
pub fn maps(net: &Net, image: Tensor<4>, levels: usize) -> Vec<Tensor<2>> {
    let mut map = net.encoder.forward(image);
    let flat = |x: &Tensor<4>| {
        let [_, c, h, w] = x.dims();
        x.clone().reshape([c, h * w]).transpose()
    };
    let mut out = vec![flat(&map)];
    for _ in 1..levels {
        map = avg_pool2d(map, AvgPoolOptions::new([2, 2]).with_stride([2, 2]));
        out.push(flat(&map));
    }
    out
}

#[derive(Debug)]
pub struct Frame {
    /// Features as tokens have them, a map per level, `[pixels, width]`.
    pub features: Vec<Tensor<2>>,
    pub points: Vec<Vec<[f32; 3]>>,
    pub moments: Moments,
}

/// What is known of points when they are asked for.
#[derive(Debug, Clone)]
pub struct Sides {
    /// A level each, `[queries, 1 + neighbours, width]`: of the point itself, and of those near it.
    pub features: Vec<Tensor<3>>,
    /// A level each, where these are in the world, `[queries][1 + neighbours]`.
    pub points: Vec<Vec<[f32; 3]>>,
}

/// Rows of `map` `[pixels, c]`.
pub fn rows_of(map: &Tensor<2>, rows: Vec<i32>) -> Tensor<2> {
    let n = rows.len();
    let rows = Tensor::<1, Int>::from_data(TensorData::new(rows, [n]), &map.device());
    map.clone().select(0, rows)
}

/// The map `[pixels, c]` of `size` at places `(x, y)` in pixels whose centres are whole numbers,
/// between four of them; beyond an edge what is at the edge.
pub fn sampled(map: &Tensor<2>, (w, h): (usize, usize), places: &[[f64; 2]]) -> Tensor<2> {
    let corner = |x: f64, n: usize| {
        let x = if x.is_finite() {
            x.clamp(0.0, (n - 1) as f64)
        } else {
            0.0
        };
        let first = (x as usize).min(n.saturating_sub(2));
        (first, (first + 1).min(n - 1), x - first as f64)
    };
    let corners: Vec<_> = places
        .iter()
        .map(|&[x, y]| (corner(x, w), corner(y, h)))
        .collect();
    let part = |right: bool, below: bool| {
        let row = corners.iter().map(|&((x0, x1, _), (y0, y1, _))| {
            let (x, y) = (if right { x1 } else { x0 }, if below { y1 } else { y0 });
            (y * w + x) as i32
        });
        let weight = corners.iter().map(|&((_, _, s), (_, _, t))| {
            let (s, t) = (
                if right { s } else { 1.0 - s },
                if below { t } else { 1.0 - t },
            );
            (s * t) as f32
        });
        let weight = tensor(weight.collect(), [corners.len(), 1], &map.device()).cast(map.dtype());
        rows_of(map, row.collect()) * weight
    };
    part(false, false) + part(true, false) + part(false, true) + part(true, true)
}

/// The camera as the network was trained with it: pixel centres are whole numbers, and an image of
/// another size has the same corner pixels. Intrinsics come with the principal point from the
/// image's corner; half a pixel is taken off, before they are scaled by
/// `(size - 1) / (old size - 1)` as upstream does. The world is moved so that a point near the
/// cameras is its origin: 32 bits then suffice wherever the scene lies.
#[derive(Debug, Clone, Copy)]
pub struct PosedPinhole {
    focal: [f64; 2],
    centre: [f64; 2],
    c2w: Se3<f64>,
}

impl PosedPinhole {
    /// `camera` over an image of `size`, in a world whose origin is at `origin`; `None` if its
    /// numbers are none.
    pub fn new(camera: &Camera, size: (usize, usize), origin: &Vector3<f64>) -> Option<Self> {
        let k = &camera.intrinsics;
        let scale = |to: usize, from: usize| {
            if from > 1 {
                (to - 1) as f64 / (from - 1) as f64
            } else {
                to as f64
            }
        };
        let (sx, sy) = (scale(size.0, k.width), scale(size.1, k.height));
        let lens = Self {
            focal: [k.fx * sx, k.fy * sy],
            centre: [(k.cx - 0.5) * sx, (k.cy - 0.5) * sy],
            c2w: Se3 {
                rotation: camera.c2w.rotation,
                translation: camera.c2w.translation - origin,
            },
        };
        let numbers = lens.c2w.rotation.iter().chain(lens.c2w.translation.iter());
        let finite = numbers
            .chain(&lens.focal)
            .chain(&lens.centre)
            .all(|x| x.is_finite());
        (finite && lens.focal.iter().all(|&f| f > 0.0)).then_some(lens)
    }

    /// The point at depth `z` behind a place in the image.
    pub fn unproject(&self, [u, v]: [f64; 2], z: f64) -> Vector3<f64> {
        let x = (u - self.centre[0]) / self.focal[0] * z;
        let y = (v - self.centre[1]) / self.focal[1] * z;
        self.c2w.transform(&Vector3::new(x, y, z))
    }

    /// The point at depth 1 behind a place in the image, in the camera's axes.
    pub fn ray(&self, [u, v]: [f64; 2]) -> [f64; 3] {
        [
            (u - self.centre[0]) / self.focal[0],
            (v - self.centre[1]) / self.focal[1],
            1.0,
        ]
    }

    /// Where a point is seen; somewhere far out if it is behind.
    pub fn project(&self, point: &Vector3<f64>) -> [f64; 2] {
        let p = self.c2w.rotation.transpose() * (point - self.c2w.translation);
        let z = p.z.max(1e-6);
        // upstream multiplies first, so that a point behind is not where its direction is
        [
            (self.focal[0] * p.x + self.centre[0] * p.z) / z,
            (self.focal[1] * p.y + self.centre[1] * p.z) / z,
        ]
    }
}
