//! L1 + SSIM and its gradient: one cube per tile of 16x16 pixels and channel.
#![expect(
    missing_docs,
    reason = "`cube` generates items beside those that it is written at"
)]

use crate::launch;
use crate::{
    gpu::{
        Gpu,
        buffer::{Buffer, units},
        scan::cube_sum,
        tally::{Tally, add_up},
    },
    loss::window,
};
use cubecl::prelude::*;
pub use error_map::error_map;
pub use frames::Frames;

mod error_map;
mod frames;

const SSIM_C1: f32 = super::SSIM_C1 as f32;
const SSIM_C2: f32 = super::SSIM_C2 as f32;
/// What a step of a byte is worth.
const BYTE: f32 = 1.0 / 255.0;

/// Tap `k` of the window.
#[cube]
fn tap(#[comptime] k: u32) -> f32 {
    f32::new(comptime!(window()[k as usize] as f32))
}

/// Colour `channel` of pixel `at` of a frame, 0..1: planes of bytes, each of which starts with a
/// word of its own.
#[cube]
pub fn target_at(target: &[u32], at: u32, channel: u32, pixels: u32) -> f32 {
    let plane = channel * ((pixels + 3u32) / 4u32);
    let four = target[(plane + at / 4u32) as usize];
    f32::cast_from((four >> (8u32 * (at % 4u32))) & 255u32) * BYTE
}

/// Derivatives of SSIM with respect to the three blurs, and three sums per cube: of SSIM, of
/// absolute differences, and of squared differences of the image cut to 0..1.
#[cube(launch)]
pub(crate) fn similarity(
    image: &[f32],
    target: &[u32],
    slopes: &mut [f32],
    sums: &mut [f32],
    width: u32,
    height: u32,
) {
    let mut x = Shared::<[f32]>::new_slice(676usize);
    let mut y = Shared::<[f32]>::new_slice(676usize);
    let mut rows = Shared::<[f32]>::new_slice(2080usize);
    let channel = CUBE_POS_Y;
    let across = (width + 15u32) / 16u32;
    let (left, top) = ((CUBE_POS_X % across) * 16u32, (CUBE_POS_X / across) * 16u32);
    let all = (width * height) as usize;
    let plane = channel as usize * all;
    let mut k = UNIT_POS;
    while k < 676u32 {
        let (cx, cy) = (left + k % 26u32, top + k / 26u32);
        let mut a = 0.0f32;
        let mut b = 0.0f32;
        if cx >= 5u32 && cy >= 5u32 && cx < width + 5u32 && cy < height + 5u32 {
            let at = (cy - 5u32) * width + cx - 5u32;
            a = image[plane + at as usize];
            b = target_at(target, at, channel, width * height);
        }
        x[k as usize] = a;
        y[k as usize] = b;
        k += 256u32;
    }
    sync_cube();
    let mut k = UNIT_POS;
    while k < 416u32 {
        let from = ((k / 16u32) * 26u32 + k % 16u32) as usize;
        let mut sx = 0.0f32;
        let mut sy = 0.0f32;
        let mut sxx = 0.0f32;
        let mut syy = 0.0f32;
        let mut sxy = 0.0f32;
        #[unroll]
        for t in 0u32..11u32 {
            let w = tap(t);
            let a = x[from + t as usize];
            let b = y[from + t as usize];
            sx += w * a;
            sy += w * b;
            sxx += w * a * a;
            syy += w * b * b;
            sxy += w * a * b;
        }
        let to = k as usize * 5;
        rows[to] = sx;
        rows[to + 1] = sy;
        rows[to + 2] = sxx;
        rows[to + 3] = syy;
        rows[to + 4] = sxy;
        k += 256u32;
    }
    sync_cube();
    let (ux, uy) = (UNIT_POS % 16u32, UNIT_POS / 16u32);
    let (px, py) = (left + ux, top + uy);
    let mut a = 0.0f32;
    let mut b = 0.0f32;
    let mut xx = 0.0f32;
    let mut yy = 0.0f32;
    let mut xy = 0.0f32;
    #[unroll]
    for t in 0u32..11u32 {
        let w = tap(t);
        let from = ((uy + t) * 16u32 + ux) as usize * 5;
        a += w * rows[from];
        b += w * rows[from + 1];
        xx += w * rows[from + 2];
        yy += w * rows[from + 3];
        xy += w * rows[from + 4];
    }
    let mut ssim = 0.0f32;
    let mut difference = 0.0f32;
    let mut square = 0.0f32;
    if px < width && py < height {
        let n1 = 2.0f32 * a * b + SSIM_C1;
        let n2 = 2.0f32 * (xy - a * b) + SSIM_C2;
        let d1 = a * a + b * b + SSIM_C1;
        let d2 = (xx - a * a) + (yy - b * b) + SSIM_C2;
        let inverse = 1.0f32 / (d1 * d2);
        ssim = n1 * n2 * inverse;
        let by_square = -ssim / d2;
        let product = 2.0f32 * n1 * inverse;
        let mean = 2.0f32 * b * n2 * inverse
            - 2.0f32 * a * ssim / d1
            - 2.0f32 * a * by_square
            - b * product;
        let at = plane + (py * width + px) as usize;
        slopes[at] = mean;
        slopes[3 * all + at] = by_square;
        slopes[6 * all + at] = product;
        let centre = ((uy + 5u32) * 26u32 + ux + 5u32) as usize;
        difference = (x[centre] - y[centre]).abs();
        let shown = x[centre].clamp(0.0f32, 1.0f32) - y[centre];
        square = shown * shown;
    }
    sync_cube();
    let ssim = cube_sum(ssim, &mut rows);
    let difference = cube_sum(difference, &mut rows);
    let square = cube_sum(square, &mut rows);
    if UNIT_POS == 0u32 {
        let to = (3u32 * CUBE_POS as u32) as usize;
        sums[to] = ssim;
        sums[to + 1] = difference;
        sums[to + 2] = square;
    }
}

