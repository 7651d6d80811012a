//! The pixels of a frame whose error is large enough to count (Minute4D Eq. 7).

use crate::config::ErrorRange;
use cubecl::prelude::*;
use m4_kernels::gpu::Gpu;
use m4_kernels::gpu::buffer::{Buffer, cubes, units};
use m4_kernels::gpu::sort::{Pairs, Sort};
use m4_kernels::launch;
use m4_kernels::loss::gpu::error_map;

/// The errors of a frame, and from where on they count.
#[derive(Debug)]
pub(crate) struct Mask {
    pixels: usize,
    /// Mean over the channels of the absolute differences.
    pub errors: Buffer,
    /// Smallest and largest of each cube of 256.
    extremes: Buffer,
    /// The error that must be exceeded, and 1 where any may.
    pub cut: Buffer,
    /// For quantiles: the errors' bits, which lie in the order of the errors.
    sorted: Option<Quantile>,
}

#[derive(Debug)]
struct Quantile {
    /// The place of the error in order.
    place: usize,
    pairs: Pairs,
    sort: Sort,
    count: Buffer,
}

impl Mask {
    /// For frames of this many pixels, of which there are some.
    pub fn new(gpu: &Gpu, pixels: usize, range: ErrorRange) -> Self {
        let client = &gpu.client;
        let sorted = match range {
            ErrorRange::MinMax => None,
            ErrorRange::Quantile { high } => Some(Quantile {
                place: (((pixels - 1) as f32 * high.clamp(0.0, 1.0)) as usize).min(pixels - 1),
                pairs: Pairs::empty(client, pixels),
                sort: Sort::new(client, pixels),
                count: Buffer::words(client, &[pixels as u32]),
            }),
        };
        Self {
            pixels,
            errors: Buffer::empty(client, pixels),
            extremes: Buffer::empty(client, 2 * pixels.div_ceil(256)),
            cut: Buffer::empty(client, 2),
            sorted,
        }
    }

    /// The errors of `image`, and the cut.
    pub fn find(&self, gpu: &Gpu, image: &Buffer, frame: &Buffer, threshold: f32) {
        let (client, pixels) = (&gpu.client, self.pixels);
        error_map(gpu, image, frame, [&self.errors, &self.extremes]);
        match &self.sorted {
            None => launch!(
                client,
                cut_of_extremes::launch,
                (cubes(1, 1), units()),
                [self.extremes, self.cut],
                [pixels.div_ceil(256) as u32, threshold]
            ),
            Some(quantile) => {
                let Quantile {
                    place,
                    pairs,
                    sort,
                    count,
                } = quantile;
                launch!(
                    client,
                    bits::launch,
                    (cubes(pixels, 256), units()),
                    [self.errors, pairs.keys],
                    [pixels as u32]
                );
                let sorted = sort.run(client, pairs, count, 32);
                launch!(
                    client,
                    cut_of_quantile::launch,
                    (cubes(1, 1), CubeDim::new_1d(1)),
                    [sorted.keys, self.cut],
                    [*place as u32, threshold]
                );
            }
        }
    }
}

/// Writes the cut of a range; nothing counts in one without width.
#[cube]
fn write_cut(low: f32, high: f32, threshold: f32, cut: &mut [f32]) {
    cut[0] = low + threshold * (high - low);
    cut[1] = f32::new(0.0f32);
    if high > low {
        cut[1] = f32::new(1.0f32);
    }
}

#[cube(launch)]
fn cut_of_extremes(extremes: &[f32], cut: &mut [f32], count: u32, threshold: f32) {
    let mut lows = Shared::<[f32]>::new_slice(256usize);
    let mut highs = Shared::<[f32]>::new_slice(256usize);
    let mut low = f32::new(3.0e38f32);
    let mut high = f32::new(0.0f32);
    let mut k = UNIT_POS;
    while k < count {
        low = low.min(extremes[(2u32 * k) as usize]);
        high = high.max(extremes[(2u32 * k + 1u32) as usize]);
        k += 256u32;
    }
    lows[UNIT_POS as usize] = low;
    highs[UNIT_POS as usize] = high;
    sync_cube();
    if UNIT_POS == 0u32 {
        for k in 1usize..256usize {
            low = low.min(lows[k]);
            high = high.max(highs[k]);
        }
        write_cut(low, high, threshold, cut);
    }
}

#[cube(launch)]
fn bits(errors: &[f32], keys: &mut [u32], pixels: u32) {
    let i = ABSOLUTE_POS;
    if i < pixels as usize {
        keys[i] = u32::reinterpret(errors[i]);
    }
}

#[cube(launch)]
fn cut_of_quantile(keys: &[u32], cut: &mut [f32], place: u32, threshold: f32) {
    if ABSOLUTE_POS == 0 {
        write_cut(
            f32::new(0.0f32),
            f32::reinterpret(keys[place as usize]),
            threshold,
            cut,
        );
    }
}
