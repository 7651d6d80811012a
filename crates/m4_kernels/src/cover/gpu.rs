//! One unit per dynamic splat.
use super::LEAST_OPACITY;
use crate::gpu::Gpu;
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::launch;
use crate::splats::DeviceSplats;
use cubecl::prelude::*;
use m4_core::Column;

/// Adds the gradient of the dynamic splats that `touched` names to `gradients`, with this `weight`.
pub fn add(
    gpu: &Gpu,
    splats: &DeviceSplats,
    gradients: &DeviceSplats,
    touched: &Buffer,
    weight: f32,
) {
    let (n, n_static, layout) = (splats.n, splats.n_static, splats.layout);
    if n == n_static {
        return;
    }
    let scales = layout.range(Column::LogScale);
    launch!(
        &gpu.client,
        grow::launch,
        (cubes(n - n_static, 256), units()),
        [splats.geometry, gradients.geometry, touched],
        [
            n as u32,
            n_static as u32,
            layout.column(Column::Opacity) as u32,
            scales.start as u32,
            scales.end as u32,
            weight,
            LEAST_OPACITY
        ]
    );
}

#[cube(launch)]
fn grow(
    x: &[f32],
    g: &mut [f32],
    touched: &[u32],
    n: u32,
    n_static: u32,
    opacity_column: u32,
    first_scale: u32,
    end_scale: u32,
    weight: f32,
    least: f32,
) {
    let i = n_static + ABSOLUTE_POS as u32;
    if i < n {
        if touched[i as usize] != 0u32 {
            let logit = x[(opacity_column * n + i) as usize];
            let opacity = 1.0f32 / (1.0f32 + (-logit).exp());
            if opacity > least {
                for c in first_scale..end_scale {
                    g[(c * n + i) as usize] -= weight * opacity;
                }
            }
        }
    }
}
