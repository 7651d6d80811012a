//! Rows of numbers in another length, as PyTorch and OpenCV resize images. The centre of number `i`
//! is at `i + 1/2`.

use super::{planes, tensor};
use burn_core::tensor::{Device, Tensor};
use m4_core::{Plane, RgbImage};
use rayon::prelude::*;

/// The numbers that a new one is made of: the first of them, and their weights.
#[derive(Debug, Clone, PartialEq)]
struct Kernel {
    first: usize,
    weights: Vec<f32>,
}

/// How each number of a row of the new length is made of one of the old.
#[derive(Debug, Clone, PartialEq)]
pub struct Kernels(Vec<Kernel>);

impl Kernels {
    /// Cubic with a = -0.75 between four neighbours, edges repeated, without antialiasing:
    /// `INTER_CUBIC` of OpenCV, `bicubic` of PyTorch.
    pub fn cubic(from: usize, to: usize) -> Self {
        Self::cubic_by_step(from, to, from as f64 / to as f64)
    }

    /// The same with samples that lie `step` apart.
    pub fn cubic_by_step(from: usize, to: usize, step: f64) -> Self {
        Self::of(to, |i| {
            let at = (i as f64 + 0.5) * step - 0.5;
            let t = at - at.floor();
            let weights = [1.0 + t, t, 1.0 - t, 2.0 - t].map(cubic);
            neighbours(at.floor() as i64 - 1, &weights, from)
        })
    }

    /// Linear between two neighbours, edges repeated, without antialiasing: `bilinear` of PyTorch
    /// with `align_corners=False`.
    pub fn linear(from: usize, to: usize) -> Self {
        let step = from as f64 / to as f64;
        Self::of(to, |i| {
            let at = ((i as f64 + 0.5) * step - 0.5).max(0.0);
            let t = at - at.floor();
            neighbours(at.floor() as i64, &[1.0 - t, t], from)
        })
    }

    /// A triangle that is as wide as a new number where the row becomes shorter: `bilinear` of
    /// PyTorch with `antialias=True`.
    pub fn triangle(from: usize, to: usize) -> Self {
        let step = from as f64 / to as f64;
        let reach = step.max(1.0);
        Self::of(to, |i| {
            let centre = (i as f64 + 0.5) * step;
            let first = (centre - reach + 0.5).max(0.0) as usize;
            let end = ((centre + reach + 0.5) as usize).min(from);
            let weight = |j: usize| (1.0 - ((j as f64 + 0.5 - centre) / reach).abs()).max(0.0);
            let weights: Vec<f64> = (first..end).map(weight).collect();
            let sum: f64 = weights.iter().sum();
            let weights = weights.iter().map(|w| (w / sum) as f32).collect();
            Kernel { first, weights }
        })
    }

    fn of(to: usize, kernel: impl Fn(usize) -> Kernel) -> Self {
        Self((0..to).map(kernel).collect())
    }

    /// The same as a matrix `[to][from]`.
    pub fn matrix(&self, from: usize) -> Vec<f32> {
        let mut out = vec![0.0; self.0.len() * from];
        for (row, kernel) in out.chunks_exact_mut(from).zip(&self.0) {
            row[kernel.first..][..kernel.weights.len()].copy_from_slice(&kernel.weights);
        }
        out
    }

    /// The number of new numbers.
    fn to(&self) -> usize {
        self.0.len()
    }
}

/// `weights` of the numbers from `first` on, those beyond an end given to the number at that end.
fn neighbours(first: i64, weights: &[f64], from: usize) -> Kernel {
    let last = from as i64 - 1;
    let at = |j: i64| j.clamp(0, last);
    let start = at(first);
    let end = at(first + weights.len() as i64 - 1);
    let mut gathered = vec![0.0f64; (end - start + 1) as usize];
    for (j, weight) in (first..).zip(weights) {
        gathered[(at(j) - start) as usize] += weight;
    }
    Kernel {
        first: start as usize,
        weights: gathered.iter().map(|&w| w as f32).collect(),
    }
}

/// The cubic of Keys with a = -0.75 at the distance `x` from 0 to 2.
fn cubic(x: f64) -> f64 {
    const A: f64 = -0.75;
    if x <= 1.0 {
        ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0
    } else {
        ((A * x - 5.0 * A) * x + 8.0 * A) * x - 4.0 * A
    }
}

