//! Where pixels look: what tells the heads of the camera.

use crate::ops::{Kernels, resampled};
use burn_core::tensor::{DType, Device, Tensor, TensorData};
use m4_core::Intrinsics;
use std::f32::consts::PI;

/// Frequencies of each of the three components of a ray.
const BANDS: usize = 32;
/// Channels of an encoded ray.
pub const CHANNELS: usize = 3 * BANDS + 3;

/// Unit vectors towards the pixels of the network's image, `[3][height][width]`.
#[derive(Debug, Clone)]
pub struct Rays {
    planes: Vec<f32>,
    width: usize,
    height: usize,
}

impl Rays {
    /// Through the centres of the pixels of `camera`.
    pub fn of(camera: &Intrinsics) -> Self {
        let (width, height) = (camera.width, camera.height);
        let ray = |i: usize| {
            let x = ((i % width) as f64 + 0.5 - camera.cx) / camera.fx;
            let y = ((i / width) as f64 + 0.5 - camera.cy) / camera.fy;
            let length = (x * x + y * y + 1.0).sqrt();
            [x / length, y / length, 1.0 / length].map(|v| v as f32)
        };
        let rays: Vec<[f32; 3]> = (0..width * height).map(ray).collect();
        let planes = (0..3).flat_map(|c| rays.iter().map(move |r| r[c])).collect();
        Self { planes, width, height }
    }

    /// For a map of `h` by `w`: sines of the rays there at frequencies that grow by a factor from 1/2 to half the map's longer side,
    /// component by component, then the rays; `[h w, 99]` in 32 bits.
    pub fn encoded(&self, h: usize, w: usize, device: &Device) -> Tensor<2> {
        let columns = Kernels::triangle(self.width, w);
        let rows = Kernels::triangle(self.height, h);
        let planes = if (w, h) == (self.width, self.height) {
            self.planes.clone()
        } else {
            resampled(&self.planes, self.width, self.height, &columns, &rows)
        };
        let n = h * w;
        let mut rays = Vec::with_capacity(3 * n);
        for i in 0..n {
            let ray = [0, 1, 2].map(|c| f64::from(planes[c * n + i]));
            let length = ray.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-12);
            rays.extend(ray.map(|v| (v / length) as f32));
        }
        let highest = (h.max(w) / 2).max(1) as f64;
        let band = |i: usize| highest.powf(i as f64 / (BANDS - 1) as f64) as f32 * PI;
        let bands = TensorData::new((0..BANDS).map(band).collect(), [1, 1, BANDS]);
        let bands: Tensor<3> = Tensor::from_data(bands, (device, DType::F32));
        let rays: Tensor<2> = Tensor::from_data(TensorData::new(rays, [n, 3]), (device, DType::F32));
        let waves = (rays.clone().unsqueeze_dim::<3>(2) * bands).sin();
        Tensor::cat(vec![waves.reshape([n, 3 * BANDS]), rays], 1)
    }
}
