//! MoGe-2 as it is called: checkpoints, images of any size, options, threads. Its layers are
//! compared with the authors' module in the crate's own tests.

use crate::common::{loaded, test_image};
use m4_nets::{MoGe, MoGeOptions, NetError, cpu};
use m4_testkit::{FormulaWeights, same_on_any_threads};

const KEYS: &str = include_str!("../../../fixtures/moge2/vits_normal.keys.txt");

fn weights() -> FormulaWeights {
    FormulaWeights::of_keys(KEYS)
        .with("mask_head.output_blocks.4.bias", &[0.3])
        .scaled("points_head.output_blocks.4.weight", 0.3)
}

fn network() -> MoGe {
    loaded(&weights(), |path| MoGe::load(path, cpu()))
}

fn few(tokens: usize) -> MoGeOptions {
    MoGeOptions {
        tokens: Some(tokens),
        known_focal_px: None,
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let net = network();
    let image = test_image(201, 99);
    let one = same_on_any_threads(|| net.infer(&image, &few(150)).unwrap());
    assert_eq!(one.depth_m.size(), (201, 99));
    let valid = one.mask.data().iter().filter(|&&m| m).count();
    assert!(valid > 201 * 99 / 4, "{valid} valid");
    for (&z, &valid) in one.depth_m.data().iter().zip(one.mask.data()) {
        assert!(z.is_finite() && valid == (z > 0.0), "{z}");
    }
}

#[test]
fn known_focal_length_is_used() {
    let net = network();
    let image = test_image(60, 40);
    let options = MoGeOptions {
        known_focal_px: Some(70.0),
        ..few(24)
    };
    let map = net.infer(&image, &options).unwrap();
    assert_eq!(map.focal_px, 70.0);
    assert!((map.fov_x_rad - 2.0 * (30.0f64 / 70.0).atan()).abs() < 1e-12);
    let free = net.infer(&image, &few(24)).unwrap();
    assert!(free.focal_px > 0.0 && free.focal_px != 70.0);
    for wrong in [0.0, -3.0, f64::NAN, f64::INFINITY] {
        let options = MoGeOptions {
            known_focal_px: Some(wrong),
            ..few(24)
        };
        let error = net.infer(&image, &options).unwrap_err();
        assert!(
            error
                .to_string()
                .contains("a focal length is a positive number"),
            "{error}"
        );
    }
}

#[test]
fn odd_sizes_and_options() {
    let net = network();
    for (w, h) in [(1, 1), (1, 90), (400, 3)] {
        // an image of few pixels need not have a focal length
        match net.infer(&test_image(w, h), &few(20)) {
            Ok(map) => assert_eq!(map.depth_m.size(), (w, h)),
            Err(error) => assert!(matches!(error, NetError::NoDepth(_)), "{error}"),
        }
    }
    for (image, tokens, message) in [
        (test_image(4, 0), 20, "an image with pixels"),
        (test_image(9, 9), 0, "patches"),
    ] {
        let error = net.infer(&image, &few(tokens)).unwrap_err();
        assert!(error.to_string().contains(message), "{error}");
    }
}

/// A mask that is empty everywhere: nothing can be said of the image.
#[test]
fn an_image_without_depth_is_an_error() {
    let net = loaded(
        &weights().with("mask_head.output_blocks.4.bias", &[-50.0]),
        |path| MoGe::load(path, cpu()),
    );
    let error = net.infer(&test_image(40, 30), &few(12)).unwrap_err();
    assert!(
        matches!(error, NetError::NoDepth(_)) && error.to_string().contains("mask is empty"),
        "{error}"
    );
}
