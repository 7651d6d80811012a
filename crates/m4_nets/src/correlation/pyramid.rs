//! Feature maps as lookups read them.

use burn_core::tensor::{Device, Tensor};

/// Each of the two maps of a score is divided by this.
const DIVISOR: f32 = 4.0;

/// Where features lie.
#[derive(Debug, Clone)]
#[expect(clippy::large_enum_variant, reason = "a handful of them, each the key to megabytes")]
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
        Self { size, values: Values::Processor(values) }
    }

    /// As a tensor, wherever that is.
    pub(super) fn on_device(features: Tensor<3>) -> Self {
        Self { size: features.dims(), values: Values::Device(features.div_scalar(DIVISOR)) }
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
    /// Of features `[h, w, c]` as a network gives them. A level without a pixel scores 0 everywhere.
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
