//! Images of any size as the network takes them, and depth in their size.

use crate::NetError;
use crate::dinov2::PATCH;
use crate::error::refuse;
use crate::ops::{IMAGENET_MEAN, IMAGENET_STD, Kernels, bilinear, image_tensor, resampled};
use burn_core::tensor::{DType, Device, Tensor, TensorData};
use m4_core::{Intrinsics, Plane, RgbImage};
use std::f32::consts::PI;

/// The longer side may be this many times the shorter one: the network was trained up to 2.
const LONGEST: f64 = 16.0;
/// Softplus turns from exponential to straight this fast, in 1/m.
const BETA: f64 = 10.0;

/// How an image is cut into patches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Patches {
    width: usize,
    height: usize,
    pub grid: [usize; 2],
}

impl Patches {
    /// Of an image of `width` by `height`, about `n` in all, of its shape.
    pub fn of((width, height): (usize, usize), n: usize) -> Result<Self, NetError> {
        if width == 0 || height == 0 {
            return refuse("depth needs an image with pixels");
        }
        let ratio = width as f64 / height as f64;
        if !(1.0 / LONGEST..=LONGEST).contains(&ratio) {
            return refuse(format!(
                "an image of {width} x {height} pixels is too narrow for depth: cut it so that one side is at most 16 times \
                 the other"
            ));
        }
        let rows = ((n as f64 / ratio).sqrt() - 0.5).ceil().max(1.0);
        let columns = (rows * ratio - 0.5).ceil().max(1.0);
        Ok(Self {
            width,
            height,
            grid: [rows as usize, columns as usize],
        })
    }

    /// Width and height of what the network sees.
    pub fn inside(self) -> (usize, usize) {
        let [rows, columns] = self.grid;
        (columns * PATCH, rows * PATCH)
    }

    /// The image `[1, 3, height, width]` of the sides [`Patches::inside`], normalised.
    pub fn tensor(self, image: &RgbImage, device: &Device) -> Tensor<4> {
        image_tensor(
            image,
            self.inside(),
            Kernels::triangle,
            [IMAGENET_MEAN, IMAGENET_STD],
            device,
        )
    }

    /// The camera that four numbers of the camera's head mean, of what the network sees.
    pub fn camera(self, [fx, fy, cx, cy]: [f64; 4]) -> Intrinsics {
        let (width, height) = self.inside();
        let half = width.max(height) as f64 / 2.0;
        let share = |x: f64| 1.0 / (1.0 + (-x).exp());
        Intrinsics {
            width,
            height,
            fx: fx.exp() * half,
            fy: fy.exp() * half,
            cx: share(cx) * width as f64,
            cy: share(cy) * height as f64,
        }
    }

    /// The same camera in pixels of the image. As published, both axes shrink by the ratio of the
    /// heights.
    pub fn camera_of_image(self, camera: &Intrinsics) -> Intrinsics {
        let ratio = camera.height as f64 / self.height as f64;
        Intrinsics {
            width: self.width,
            height: self.height,
            fx: camera.fx / ratio,
            fy: camera.fy / ratio,
            cx: camera.cx / ratio,
            cy: camera.cy / ratio,
        }
    }

    /// Depth `[height][width]` in metres, of the logarithms that the depth's head gives: they are
    /// normalised over the whole image.
    pub fn depth(self, logarithms: &[f32], log_scale: f64, offset: f64) -> Plane<f32> {
        let n = logarithms.len() as f64;
        let mean = logarithms.iter().map(|&x| f64::from(x)).sum::<f64>() / n;
        let variance = logarithms
            .iter()
            .map(|&x| (f64::from(x) - mean).powi(2))
            .sum::<f64>()
            / n;
        let deviation = (variance + 1e-5).sqrt();
        let scale = log_scale.exp();
        let depth = |&x: &f32| {
            let x = ((f64::from(x) - mean) / deviation).exp();
            softplus((x + offset) * scale) as f32
        };
        let depth: Vec<f32> = logarithms.iter().map(depth).collect();
        let depth = bilinear(&depth, self.inside(), (self.width, self.height));
        Plane::from_fn(self.width, self.height, |x, y| depth[y * self.width + x])
    }
}

/// `ln(1 + exp(BETA x)) / BETA`, and `x` where that is the same in 32 bits.
fn softplus(x: f64) -> f64 {
    if x * BETA > 20.0 {
        x
    } else {
        (x * BETA).exp().ln_1p() / BETA
    }
}

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
        let planes = (0..3)
            .flat_map(|c| rays.iter().map(move |r| r[c]))
            .collect();
        Self {
            planes,
            width,
            height,
        }
    }

    /// For a map of `h` by `w`: sines of the rays there at frequencies that grow by a factor from
    /// 1/2 to half the map's longer side, component by component, then the rays; `[h w, 99]` in 32
    /// bits.
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
        let rays: Tensor<2> =
            Tensor::from_data(TensorData::new(rays, [n, 3]), (device, DType::F32));
        let waves = (rays.clone().unsqueeze_dim::<3>(2) * bands).sin();
        Tensor::cat(vec![waves.reshape([n, 3 * BANDS]), rays], 1)
    }
}
