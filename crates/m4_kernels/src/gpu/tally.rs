//! Statistics of steps, accumulated on the device and read at once.

#![expect(
    missing_docs,
    reason = "`cube` generates items beside those that it is written at"
)]

use crate::StepStats;
use crate::gpu::buffer::{Buffer, cubes, units};
use crate::gpu::scan::{cube_sum, scan_cube};
use crate::gpu::{Gpu, GpuError};
use crate::launch;
use cubecl::prelude::*;

/// The largest number of tile entries that a frame wanted.
const PEAK: usize = 0;
const STEPS: usize = 1;
/// Splats moved, summed over the steps: low and high word.
const TOUCHED: usize = 2;
const FRAMES: usize = 4;
/// Not 0 where the loss of a frame was not finite.
const BAD_LOSS: usize = 5;
/// Not 0 where a parameter is not finite.
const BAD_SPLAT: usize = 6;
/// Floats: sums over the frames, and the last frame's mean squared error.
const SSIM: usize = 7;
const L1: usize = 8;
const SQUARES: usize = 9;
/// Losses, one per view that is recorded separately.
pub const LOSSES: usize = 10;

/// The sums on the device.
#[derive(Debug)]
pub struct Tally {
    /// As the constants of this module say; the first number is the peak of tile entries.
    pub buffer: Buffer,
}

impl Tally {
    /// Empty, with room for the losses of `views` views.
    pub fn new(gpu: &Gpu, views: usize) -> Self {
        Self {
            buffer: Self::fresh(gpu, views),
        }
    }

    fn fresh(gpu: &Gpu, views: usize) -> Buffer {
        Buffer::words(&gpu.client, &vec![0; LOSSES + views])
    }

    /// Adds the sums of a frame's tiles, three per tile and channel of which `values` make a mean,
    /// and keeps the loss as that of view `view`.
    pub fn frame(
        &self,
        gpu: &Gpu,
        sums: &Buffer,
        tiles: usize,
        values: usize,
        view: usize,
        lambda: f32,
    ) {
        launch!(
            &gpu.client,
            add_frame::launch,
            (cubes(1, 1), units()),
            [sums, self.buffer],
            [3 * tiles as u32, values as f32, lambda, view as u32]
        );
    }

    /// Waits, returns the statistics and the most tile entries that a frame wanted, and starts
    /// again. Fails with [`GpuError`] if the device failed.
    pub fn take(&mut self, gpu: &Gpu, doing: &'static str) -> Result<(StepStats, usize), GpuError> {
        let words = self.buffer.read_words(&gpu.client, doing)?;
        self.buffer = Self::fresh(gpu, words.len() - LOSSES);
        let float = |at: usize| f64::from(f32::from_bits(words[at]));
        let (steps, frames) = (words[STEPS] as usize, words[FRAMES] as usize);
        let touched = u64::from(words[TOUCHED]) | u64::from(words[TOUCHED + 1]) << 32;
        let mean = |at: usize| float(at) / frames.max(1) as f64;
        let stats = StepStats {
            steps,
            frames,
            l1: if words[BAD_LOSS] == 0 {
                mean(L1)
            } else {
                f64::NAN
            },
            ssim: mean(SSIM),
            psnr: if frames == 0 {
                f64::NAN
            } else {
                (-10.0 * float(SQUARES).log10()).min(100.0)
            },
            touched: touched as f64 / steps.max(1) as f64,
            cameras: Vec::new(),
            exposures: Vec::new(),
            splats_are_finite: words[BAD_SPLAT] == 0,
        };
        Ok((stats, words[PEAK] as usize))
    }
}

/// Whether a number is neither infinite nor NaN, by its bits: compilers of shaders may take it for
/// granted.
#[cube]
pub fn is_finite(value: f32) -> bool {
    (u32::reinterpret(value) & 0x7f80_0000u32) != 0x7f80_0000u32
}

/// Notes a parameter that is not finite.
#[cube]
pub(crate) fn check_parameter(value: f32, tally: &[Atomic<u32>]) {
    if !is_finite(value) {
        tally[BAD_SPLAT].store(1u32);
    }
}

/// Counts a step, and the splats that are touched, of which each unit has one: 1 or 0.
#[cube]
pub(crate) fn count_step(touched: u32, tally: &[Atomic<u32>]) {
    let mut shared = Shared::<[u32]>::new_slice(256usize);
    let before = scan_cube(touched, &mut shared);
    if UNIT_POS == 255u32 {
        let sum = before + touched;
        let old = tally[TOUCHED].fetch_add(sum);
        // the low word went over
        if old > 0xffff_ffffu32 - sum {
            tally[TOUCHED + 1].fetch_add(1u32);
        }
    }
    if ABSOLUTE_POS == 0 {
        tally[STEPS].fetch_add(1u32);
    }
}

#[cube]
fn add_float(tally: &mut [u32], #[comptime] at: usize, value: f32) {
    let sum = f32::reinterpret(tally[at]) + value;
    tally[at] = u32::reinterpret(sum);
}

#[cube(launch)]
fn add_frame(sums: &[f32], tally: &mut [u32], cubes: u32, count: f32, lambda: f32, view: u32) {
    let mut shared = Shared::<[f32]>::new_slice(256usize);
    add_up(sums, tally, &mut shared, cubes, count, lambda, view);
}

/// Adds the means of a frame's SSIM and differences, and keeps its loss. By one cube of 256 units,
/// with `shared` memory for as many.
#[cube]
pub(crate) fn add_up(
    sums: &[f32],
    tally: &mut [u32],
    shared: &mut Shared<[f32]>,
    cubes: u32,
    count: f32,
    lambda: f32,
    view: u32,
) {
    let mut ssim = 0.0f32;
    let mut difference = 0.0f32;
    let mut square = 0.0f32;
    let mut k = UNIT_POS;
    while k < cubes {
        ssim += sums[(3u32 * k) as usize];
        difference += sums[(3u32 * k + 1u32) as usize];
        square += sums[(3u32 * k + 2u32) as usize];
        k += 256u32;
    }
    let ssim = cube_sum(ssim, shared) / count;
    let difference = cube_sum(difference, shared) / count;
    let square = cube_sum(square, shared) / count;
    if UNIT_POS == 0u32 {
        let loss = (1.0f32 - lambda) * difference + lambda * (1.0f32 - ssim);
        tally[FRAMES] += 1u32;
        if !is_finite(loss) {
            tally[BAD_LOSS] = 1u32;
        }
        add_float(tally, SSIM, ssim);
        add_float(tally, L1, difference);
        tally[SQUARES] = u32::reinterpret(square);
        tally[LOSSES + view as usize] = u32::reinterpret(loss);
    }
}
