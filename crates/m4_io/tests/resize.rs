//! Resized images agree with those of Pillow.

use m4_core::{ResizeFilter, RgbImage, resize_rgb};
use m4_testkit::Fixture;

#[track_caller]
fn assert_same(image: &RgbImage, want: &RgbImage, filter: ResizeFilter) {
    let got = resize_rgb(image, want.width(), want.height(), filter).unwrap();
    let other = got
        .data()
        .as_flattened()
        .iter()
        .zip(want.data().as_flattened());
    let other = other.filter(|(a, b)| a != b).count();
    assert_eq!(other, 0, "{other} bytes of {:?} pixels differ", want.size());
}

#[test]
fn bytes_are_those_of_pillow() {
    let file = Fixture::open("mobile_sam/resize.safetensors");
    let image = file.image("image");
    for size in ["150x97", "40x26", "97x20", "13x63"] {
        assert_same(&image, &file.image(size), ResizeFilter::Triangle);
    }
    for filter in [ResizeFilter::Triangle, ResizeFilter::Cubic] {
        assert_same(&image, &image, filter);
    }
    let file = Fixture::open("ops/resize.safetensors");
    let cubic = file.image("image_u8");
    for size in ["down", "half", "up"] {
        assert_same(
            &cubic,
            &file.image(&format!("pil_bicubic_u8_{size}")),
            ResizeFilter::Cubic,
        );
    }
}
