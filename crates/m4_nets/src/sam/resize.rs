//! Images in another size as Pillow's filters make them, which SAM was trained with: a function that is as wide as a new pixel
//! where images become smaller, along rows and then along columns, rounded to bytes after each. In whole numbers, as Pillow's, so
//! that the bytes are the same.

use m4_core::{Plane, RgbImage};
use rayon::prelude::*;

/// Binary digits of weights behind the point.
const DIGITS: u32 = 22;

/// How a new pixel weighs the old ones around it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Filter {
    /// Linear to both sides: `BILINEAR`.
    Triangle,
    /// The cubic of Keys with a = -0.5: `BICUBIC`, the default of `resize`.
    Cubic,
}

impl Filter {
    /// Pixels to each side.
    fn reach(self) -> f64 {
        match self {
            Self::Triangle => 1.0,
            Self::Cubic => 2.0,
        }
    }

    /// The weight at a distance.
    fn weight(self, x: f64) -> f64 {
        let x = x.abs();
        match self {
            Self::Triangle => (1.0 - x).max(0.0),
            Self::Cubic if x < 1.0 => (1.5 * x - 2.5) * x * x + 1.0,
            Self::Cubic if x < 2.0 => ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0,
            Self::Cubic => 0.0,
        }
    }
}

/// The pixels that a new one is made of: the first of them, and weights that sum to one.
struct Window {
    first: usize,
    weights: Vec<i32>,
}

fn windows(filter: Filter, from: usize, to: usize) -> Vec<Window> {
    let scale = from as f64 / to as f64;
    let wide = scale.max(1.0);
    let reach = filter.reach() * wide;
    let one = f64::from(1i32 << DIGITS);
    let of = |i: usize| {
        let centre = (i as f64 + 0.5) * scale;
        let first = (centre - reach + 0.5).max(0.0) as usize;
        let end = ((centre + reach + 0.5) as usize).min(from);
        let weight = |j: usize| filter.weight((j as f64 + 0.5 - centre) / wide);
        let weights: Vec<f64> = (first..end).map(weight).collect();
        let sum: f64 = weights.iter().sum();
        Window {
            first,
            weights: weights.iter().map(|w| (w / sum * one).round() as i32).collect(),
        }
    };
    (0..to).map(of).collect()
}

/// The weighted mean of pixels, rounded to bytes.
fn mixed<'a>(weights: &[i32], pixels: impl Iterator<Item = &'a [u8; 3]>) -> [u8; 3] {
    let mut sum = [1i32 << (DIGITS - 1); 3];
    for (weight, pixel) in weights.iter().zip(pixels) {
        for (sum, &value) in sum.iter_mut().zip(pixel) {
            *sum += weight * i32::from(value);
        }
    }
    sum.map(|sum| (sum >> DIGITS).clamp(0, 255) as u8)
}

/// `image`, which has pixels, with `width` columns and `height` rows, of which it has at least one.
pub fn resized(image: &RgbImage, width: usize, height: usize, filter: Filter) -> RgbImage {
    let narrow = along_rows(image, width, filter);
    let rows = windows(filter, image.height(), height);
    let mut out = Plane::filled(width, height, [0; 3]);
    out.data_mut()
        .par_chunks_mut(width)
        .zip(&rows)
        .for_each(|(out, window)| {
            for (x, pixel) in out.iter_mut().enumerate() {
                let above = (window.first..).map(|y| &narrow[(x, y)]);
                *pixel = mixed(&window.weights, above);
            }
        });
    out
}

fn along_rows(image: &RgbImage, width: usize, filter: Filter) -> RgbImage {
    let columns = windows(filter, image.width(), width);
    let mut out = Plane::filled(width, image.height(), [0; 3]);
    out.data_mut().par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        let row = image.row(y);
        for (pixel, window) in out.iter_mut().zip(&columns) {
            *pixel = mixed(&window.weights, row[window.first..].iter());
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::{Filter, resized};
    use m4_core::RgbImage;
    use safetensors::SafeTensors;

    fn read_image(file: &[u8], name: &str) -> RgbImage {
        let tensors = SafeTensors::deserialize(file).unwrap();
        let tensor = tensors.tensor(name).unwrap();
        let [h, w, 3] = tensor.shape() else {
            panic!("{name} is not an image");
        };
        RgbImage::from_vec(*w, *h, tensor.data().as_chunks::<3>().0.to_vec()).unwrap()
    }

    #[track_caller]
    fn assert_same(got: &RgbImage, want: &RgbImage) {
        assert_eq!(got.size(), want.size());
        let other = got.data().as_flattened().iter().zip(want.data().as_flattened());
        let other = other.filter(|(a, b)| a != b).count();
        assert_eq!(other, 0, "{other} bytes of {:?} pixels differ", want.size());
    }

    #[test]
    fn agrees_with_pillow() {
        let file = include_bytes!("../../../../fixtures/mobile_sam/resize.safetensors");
        let image = read_image(file, "image");
        for (w, h) in [(150, 97), (40, 26), (97, 20), (13, 63)] {
            let want = read_image(file, &format!("{w}x{h}"));
            assert_same(&resized(&image, w, h, Filter::Triangle), &want);
        }
        let file = include_bytes!("../../../../fixtures/ops/resize.safetensors");
        let cubic = read_image(file, "image_u8");
        for size in ["down", "half", "up"] {
            let want = read_image(file, &format!("pil_bicubic_u8_{size}"));
            let (w, h) = want.size();
            assert_same(&resized(&cubic, w, h, Filter::Cubic), &want);
        }
        for filter in [Filter::Triangle, Filter::Cubic] {
            assert_eq!(resized(&image, 97, 63, filter), image);
        }
    }
}
