//! Windows that the maps of a scale are cut into: `splits` by `splits`, for attention within each.

use crate::ops::{sine_positions, tensor};
use burn_core::tensor::{Device, Tensor};

/// How maps `[n, height, width, c]` are cut.
#[derive(Debug, Clone, Copy)]
pub struct Windows {
    pub height: usize,
    pub width: usize,
    pub splits: usize,
}

impl Windows {
    /// Height and width of a window.
    fn size(self) -> [usize; 2] {
        [self.height / self.splits, self.width / self.splits]
    }

    /// How far windows are moved in every other layer: half their size.
    fn shift(self) -> [i64; 2] {
        self.size().map(|side| (side / 2) as i64)
    }

    /// Maps `[n, height, width, c]` as windows `[n splits^2, h w, c]`, moved by half a window if `shifted`.
    pub fn split(self, maps: Tensor<4>, shifted: bool) -> Tensor<3> {
        let [n, _, _, c] = maps.dims();
        let [h, w] = self.size();
        let k = self.splits;
        let [dy, dx] = self.shift();
        let maps = if shifted { maps.roll(&[-dy, -dx], &[1, 2]) } else { maps };
        maps.reshape([n, k, h, k, w, c])
            .permute([0, 1, 3, 2, 4, 5])
            .reshape([n * k * k, h * w, c])
    }

    /// The inverse of [`Windows::split`].
    pub fn merge(self, windows: Tensor<3>, shifted: bool) -> Tensor<4> {
        let [all, _, c] = windows.dims();
        let [h, w] = self.size();
        let k = self.splits;
        let n = all / (k * k);
        let maps = windows
            .reshape([n, k, k, h, w, c])
            .permute([0, 1, 3, 2, 4, 5])
            .reshape([n, self.height, self.width, c]);
        let [dy, dx] = self.shift();
        if shifted { maps.roll(&[dy, dx], &[1, 2]) } else { maps }
    }

    /// What is added to the scores of moved windows, `[splits^2, h w, h w]`: -100 between pixels that were not neighbours
    /// before the maps were rolled, else 0 (Swin Transformer, section 3.2).
    pub fn shift_mask(self, device: &Device) -> Tensor<3> {
        let [h, w] = self.size();
        let k = self.splits;
        let region = |i: usize, n: usize, side: usize| match i {
            i if i < n - side => 0,
            i if i < n - side / 2 => 1,
            _ => 2,
        };
        let mut mask = Vec::with_capacity(k * k * (h * w).pow(2));
        for (y0, x0) in (0..k * k).map(|i| (i / k * h, i % k * w)) {
            let of = |i: usize| (region(y0 + i / w, self.height, h), region(x0 + i % w, self.width, w));
            let regions: Vec<_> = (0..h * w).map(of).collect();
            for a in &regions {
                mask.extend(regions.iter().map(|b| if a == b { 0.0 } else { -100.0 }));
            }
        }
        tensor(mask, [k * k, h * w, h * w], device)
    }

    /// The position of each pixel within its window, `[1, height, width, channels]`: sines and cosines of row, then column,
    /// at wavelengths from 1 to 10,000, a quarter of the channels each (DETR).
    pub fn position(self, channels: usize, device: &Device) -> Tensor<4> {
        sine_positions([self.height, self.width], self.size(), channels, device)
    }
}
