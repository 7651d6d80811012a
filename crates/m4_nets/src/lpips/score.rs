//! The result of a comparison.

use super::LpipsError;
use super::image::same_size;
use crate::ops::{Kernels, resampled};
use burn_core::tensor::Tensor;
use m4_core::{Mask, Plane};

/// How different two images look.
#[derive(Debug, Clone, PartialEq)]
pub struct LpipsScore {
    /// The distance, 0 for equal images: upstream's default output.
    pub distance: f64,
    /// The same where it comes from, `[height][width]` of the images: upstream's output with `spatial=True`.
    pub map: Plane<f32>,
}

impl LpipsScore {
    /// Of the differences of the layers, `[1, 1, h, w]` each.
    pub(super) fn of(layers: [Tensor<4>; 5], (width, height): (usize, usize)) -> Result<Self, LpipsError> {
        let mut distance = 0.0;
        let mut map = vec![0.0f32; width * height];
        for layer in layers {
            let [_, _, h, w] = layer.dims();
            let values: Vec<f32> = layer.try_into_vec_as().map_err(|error| LpipsError::Device(error.to_string()))?;
            distance += values.iter().copied().map(f64::from).sum::<f64>() / values.len() as f64;
            let enlarged = resampled(&values, w, h, &Kernels::linear(w, width), &Kernels::linear(h, height));
            for (sum, value) in map.iter_mut().zip(enlarged) {
                *sum += value;
            }
        }
        let map = Plane::from_fn(width, height, |x, y| map[y * width + x]);
        Ok(Self { distance, map })
    }

    /// The mean of the map where `mask` is not 0; `None` where it is 0 everywhere. DyCheck's masked distance also blacks the rest
    /// out before the network sees it: [`Lpips::compare_inside`](super::Lpips::compare_inside).
    ///
    /// # Errors
    ///
    /// [`LpipsError::Size`] if the mask has another size.
    pub fn mean_inside(&self, mask: &Mask) -> Result<Option<f64>, LpipsError> {
        same_size("the mask", self.map.size(), mask.size())?;
        let pairs = self.map.data().iter().zip(mask.data());
        let (sum, count) =
            pairs.filter(|&(_, &m)| m != 0).fold((0.0, 0usize), |(sum, n), (&v, _)| (sum + f64::from(v), n + 1));
        Ok((count > 0).then(|| sum / count as f64))
    }
}
