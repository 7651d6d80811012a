//! Dense bundle adjustment, graph and tracker against `fixtures/geometry`, numbers of the published
//! code.

mod dba;
mod tracker;

use crate::dba::{Grid, Pinhole};
use m4_core::Se3;
use safetensors::{Dtype, SafeTensors};
use std::{fs, path::PathBuf};

/// One file of tensors.
pub struct Golden {
    bytes: Vec<u8>,
}

impl Golden {
    pub fn load(path: &str) -> Self {
        let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures")).join(path);
        let bytes =
            fs::read(&path).unwrap_or_else(|e| panic!("cannot read {}: {e}", path.display()));
        Self { bytes }
    }

    /// Shape and values, row-major.
    pub fn tensor(&self, name: &str) -> (Vec<usize>, Vec<f64>) {
        let all = SafeTensors::deserialize(&self.bytes).expect("a broken fixture");
        let view = all.tensor(name).unwrap_or_else(|e| panic!("{name}: {e}"));
        let data = view.data();
        let values = match view.dtype() {
            Dtype::F64 => data
                .as_chunks::<8>()
                .0
                .iter()
                .map(|b| f64::from_le_bytes(*b))
                .collect(),
            Dtype::F32 => data
                .as_chunks::<4>()
                .0
                .iter()
                .map(|b| f64::from(f32::from_le_bytes(*b)))
                .collect(),
            Dtype::I64 => data
                .as_chunks::<8>()
                .0
                .iter()
                .map(|b| i64::from_le_bytes(*b) as f64)
                .collect(),
            Dtype::U8 => data.iter().map(|&b| b.into()).collect(),
            other => panic!("{name} is {other:?}"),
        };
        (view.shape().to_vec(), values)
    }

    pub fn values(&self, name: &str) -> Vec<f64> {
        self.tensor(name).1
    }

    pub fn indices(&self, name: &str) -> Vec<usize> {
        self.values(name).iter().map(|&x| x as usize).collect()
    }

    /// `[2][edges]` as pairs.
    pub fn pairs(&self, name: &str) -> Vec<(usize, usize)> {
        let all = self.indices(name);
        let half = all.len() / 2;
        (0..half).map(|e| (all[e], all[half + e])).collect()
    }

    /// `[n][7]`.
    pub fn poses(&self, name: &str) -> Vec<Se3<f64>> {
        let all = self.values(name);
        let rows = all.as_chunks::<7>().0;
        rows.iter().map(Se3::from_translation_quaternion).collect()
    }

    pub fn lens(&self, name: &str) -> Pinhole<f64> {
        let k = self.values(name);
        Pinhole {
            fx: k[0],
            fy: k[1],
            cx: k[2],
            cy: k[3],
        }
    }

    /// `[frames][height][width]` as one plane per frame.
    pub fn planes(&self, name: &str) -> (Grid, Vec<Vec<f64>>) {
        let (shape, values) = self.tensor(name);
        let grid = Grid {
            height: shape[1],
            width: shape[2],
        };
        (
            grid,
            values.chunks(grid.len()).map(<[f64]>::to_vec).collect(),
        )
    }
}

/// Largest difference between two lists of poses, over all entries of their matrices.
pub fn pose_difference(a: &[Se3<f64>], b: &[Se3<f64>]) -> f64 {
    assert_eq!(a.len(), b.len(), "two lists of poses");
    a.iter()
        .zip(b)
        .map(|(a, b)| (a.matrix() - b.matrix()).amax())
        .fold(0.0, |m, x| if x <= m { m } else { x })
}

/// Largest difference between two lists of numbers; a NaN counts as infinite.
pub fn difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len(), "two lists of numbers");
    a.iter()
        .zip(b)
        .map(|(a, b)| {
            if (a - b).is_nan() {
                f64::INFINITY
            } else {
                (a - b).abs()
            }
        })
        .fold(0.0, f64::max)
}
