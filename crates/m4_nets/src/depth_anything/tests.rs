//! Against the authors' module, with synthetic weights.

use super::head::RENAMES;
use super::{Net, Sides};
use crate::cpu;
use crate::dinov2::{BackboneSize, unneeded};
use crate::fixture::{
    Fixture, assert_near, assert_same_tensors, every_map, fill_by_formula, normalised,
    of_first_blocks,
};
use burn_core::tensor::activation::relu;
use m4_testkit::FormulaWeights;

const SMALL: &str = include_str!("../../../../fixtures/depth_anything_v1/vits.keys.txt");
const BASE: &str = include_str!("../../../../fixtures/depth_anything_v1/vitb.keys.txt");
const LARGE: &str = include_str!("../../../../fixtures/depth_anything_v1/vitl.keys.txt");
/// Relative error that the fixture allows; PyTorch's own in 32 bits is 2e-6.
const LIMIT: f64 = 5e-5;
const GRID: [usize; 2] = [9, 12];

fn check(size: BackboneSize, keys: &str, depth: usize, fixture: &Fixture) {
    let mut net = Net::new(size, depth, &cpu());
    let weights = FormulaWeights::of_keys(&of_first_blocks(keys, depth));
    let weights = weights.with("depth_head.scratch.output_conv2.2.bias", &[1.4]);
    fill_by_formula(&mut net, &weights, &RENAMES, unneeded);
    let image = normalised(&fixture.image("image"), &cpu());
    let taps: [usize; 4] = std::array::from_fn(|i| depth - 4 + i);
    let maps = net.pretrained.taps(image.clone(), taps);
    let [path4, path3] = net.depth_head.coarse_paths(maps, GRID);
    assert_near(every_map(path4, 4), fixture, "path4_strided", LIMIT);
    assert_near(every_map(path3, 4), fixture, "path3_strided", LIMIT);
    let logits = net.logits(image);
    assert_near(logits.clone(), fixture, "head_logits", LIMIT);
    let least: f32 = logits.clone().min().into_scalar();
    assert!(least < 0.0, "the last step has nothing to do");
    assert_near(relu(logits), fixture, "disparity", LIMIT);
}

#[test]
fn small_model_matches_the_module() {
    let fixture = Fixture::open("depth_anything_v1/vits.safetensors");
    check(BackboneSize::Small, SMALL, 12, &fixture);
}

#[test]
fn large_model_with_five_blocks_matches_the_module() {
    let fixture = Fixture::open("depth_anything_v1/vitl_5blocks.safetensors");
    check(BackboneSize::Large, LARGE, 5, &fixture);
}

/// The names and shapes of the module are those of the official checkpoints, nothing less and
/// nothing more.
#[test]
fn each_size_has_exactly_the_tensors_of_its_checkpoint() {
    for (size, keys) in [
        (BackboneSize::Small, SMALL),
        (BackboneSize::Base, BASE),
        (BackboneSize::Large, LARGE),
    ] {
        let net = Net::new(size, size.depth(), &cpu());
        assert_same_tensors(&net, keys, &RENAMES, unneeded);
    }
}

/// The table of `fixtures/ops/size_rules`: width and height, then those inside.
#[test]
fn sides_are_those_of_the_reference() {
    let table = [
        (854, 480, 756, 434),
        (480, 854, 434, 756),
        (1920, 1080, 756, 434),
        (640, 480, 756, 574),
        (1024, 768, 756, 574),
        (512, 512, 756, 756),
        (360, 640, 434, 756),
        (1280, 720, 756, 434),
        (333, 777, 336, 756),
        (500, 375, 756, 574),
    ];
    for (w, h, width, height) in table {
        assert_eq!(
            Sides::of((w, h)).unwrap().inside(),
            (width, height),
            "{w} x {h}"
        );
    }
    assert_eq!(Sides::of((100_000, 1)).unwrap().inside(), (756, 14));
    assert!(Sides::of((0, 4)).is_err());
}

/// A constant stays one, and a slope goes to the image's size and keeps its ends.
#[test]
fn disparity_is_resized_to_the_image() {
    let sides = Sides::of((300, 200)).unwrap();
    let (w, h) = sides.inside();
    let slope: Vec<f32> = (0..w * h).map(|i| (i % w) as f32 + 0.5).collect();
    let back = sides.to_image(&slope);
    assert_eq!(back.size(), (300, 200));
    let want = 150.5 * w as f32 / 300.0;
    assert!(
        (back[(150, 70)] - want).abs() < 1e-3,
        "{} for {want}",
        back[(150, 70)]
    );
}