/// The gradient of the loss with respect to the image; `gradient` has the planes of the backward
/// pass. One more row of cubes than there are channels: its first adds the sums of the tiles to
/// `tally`.
#[cube(launch)]
pub(crate) fn gradient(
    image: &[f32],
    target: &[u32],
    slopes: &[f32],
    sums: &[f32],
    gradient: &mut [f32],
    tally: &mut [u32],
    width: u32,
    height: u32,
    lambda: f32,
) {
    let mut planes = Shared::<[f32]>::new_slice(2028usize);
    let mut rows = Shared::<[f32]>::new_slice(1248usize);
    if CUBE_POS_Y == 3u32 {
        if CUBE_POS_X == 0u32 {
            let count = 3.0f32 * f32::cast_from(width * height);
            add_up(
                sums,
                tally,
                &mut rows,
                3u32 * CUBE_COUNT_X,
                count,
                lambda,
                0u32,
            );
        }
    } else {
        tile_gradient(
            image,
            target,
            slopes,
            gradient,
            &mut planes,
            &mut rows,
            width,
            height,
            lambda,
        );
    }
}

/// The gradient in a tile.
#[cube]
fn tile_gradient(
    image: &[f32],
    target: &[u32],
    slopes: &[f32],
    gradient: &mut [f32],
    planes: &mut Shared<[f32]>,
    rows: &mut Shared<[f32]>,
    width: u32,
    height: u32,
    lambda: f32,
) {
    let channel = CUBE_POS_Y;
    let across = (width + 15u32) / 16u32;
    let (left, top) = ((CUBE_POS_X % across) * 16u32, (CUBE_POS_X / across) * 16u32);
    let all = (width * height) as usize;
    let plane = channel as usize * all;
    let mut k = UNIT_POS;
    while k < 676u32 {
        let (cx, cy) = (left + k % 26u32, top + k / 26u32);
        let mut a = 0.0f32;
        let mut b = 0.0f32;
        let mut c = 0.0f32;
        if cx >= 5u32 && cy >= 5u32 && cx < width + 5u32 && cy < height + 5u32 {
            let at = plane + ((cy - 5u32) * width + cx - 5u32) as usize;
            a = slopes[at];
            b = slopes[3 * all + at];
            c = slopes[6 * all + at];
        }
        let to = k as usize * 3;
        planes[to] = a;
        planes[to + 1] = b;
        planes[to + 2] = c;
        k += 256u32;
    }
    sync_cube();
    let mut k = UNIT_POS;
    while k < 416u32 {
        let from = ((k / 16u32) * 26u32 + k % 16u32) as usize * 3;
        let mut a = 0.0f32;
        let mut b = 0.0f32;
        let mut c = 0.0f32;
        #[unroll]
        for t in 0u32..11u32 {
            let w = tap(t);
            a += w * planes[from + 3 * t as usize];
            b += w * planes[from + 3 * t as usize + 1];
            c += w * planes[from + 3 * t as usize + 2];
        }
        let to = k as usize * 3;
        rows[to] = a;
        rows[to + 1] = b;
        rows[to + 2] = c;
        k += 256u32;
    }
    sync_cube();
    let (ux, uy) = (UNIT_POS % 16u32, UNIT_POS / 16u32);
    let (px, py) = (left + ux, top + uy);
    if px < width && py < height {
        let mut a = 0.0f32;
        let mut b = 0.0f32;
        let mut c = 0.0f32;
        #[unroll]
        for t in 0u32..11u32 {
            let w = tap(t);
            let from = ((uy + t) * 16u32 + ux) as usize * 3;
            a += w * rows[from];
            b += w * rows[from + 1];
            c += w * rows[from + 2];
        }
        let at = (py * width + px) as usize;
        let x = image[plane + at];
        let y = target_at(target, at as u32, channel, width * height);
        let similarity = a + 2.0f32 * x * b + y * c;
        let mut sign = 0.0f32;
        if x > y {
            sign = 1.0f32;
        }
        if x < y {
            sign = -1.0f32;
        }
        let count = 3.0f32 * f32::cast_from(width * height);
        gradient[plane + at] = ((1.0f32 - lambda) * sign - lambda * similarity) / count;
    }
}

