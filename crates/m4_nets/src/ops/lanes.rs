//! Functions of one number, with vector instructions where tensors lie on the processor.

use burn_core::tensor::{Device, Tensor, TensorData};
use fearless_simd::{Level, Simd, dispatch, f32x16, prelude::*};
use rayon::prelude::*;

/// Numbers of one task.
const CHUNK: usize = 1 << 15;
const LANES: usize = 16;

/// A function of one number.
pub trait Function {
    /// Of 16 numbers.
    fn lanes<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S>;
}

/// `F` of every number of `x` where it is of 32 bits on the processor, else `otherwise` of `x`.
pub fn apply<F: Function, const D: usize>(x: Tensor<D>, otherwise: impl Fn(Tensor<D>) -> Tensor<D>) -> Tensor<D> {
    let device = x.device();
    if device != Device::flex() {
        return otherwise(x);
    }
    let mut data: TensorData = x.into_data();
    match data.as_mut_slice::<f32>() {
        Ok(values) => {
            on_processor::<F>(values);
            Tensor::from_data(data, &device)
        }
        Err(_) => {
            let dtype = data.dtype();
            otherwise(Tensor::from_data(data, (&device, dtype)))
        }
    }
}

fn on_processor<F: Function>(values: &mut [f32]) {
    let level = Level::new();
    values.par_chunks_mut(CHUNK).for_each(|chunk| dispatch!(level, s => each::<_, F>(s, chunk)));
}

#[inline(always)]
fn each<S: Simd, F: Function>(s: S, values: &mut [f32]) {
    let (whole, rest) = values.as_chunks_mut::<LANES>();
    for x in whole {
        *x = F::lanes(s, f32x16::from_slice(s, x)).into();
    }
    if !rest.is_empty() {
        let mut last = [0.0; LANES];
        last[..rest.len()].copy_from_slice(rest);
        let last: [f32; LANES] = F::lanes(s, f32x16::from_slice(s, &last)).into();
        rest.copy_from_slice(&last[..rest.len()]);
    }
}
