//! Depth-Anything V1 as it is called: images of any size, threads. Its layers are compared with the
//! authors' module in the crate.

use crate::common::{loaded, test_image};
use m4_nets::{DepthAnything, cpu};
use m4_testkit::{FormulaWeights, same_on_any_threads};

const KEYS: &str = include_str!("../../../fixtures/depth_anything_v1/vits.keys.txt");
/// The last number of the network: most of the disparity is above 0 then, and some is not.
const LAST: &str = "depth_head.scratch.output_conv2.2.bias";

fn network() -> DepthAnything {
    loaded(&FormulaWeights::of_keys(KEYS).with(LAST, &[2.5]), |path| {
        DepthAnything::load(path, cpu())
    })
}

#[test]
fn disparity_has_the_size_of_the_image_and_is_independent_of_threads() {
    let net = network();
    let image = test_image(301, 43);
    let one = same_on_any_threads(|| net.disparity(&image).unwrap());
    assert_eq!(one.size(), (301, 43));
    assert!(one.data().iter().all(|&d| d >= 0.0 && d.is_finite()));
    let positive = one.data().iter().filter(|&&d| d > 0.0).count();
    assert!(
        positive > one.data().len() / 2,
        "{positive} of {} above 0",
        one.data().len()
    );
    let (least, most) = one
        .data()
        .iter()
        .fold((f32::MAX, 0.0f32), |(a, b), &d| (a.min(d), b.max(d)));
    assert!(
        most > 1.2 * least,
        "hardly anything but a constant: {least} to {most}"
    );
}

#[test]
fn images_of_odd_sizes_have_a_disparity() {
    let net = network();
    for (w, h) in [(1, 40), (700, 1), (15, 200)] {
        let disparity = net.disparity(&test_image(w, h)).unwrap();
        assert_eq!(disparity.size(), (w, h));
        assert!(disparity.data().iter().all(|d| d.is_finite()));
    }
    let error = net.disparity(&test_image(0, 4)).unwrap_err();
    assert!(error.to_string().contains("pixels"), "{error}");
}
