//! Consistent video depth on `fixtures/cvd`: the definition against the numbers of the original program, and the fast path against
//! the definition.

mod fast;
mod optimise;
mod reference;

use crate::dba::Pinhole;
use crate::megasam::cvd::reference::{Pair, Problem};
use crate::published::Golden;
use m4_core::{
    Real, Se3,
    nalgebra::{Quaternion, UnitQuaternion, Vector3},
};

const SIZE: (usize, usize) = (40, 32);
const FRAMES: usize = 6;

/// The problem of `losses.safetensors`, with the initial disparity and the edge weights of the file.
fn problem<T: Real>(file: &Golden) -> Problem<T> {
    let get = |name: &str| file.values(name).into_iter().map(T::of).collect::<Vec<T>>();
    let n = SIZE.0 * SIZE.1;
    let (k, flows, masks) = (file.values("K"), get("flows"), file.values("flow_masks"));
    let (ii, jj) = (file.values("ii"), file.values("jj"));
    let pose = |p: &[f64]| {
        let turn = UnitQuaternion::new_normalize(Quaternion::new(p[6], p[3], p[4], p[5]));
        Se3 {
            rotation: turn.to_rotation_matrix().into_inner().map(T::of),
            translation: Vector3::new(p[0], p[1], p[2]).map(T::of),
        }
    };
    let lens = |shift_px: f64| Pinhole {
        fx: T::of(k[0]),
        fy: T::of(k[4]),
        cx: T::of(k[2] - shift_px),
        cy: T::of(k[5] - shift_px),
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
        lens: lens(0.0),
        normal_lens: lens(0.5),
        w2c: file.values("poses").chunks_exact(7).map(pose).collect(),
        pairs: (0..ii.len()).map(pair).collect(),
        initial: get("init_disp"),
        edge_weight: get("fg_alpha"),
    }
}
