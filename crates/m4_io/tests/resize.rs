//! Resized images agree with those of Pillow.

use m4_core::{ResizeFilter, RgbImage, resize_rgb};
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
fn assert_same(image: &RgbImage, want: &RgbImage, filter: ResizeFilter) {
    let got = resize_rgb(image, want.width(), want.height(), filter).unwrap();
    let other = got.data().as_flattened().iter().zip(want.data().as_flattened());
    let other = other.filter(|(a, b)| a != b).count();
    assert_eq!(other, 0, "{other} bytes of {:?} pixels differ", want.size());
}

#[test]
fn bytes_are_those_of_pillow() {
    let file = include_bytes!("../../../fixtures/mobile_sam/resize.safetensors");
    let image = read_image(file, "image");
    for size in ["150x97", "40x26", "97x20", "13x63"] {
        assert_same(&image, &read_image(file, size), ResizeFilter::Triangle);
    }
    for filter in [ResizeFilter::Triangle, ResizeFilter::Cubic] {
        assert_same(&image, &image, filter);
    }
    let file = include_bytes!("../../../fixtures/ops/resize.safetensors");
    let cubic = read_image(file, "image_u8");
    for size in ["down", "half", "up"] {
        assert_same(&cubic, &read_image(file, &format!("pil_bicubic_u8_{size}")), ResizeFilter::Cubic);
    }
}
