//! Small inputs of kernels: a camera, rates, tables.
//!
//! On Vulkan, Metal and DX12 an upload submits all work that was asked for before it, at the cost
//! of several launches. So what returns (the cameras of the frames) is kept on the device by its
//! content, and what does not is written by a kernel that gets the numbers with its launch.

use crate::gpu::Gpu;
use crate::gpu::buffer::Buffer;
use crate::gpu::device::Runtime;
use crate::launch;
use cubecl::prelude::*;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Inputs that are kept; more than the frames of a long clip have.
const MOST: usize = 4096;

/// Inputs on the device by their content. Clones share them.
#[derive(Debug, Clone, Default)]
pub(super) struct Inputs(Arc<Mutex<HashMap<Vec<u32>, Buffer>>>);

impl Inputs {
    /// Forgets all.
    pub fn clear(&self) {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clear();
    }
}

impl Gpu {
    /// Words on the device that kernels only read, and that will be asked for again.
    #[must_use]
    pub fn input(&self, words: &[u32]) -> Buffer {
        let mut all = self.inputs.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(buffer) = all.get(words) {
            return buffer.clone();
        }
        if all.len() >= MOST {
            all.clear();
        }
        let buffer = Buffer::words(&self.client, words);
        all.insert(words.to_vec(), buffer.clone());
        buffer
    }

    /// The same of numbers.
    #[must_use]
    pub fn input_floats(&self, values: &[f32]) -> Buffer {
        self.input(
            &values
                .iter()
                .map(|value| value.to_bits())
                .collect::<Vec<u32>>(),
        )
    }

    /// Numbers on the device that are used once.
    #[must_use]
    pub fn passing(&self, values: &[f32]) -> Buffer {
        match self.adapter().runtime() {
            Runtime::Wgpu(_) if !values.is_empty() => {
                let out = Buffer::empty(&self.client, values.len());
                let values = values.iter().copied().collect();
                launch!(
                    &self.client,
                    put::launch,
                    (CubeCount::new_single(), CubeDim::new_single()),
                    [out],
                    [values]
                );
                out
            }
            _ => Buffer::floats(&self.client, values),
        }
    }
}

/// Writes numbers that come with the launch.
#[cube(launch)]
fn put(out: &mut [f32], values: &Sequence<f32>) {
    #[unroll]
    for k in 0..values.len() {
        out[k] = values[k];
    }
}

#[cfg(test)]
mod tests {
    use crate::gpu::device::tests::gpu;

    #[test]
    fn inputs_are_what_was_asked_for() {
        let Some(gpu) = gpu("inputs") else { return };
        let values: Vec<f32> = (0..77).map(|k| 0.5 * k as f32 - 3.25).collect();
        for values in [&values[..], &values[..1], &values[1..40]] {
            for buffer in [
                gpu.passing(values),
                gpu.input_floats(values),
                gpu.input_floats(values),
            ] {
                assert_eq!(buffer.read_floats(&gpu.client, "test").unwrap(), values);
            }
        }
        assert_eq!(
            gpu.input(&[7, 9]).read_words(&gpu.client, "test").unwrap(),
            [7, 9]
        );
        gpu.give_back().unwrap();
        assert_eq!(
            gpu.input(&[7, 9]).read_words(&gpu.client, "test").unwrap(),
            [7, 9]
        );
    }
}
