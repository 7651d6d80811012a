//! Points that are asked for: what is around them in their frame, and the grid of points beside them.

use super::camera::PosedPinhole;
use super::frame::{Sides, map_sizes, rows_of, sampled};
use super::neighbours::{Cloud, Search};
use super::{Net, Tapip3dError};
use burn_core::tensor::Tensor;
use m4_core::nalgebra::Vector3;
use rayon::prelude::*;

/// What the network knows of `queries`, which are points of the world in a frame with the features `maps` (of the encoder) and the
/// points `points`, a map per level, seen through `lens` in `size`.
pub fn sides(
    net: &Net,
    maps: &[Tensor<2>],
    points: &[Vec<[f32; 3]>],
    lens: &PosedPinhole,
    size: (usize, usize),
    queries: &[[f32; 3]],
    neighbours: usize,
) -> Sides {
    let sizes = map_sizes(size, maps.len());
    let seen: Vec<[f64; 2]> = queries.iter().map(|&q| seen(lens, size, q)).collect();
    let (mut features, mut around) = (Vec::new(), Vec::new());
    for ((map, points), (w, h)) in maps.iter().zip(points).zip(sizes) {
        let cloud = Cloud::new(points.clone());
        let near: Vec<Vec<u32>> = queries
            .par_iter()
            .map_init(Search::default, |search, &q| cloud.nearest(q, neighbours, search).collect())
            .collect();
        let scale = [w as f64 / size.0 as f64, h as f64 / size.1 as f64];
        let places: Vec<[f64; 2]> = seen.iter().map(|p| [p[0] * scale[0], p[1] * scale[1]]).collect();
        let own = sampled(map, (w, h), &places);
        let others = rows_of(map, near.iter().flatten().map(|&i| i as i32).collect());
        let (n, [_, c]) = (queries.len(), own.dims());
        let both = Tensor::cat(vec![own.reshape([n, 1, c]), others.reshape([n, neighbours, c])], 1);
        let tokens = net.corr_processor.prepared(both.reshape([n * (1 + neighbours), c]));
        let [_, c] = tokens.dims();
        features.push(tokens.reshape([n, 1 + neighbours, c]));
        let with_near = queries.iter().zip(&near);
        around.push(
            with_near
                .flat_map(|(&q, near)| std::iter::once(q).chain(near.iter().map(|&i| points[i as usize])))
                .collect(),
        );
    }
    Sides { features, points: around }
}

/// Where a point is seen; as far out as two images.
fn seen(lens: &PosedPinhole, (w, h): (usize, usize), q: [f32; 3]) -> [f64; 2] {
    let q = Vector3::from(q.map(f64::from));
    let [x, y] = lens.project(&q);
    let bound = |x: f64, n: usize| x.clamp(-2.0 * n as f64, 2.0 * n as f64);
    [bound(x, w), bound(y, h)]
}

impl Sides {
    /// These, then those of `others`; there is at least one.
    pub fn together(all: &[&Self]) -> Result<Self, Tapip3dError> {
        let Some(first) = all.first() else {
            return Err(Tapip3dError::NoFrames);
        };
        let level = |level: usize| {
            let features = all.iter().map(|sides| sides.features[level].clone()).collect();
            let points = all.iter().flat_map(|sides| sides.points[level].iter().copied());
            (Tensor::cat(features, 0), points.collect())
        };
        let (features, points) = (0..first.features.len()).map(level).unzip();
        Ok(Self { features, points })
    }
}

/// `side` rows and columns of points that are spread over an image whose depth is `z` `[h][w]`, where that is known.
pub fn grid(side: usize, z: &[f32], (w, h): (usize, usize), lens: &PosedPinhole) -> Vec<[f32; 3]> {
    let margin = w as f64 / 64.0;
    let along = |n: usize, i: usize| {
        if side == 1 {
            return n as f64 / 2.0;
        }
        let (first, last) = (margin, n as f64 - margin);
        first + (last - first) * i as f64 / (side - 1) as f64
    };
    let pixel = |x: f64, n: usize| (x.round_ties_even().max(0.0) as usize).min(n - 1);
    let places = (0..side).flat_map(|i| (0..side).map(move |j| (i, j)));
    places
        .filter_map(|(i, j)| {
            let (x, y) = (along(w, j), along(h, i));
            let z = z[pixel(y, h) * w + pixel(x, w)];
            (z > 0.0).then(|| lens.unproject([x, y], f64::from(z)))
        })
        .map(|p| [p.x as f32, p.y as f32, p.z as f32])
        .collect()
}
