//! Images as planes of numbers.

use m4_core::RgbImage;

/// Mean of red, green and blue that most weights were trained with (ImageNet's).
pub const IMAGENET_MEAN: [f32; 3] = [0.485, 0.456, 0.406];
/// Their standard deviation.
pub const IMAGENET_STD: [f32; 3] = [0.229, 0.224, 0.225];

/// Red, green and blue of `image` from 0 to 1, less `mean`, divided by `std`: `[3][height][width]`.
pub fn planes(image: &RgbImage, mean: [f32; 3], std: [f32; 3]) -> Vec<f32> {
    let plane = |c: usize| {
        let value = move |p: &[u8; 3]| (f32::from(p[c]) / 255.0 - mean[c]) / std[c];
        image.data().iter().map(value)
    };
    (0..3).flat_map(plane).collect()
}