/// Planes `[n][height][width]` (`width` numbers per row) with columns and rows of other numbers:
/// along rows, then along columns.
pub fn resampled(
    planes: &[f32],
    width: usize,
    height: usize,
    columns: &Kernels,
    rows: &Kernels,
) -> Vec<f32> {
    let (to_width, to_height) = (columns.to(), rows.to());
    let planes_count = planes.len().checked_div(width * height).unwrap_or(0);
    let mut narrow = vec![0.0f32; planes_count * height * to_width];
    if narrow.is_empty() || to_height == 0 {
        return Vec::new();
    }
    narrow
        .par_chunks_mut(to_width)
        .zip(planes.par_chunks(width))
        .for_each(|(out, row)| {
            for (out, kernel) in out.iter_mut().zip(&columns.0) {
                let near = row[kernel.first..].iter().zip(&kernel.weights);
                *out = near.map(|(x, w)| x * w).sum();
            }
        });
    let mut out = vec![0.0f32; planes_count * to_height * to_width];
    out.par_chunks_mut(to_width)
        .enumerate()
        .for_each(|(i, out)| {
            let (plane, y) = (i / to_height, i % to_height);
            let kernel = &rows.0[y];
            let near = narrow[(plane * height + kernel.first) * to_width..].chunks_exact(to_width);
            for (row, &weight) in near.zip(&kernel.weights) {
                for (out, x) in out.iter_mut().zip(row) {
                    *out += x * weight;
                }
            }
        });
    out
}

/// Planes `[n][height][width]` of the size `from` in the size `to` (width, height), bilinear
/// without antialiasing.
pub fn bilinear(planes: &[f32], from: (usize, usize), to: (usize, usize)) -> Vec<f32> {
    resampled(
        planes,
        from.0,
        from.1,
        &Kernels::linear(from.0, to.0),
        &Kernels::linear(from.1, to.1),
    )
}

/// `plane` in another `size`, bilinear without antialiasing.
pub fn bilinear_plane(plane: &Plane<f32>, size: (usize, usize)) -> Plane<f32> {
    let values = bilinear(plane.data(), plane.size(), size);
    Plane::from_fn(size.0, size.1, |x, y| values[y * size.0 + x])
}

/// `image` in `size` by `kernels`, less `mean`, divided by `std`: `[1, 3, height, width]`.
pub fn image_tensor(
    image: &RgbImage,
    (width, height): (usize, usize),
    kernels: fn(usize, usize) -> Kernels,
    [mean, std]: [[f32; 3]; 2],
    device: &Device,
) -> Tensor<4> {
    let (w, h) = image.size();
    let values = resampled(
        &planes(image, mean, std),
        w,
        h,
        &kernels(w, width),
        &kernels(h, height),
    );
    tensor(values, [1, 3, height, width], device)
}

#[cfg(test)]
mod tests {
    use super::{Kernels, resampled};
    use crate::fixture::{Fixture, relative_error};

    type Flavour = fn(usize, usize) -> Kernels;

    /// Every flavour against the library it is named after: smaller, half, larger.
    #[test]
    fn agrees_with_pytorch_and_opencv() {
        let fixture = Fixture::open("ops/resize.safetensors");
        let (map, _) = fixture.floats("map");
        let (h, w) = (37, 53);
        let flavours: [(&str, Flavour); 5] = [
            ("cv2_cubic_f32", Kernels::cubic),
            ("torch_bicubic", Kernels::cubic),
            ("torch_bilinear", Kernels::linear),
            ("torch_bilinear_aa", Kernels::triangle),
            ("cv2_linear_f32", Kernels::linear),
        ];
        for (name, kernels) in flavours {
            for size in ["down", "half", "up"] {
                let name = format!("{name}_{size}");
                let (want, shape) = fixture.floats(&name);
                let got = resampled(&map, w, h, &kernels(w, shape[1]), &kernels(h, shape[0]));
                let error = relative_error(&got, &want);
                assert!(error < 2e-6, "{name}: {error:e}");
            }
        }
        let (want, shape) = fixture.floats("torch_bicubic_scale_posembed");
        // with scale factors, 12.1 / 37 of the rows and 9.1 / 37 of the columns
        let columns = Kernels::cubic_by_step(w, shape[1], 37.0 / 9.1);
        let rows = Kernels::cubic_by_step(h, shape[0], 37.0 / 12.1);
        let got = resampled(&map, w, h, &columns, &rows);
        let error = relative_error(&got, &want);
        assert!(error < 1e-5, "positions: {error:e}");
    }

    #[test]
    fn resampling_matches_the_matrix_form() {
        let (w, h) = (5, 4);
        let plane: Vec<f32> = (0..20).map(|i| ((i * i * 7) % 19) as f32).collect();
        let other: Vec<f32> = plane.iter().map(|x| 3.0 - x).collect();
        let (columns, rows) = (Kernels::cubic(w, 9), Kernels::triangle(h, 2));
        let both = [plane.clone(), other.clone()].concat();
        let both = resampled(&both, w, h, &columns, &rows);
        assert_eq!(both[..18], resampled(&plane, w, h, &columns, &rows));
        assert_eq!(both[18..], resampled(&other, w, h, &columns, &rows));
        let (across, down) = (columns.matrix(w), rows.matrix(h));
        for (i, got) in both[..18].iter().enumerate() {
            let (x, y) = (i % 9, i / 9);
            let want: f32 = (0..20)
                .map(|j| plane[j] * across[x * w + j % w] * down[y * h + j / w])
                .sum();
            assert!((got - want).abs() < 1e-4, "{x}, {y}: {got} for {want}");
        }
        assert!(resampled(&[], 0, 0, &columns, &rows).is_empty());
    }
}
