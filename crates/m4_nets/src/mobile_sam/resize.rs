//! Pictures in another size as Pillow's bilinear filter makes them, which SAM was trained with: a triangle that is as wide as a
//! new pixel where pictures become smaller, along rows and then along columns, rounded to bytes after each. In whole numbers, as
//! Pillow's, so that the bytes are the same.

use m4_scene::{Plane, RgbImage};
use rayon::prelude::*;

/// Binary digits of weights behind the point.
const DIGITS: u32 = 22;

/// The pixels that a new one is made of: the first of them, and weights that sum to one.
struct Window {
    first: usize,
    weights: Vec<u32>,
}

fn windows(from: usize, to: usize) -> Vec<Window> {
    let scale = from as f64 / to as f64;
    let reach = scale.max(1.0);
    let one = f64::from(1u32 << DIGITS);
    let of = |i: usize| {
        let centre = (i as f64 + 0.5) * scale;
        let first = (centre - reach + 0.5).max(0.0) as usize;
        let end = ((centre + reach + 0.5) as usize).min(from);
        let weight = |j: usize| (1.0 - ((j as f64 + 0.5 - centre) / reach).abs()).max(0.0);
        let weights: Vec<f64> = (first..end).map(weight).collect();
        let sum: f64 = weights.iter().sum();
        Window {
            first,
            weights: weights.iter().map(|w| (w / sum * one + 0.5) as u32).collect(),
        }
    };
    (0..to).map(of).collect()
}

/// The weighted mean of pixels, rounded to bytes.
fn mixed<'a>(weights: &[u32], pixels: impl Iterator<Item = &'a [u8; 3]>) -> [u8; 3] {
    let mut sum = [1u32 << (DIGITS - 1); 3];
    for (weight, pixel) in weights.iter().zip(pixels) {
        for (sum, &value) in sum.iter_mut().zip(pixel) {
            *sum += weight * u32::from(value);
        }
    }
    sum.map(|sum| (sum >> DIGITS).min(255) as u8)
}

/// `image`, which has pixels, with `width` columns and `height` rows, of which it has at least one.
pub fn resized(image: &RgbImage, width: usize, height: usize) -> RgbImage {
    let narrow = along_rows(image, width);
    let rows = windows(image.height(), height);
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

fn along_rows(image: &RgbImage, width: usize) -> RgbImage {
    let columns = windows(image.width(), width);
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
    use super::resized;
    use m4_scene::RgbImage;
    use safetensors::SafeTensors;

    fn picture(name: &str) -> RgbImage {
        let file = include_bytes!("../../../../fixtures/mobile_sam/resize.safetensors");
        let tensors = SafeTensors::deserialize(file).unwrap();
        let tensor = tensors.tensor(name).unwrap();
        let [h, w, 3] = tensor.shape() else {
            panic!("{name} is no picture");
        };
        RgbImage::from_vec(*w, *h, tensor.data().as_chunks::<3>().0.to_vec()).unwrap()
    }

    #[test]
    fn agrees_with_pillow() {
        let image = picture("image");
        for (w, h) in [(150, 97), (40, 26), (97, 20), (13, 63)] {
            let want = picture(&format!("{w}x{h}"));
            let got = resized(&image, w, h);
            assert_eq!(got.size(), want.size());
            let other = got.data().as_flattened().iter().zip(want.data().as_flattened());
            let other = other.filter(|(a, b)| a != b).count();
            assert_eq!(other, 0, "{w} x {h}: {other} of {} bytes differ", 3 * w * h);
        }
        assert_eq!(resized(&image, 97, 63), image);
    }
}
