//! Minute4D Eq. 6 on the GPU: the error of each pixel.

use super::target_at;
use crate::gpu::Gpu;
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::launch;
use cubecl::prelude::*;

/// Writes the mean over the channels of the absolute differences of `image` (three planes of f32)
/// and `frame` (bytes, as [`super::Frames`] has them), a number per pixel, and the smallest and the
/// largest of each cube of 256 pixels.
pub fn error_map(gpu: &Gpu, image: &Buffer, frame: &Buffer, [errors, extremes]: [&Buffer; 2]) {
    let (client, pixels) = (&gpu.client, errors.len());
    launch!(
        client,
        error_of_pixels::launch,
        (cubes(pixels, 256), units()),
        [image, frame, errors, extremes],
        [pixels as u32]
    );
}

/// Mean over the channels of the absolute differences (Minute4D Eq. 6), 0 where that is not finite;
/// smallest and largest of each cube.
#[cube(launch)]
fn error_of_pixels(
    image: &[f32],
    target: &[u32],
    errors: &mut [f32],
    extremes: &mut [f32],
    pixels: u32,
) {
    let mut low = Shared::<[f32]>::new_slice(256usize);
    let mut high = Shared::<[f32]>::new_slice(256usize);
    let i = ABSOLUTE_POS as u32;
    let unit = UNIT_POS as usize;
    low[unit] = f32::new(3.0e38f32);
    high[unit] = f32::new(0.0f32);
    if i < pixels {
        let mut sum = 0.0f32;
        #[unroll]
        for channel in 0u32..3u32 {
            let x = image[(channel * pixels + i) as usize];
            sum += (x - target_at(target, i, channel, pixels)).abs();
        }
        let mut error = sum * (1.0f32 / 3.0f32);
        if (u32::reinterpret(error) & 0x7f80_0000u32) == 0x7f80_0000u32 {
            error = 0.0f32;
        }
        errors[i as usize] = error;
        low[unit] = error;
        high[unit] = error;
    }
    sync_cube();
    let mut half = 128u32;
    while half > 0u32 {
        if UNIT_POS < half {
            let other = (UNIT_POS + half) as usize;
            low[unit] = low[unit].min(low[other]);
            high[unit] = high[unit].max(high[other]);
        }
        sync_cube();
        half /= 2u32;
    }
    let at = 2 * CUBE_POS;
    if UNIT_POS == 0u32 && at + 1 < extremes.len() {
        extremes[at] = low[0];
        extremes[at + 1] = high[0];
    }
}
