//! `fixtures/cvd`, as the library has it.

use crate::megasam::cvd::reference::{Pair, Pinhole, Problem};
use m4_core::{
    Real, Se3,
    nalgebra::{Quaternion, UnitQuaternion, Vector3},
};
use safetensors::{Dtype, SafeTensors};
use std::path::PathBuf;

/// A file of named tensors.
pub struct Tensors(Vec<u8>);

impl Tensors {
    pub fn open(name: &str) -> Self {
        let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/cvd")).join(name);
        Self(std::fs::read(path).unwrap())
    }

    pub fn get(&self, name: &str) -> Vec<f64> {
        let file = SafeTensors::deserialize(&self.0).unwrap();
        let tensor = file.tensor(name).unwrap();
        let data = tensor.data();
        match tensor.dtype() {
            Dtype::F64 => data.as_chunks().0.iter().map(|&b| f64::from_le_bytes(b)).collect(),
            Dtype::F32 => data
                .as_chunks()
                .0
                .iter()
                .map(|&b| f32::from_le_bytes(b).into())
                .collect(),
            Dtype::I64 => data
                .as_chunks()
                .0
                .iter()
                .map(|&b| i64::from_le_bytes(b) as f64)
                .collect(),
            Dtype::U8 => data.iter().map(|&b| b.into()).collect(),
            other => panic!("{name} is of type {other:?}"),
        }
    }
}

pub const SIZE: (usize, usize) = (40, 32);
pub const FRAMES: usize = 6;

/// The problem of `losses.safetensors`, with the initial disparity and the edge weights of the file.
pub fn problem<T: Real>(file: &Tensors) -> Problem<T> {
    let get = |name: &str| file.get(name).into_iter().map(T::of).collect::<Vec<T>>();
    let n = SIZE.0 * SIZE.1;
    let (k, flows, masks) = (file.get("K"), get("flows"), file.get("flow_masks"));
    let (ii, jj) = (file.get("ii"), file.get("jj"));
    let pose = |p: &[f64]| {
        let turn = UnitQuaternion::new_normalize(Quaternion::new(p[6], p[3], p[4], p[5]));
        Se3 {
            rotation: turn.to_rotation_matrix().into_inner().map(T::of),
            translation: Vector3::new(p[0], p[1], p[2]).map(T::of),
        }
    };
    let pair = |i: usize| Pair {
        source: ii[i] as usize,
        target: jj[i] as usize,
        x: flows[2 * i * n..(2 * i + 1) * n].to_vec(),
        y: flows[(2 * i + 1) * n..(2 * i + 2) * n].to_vec(),
        mask: masks[i * n..(i + 1) * n].iter().map(|&m| m != 0.0).collect(),
    };
    Problem {
        width: SIZE.0,
        height: SIZE.1,
        lens: Pinhole {
            fx: T::of(k[0]),
            fy: T::of(k[4]),
            cx: T::of(k[2]),
            cy: T::of(k[5]),
            normal_shift_px: T::of(0.5),
        },
        w2c: file.get("poses").chunks_exact(7).map(pose).collect(),
        pairs: (0..ii.len()).map(pair).collect(),
        initial: get("init_disp"),
        edge_weight: get("fg_alpha"),
    }
}
