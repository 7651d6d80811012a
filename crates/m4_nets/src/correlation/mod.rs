//! Correlation of two feature maps, looked up around positions: what DROID's and RAFT's updates see
//! of the images.
//!
//! ```text
//! score(p, q) = f(p) . g(q) / 16
//! g is pooled 2 x 2 (mean; a last odd row or column is dropped) once a level
//! lookup(p)[level][dx][dy] = bilinear score(p, position(p) / 2^level + (dx, dy)),  |dx|, |dy| <= radius, 0 outside
//! ```
//!
//! - Papers: Teed and Deng, "RAFT", ECCV 2020, section 3.2, and "DROID-SLAM", NeurIPS 2021, section
//!   3.2. Upstreams: princeton-vl/RAFT and princeton-vl/DROID-SLAM, BSD-3.
//! - Both divide by 16, whatever the width of the features: RAFT as `sqrt(256)`, DROID as two
//!   divisions by 4. Here each map is divided by 4, which is exact and keeps half precision in
//!   range.
//! - The offset in x is the slow index, as published.
//!
//! Positions are pixels of the maps whose centres are whole numbers. No scores of all pairs are
//! kept: on the processor [`scores`] computes those that a window touches; elsewhere it makes them
//! some rows of the source at a time. Pooling and the product commute, so pooled features give what
//! pooled scores give.

mod lookup;
#[cfg(test)]
mod tests;

use burn_core::tensor::{Device, Tensor};
use lookup::window_scores;

/// Offsets of a window a side.
pub const fn side(radius: usize) -> usize {
    2 * radius + 1
}

/// Numbers that a lookup gives a pixel: `levels * (2 radius + 1)^2`.
pub const fn taps(levels: usize, radius: usize) -> usize {
    levels * side(radius) * side(radius)
}

/// The scores of each pixel of `source` `[h, w, c]` around `centres` `[h, w, 2]` (x, then y; pixels
/// of the finest level of `target`, 32 bits): `[h, w, levels * (2 radius + 1)^2]`, of which the
/// level is the slowest index and the offset in y the fastest. A centre that is no number lies
/// outside. Source and target are on one device and of one width; the result is in the type of
/// their features.
pub fn scores(
    source: &FeatureMap,
    target: &Pyramid,
    centres: Tensor<3>,
    radius: usize,
) -> Tensor<3> {
    let [h, w, c] = source.size();
    debug_assert_eq!(target.channels(), c, "maps of one width");
    match source.values() {
        Values::Processor(features) => {
            let device = centres.device();
            let centres = centres.into_data();
            let centres = centres.iter::<f32>().collect::<Vec<_>>();
            let width = taps(target.levels().len(), radius);
            let mut out = vec![0.0; h * w * width];
            window_scores(features, c, w, target, &centres, radius, &mut out);
            crate::ops::tensor(out, [h, w, width], &device)
        }
        Values::Device(features) => lookup::scores(features.clone(), target, centres, radius),
    }
}

/// The first of the whole positions that a window at `centre` touches, and how far `centre` lies
/// beyond the whole number before it. Positions so far outside of `0..extent` that no tap matters
/// are drawn near, and so is what is no number.
fn first_and_fraction(centre: f32, extent: usize, radius: usize) -> (i32, f32) {
    let [low, high] = reach(extent, radius);
    let centre = centre.max(low).min(high);
    let whole = centre.floor();
    (whole as i32 - radius as i32, centre - whole)
}

/// Centres below the first or above the second touch nothing of `0..extent`, and nor do these two.
fn reach(extent: usize, radius: usize) -> [f32; 2] {
    [-(radius as f32) - 2.0, (extent + radius) as f32 + 1.0]
}

/// Each of the two maps of a score is divided by this.
const DIVISOR: f32 = 4.0;

#[derive(Debug, Clone)]
#[expect(
    clippy::large_enum_variant,
    reason = "a handful of them, each the key to megabytes"
)]
pub enum Values {
    /// `[h][w][c]`.
    Processor(Vec<f32>),
    /// `[h, w, c]`.
    Device(Tensor<3>),
}

/// Features of one image at one level, already divided by 4.
#[derive(Debug, Clone)]
pub struct FeatureMap {
    size: [usize; 3],
    values: Values,
}

impl FeatureMap {
    /// Of features `[h, w, c]` as a network gives them.
    pub fn new(features: Tensor<3>) -> Self {
        if features.device() != Device::flex() {
            return Self::on_device(features);
        }
        let size = features.dims();
        let data = features.into_data();
        let values = match data.as_slice::<f32>() {
            Ok(values) => values.iter().map(|x| x / DIVISOR).collect(),
            Err(_) => data.iter::<f32>().map(|x| x / DIVISOR).collect(),
        };
        Self {
            size,
            values: Values::Processor(values),
        }
    }

    /// As a tensor, wherever that is.
    pub(super) fn on_device(features: Tensor<3>) -> Self {
        Self {
            size: features.dims(),
            values: Values::Device(features.div_scalar(DIVISOR)),
        }
    }

    /// Rows, columns, channels.
    pub const fn size(&self) -> [usize; 3] {
        self.size
    }

    pub(super) const fn values(&self) -> &Values {
        &self.values
    }

    /// Means of 2 x 2 pixels; a last odd row or column is dropped.
    fn pooled(&self) -> Self {
        let [h, w, c] = self.size;
        let size = [h / 2, w / 2, c];
        let values = match &self.values {
            Values::Processor(values) => Values::Processor(pooled(values, self.size)),
            Values::Device(_) if size.contains(&0) => Values::Processor(Vec::new()),
            Values::Device(values) => {
                let [h, w, c] = size;
                let values = values.clone().slice([0..2 * h, 0..2 * w, 0..c]);
                let columns = values.reshape([2 * h, w, 2, c]).mean_dim(2);
                Values::Device(columns.reshape([h, 2, w, c]).mean_dim(1).reshape([h, w, c]))
            }
        };
        Self { size, values }
    }
}

fn pooled(values: &[f32], [h, w, c]: [usize; 3]) -> Vec<f32> {
    let mut out = Vec::with_capacity((h / 2) * (w / 2) * c);
    for y in 0..h / 2 {
        for x in 0..w / 2 {
            let pixel = |dy: usize, dx: usize| &values[((2 * y + dy) * w + 2 * x + dx) * c..][..c];
            let (a, b, d, e) = (pixel(0, 0), pixel(0, 1), pixel(1, 0), pixel(1, 1));
            out.extend((0..c).map(|k| ((a[k] + b[k]) + (d[k] + e[k])) * 0.25));
        }
    }
    out
}

/// Features of one image at every level, the finest first.
#[derive(Debug, Clone)]
pub struct Pyramid {
    levels: Vec<FeatureMap>,
}

impl Pyramid {
    /// Of features `[h, w, c]` as a network gives them. A level without a pixel scores 0
    /// everywhere.
    pub fn new(features: Tensor<3>, levels: usize) -> Self {
        Self::of(FeatureMap::new(features), levels)
    }

    /// With `finest` as its first level.
    pub fn of(finest: FeatureMap, levels: usize) -> Self {
        let mut all = vec![finest];
        for level in 1..levels {
            all.push(all[level - 1].pooled());
        }
        Self { levels: all }
    }

    pub(super) fn levels(&self) -> &[FeatureMap] {
        &self.levels
    }

    pub(super) fn channels(&self) -> usize {
        self.levels[0].size[2]
    }
}