/// Tiles of 16x16 pixels of an image.
pub(crate) fn tiles(width: usize, height: usize) -> usize {
    width.div_ceil(16) * height.div_ceil(16)
}

/// Memory for frames of one size.
#[derive(Debug)]
pub struct Loss {
    width: usize,
    height: usize,
    /// Tiles of 16x16 pixels.
    tiles: usize,
    /// SSIM's derivatives, three planes per channel.
    slopes: Buffer,
    /// Three sums per tile and channel.
    sums: Buffer,
}

impl Loss {
    /// Memory for frames of `width` x `height` pixels.
    pub fn new(gpu: &Gpu, width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            tiles: tiles(width, height),
            slopes: Buffer::empty(&gpu.client, 9 * width * height),
            sums: Buffer::empty(&gpu.client, 9 * tiles(width, height)),
        }
    }

    /// Compares `image` with `frame` and adds the sums to `tally`, the loss as that of view
    /// `index`. `lambda` is the share of SSIM.
    pub fn compare(
        &self,
        gpu: &Gpu,
        image: &Buffer,
        frame: &Buffer,
        index: usize,
        lambda: f32,
        tally: &Tally,
    ) {
        self.similarity(gpu, image, frame);
        tally.frame(
            gpu,
            &self.sums,
            self.tiles,
            3 * self.width * self.height,
            index,
            lambda,
        );
    }

    /// As [`compare`](Self::compare), as view 0, and the gradient with respect to `image` into
    /// `out`.
    pub fn differentiate(
        &self,
        gpu: &Gpu,
        image: &Buffer,
        frame: &Buffer,
        lambda: f32,
        tally: &Tally,
        out: &Buffer,
    ) {
        self.similarity(gpu, image, frame);
        launch!(
            &gpu.client,
            gradient::launch,
            (CubeCount::Static(self.tiles as u32, 4, 1), units()),
            [image, frame, self.slopes, self.sums, out, tally.buffer],
            [self.width as u32, self.height as u32, lambda]
        );
    }

    fn similarity(&self, gpu: &Gpu, image: &Buffer, frame: &Buffer) {
        // a cube a tile and channel
        let cubes = CubeCount::Static(self.tiles as u32, 3, 1);
        launch!(
            &gpu.client,
            similarity::launch,
            (cubes, units()),
            [image, frame, self.slopes, self.sums],
            [self.width as u32, self.height as u32]
        );
    }
}
