//! Against the authors' module, with synthetic weights (the backbone of Depth-Anything's fixtures).

use super::{BackboneSize, DinoV2, OFFSET, Tap, resized, unneeded};
use crate::cpu;
use crate::fixture::{Fixture, assert_near, every, fill_by_formula, normalised, of_first_blocks};
use m4_testkit::FormulaWeights;

const SMALL: &str = include_str!("../../../../fixtures/depth_anything_v1/vits.keys.txt");
const LARGE: &str = include_str!("../../../../fixtures/depth_anything_v1/vitl.keys.txt");
const PREFIX: &str = "pretrained.";
const RENAMES: [(&str, &str); 1] = [(r"^pretrained\.", "")];
/// Relative error that the fixture allows; PyTorch's own in 32 bits is 2e-6.
const LIMIT: f64 = 5e-5;

/// The lines of `keys` of a backbone with `depth` blocks.
fn backbone_keys(keys: &str, depth: usize) -> String {
    let lines = of_first_blocks(keys, depth);
    lines
        .lines()
        .filter(|line| line.starts_with(PREFIX))
        .map(|line| format!("{line}\n"))
        .collect()
}

fn backbone(size: BackboneSize, keys: &str, depth: usize) -> DinoV2 {
    let mut net = DinoV2::with_depth(size, depth, &cpu());
    let weights = FormulaWeights::of_keys(&backbone_keys(keys, depth));
    fill_by_formula(&mut net, &weights, &RENAMES, unneeded);
    net
}

/// The last four blocks, the positions and the first block; `step` channels apart in the fixture.
fn check(net: &DinoV2, fixture: &Fixture, step: usize) {
    let image = normalised(&fixture.image("image"), &cpu());
    let positions = resized(net.pos_embed.val(), 9, 12, OFFSET).squeeze_dim(0);
    assert_near(
        every(positions, step),
        fixture,
        "pos_embed_resized_strided",
        LIMIT,
    );
    let first = net.blocks[0]
        .forward(net.tokens(image.clone()))
        .squeeze_dim(0);
    assert_near(every(first, step), fixture, "block0_out_strided", LIMIT);
    let depth = net.depth();
    let taps: [usize; 4] = std::array::from_fn(|i| depth - 4 + i);
    for (i, Tap { patches, class }) in net.taps(image, taps).into_iter().enumerate() {
        let patches = every(patches.squeeze_dim(0), step);
        assert_near(patches, fixture, &format!("tap{i}_tokens_strided"), LIMIT);
        assert_near(class, fixture, &format!("tap{i}_cls"), LIMIT);
    }
}

#[test]
fn small_model_matches_the_module() {
    let net = backbone(BackboneSize::Small, SMALL, 12);
    check(
        &net,
        &Fixture::open("depth_anything_v1/vits.safetensors"),
        4,
    );
}

#[test]
fn five_blocks_of_the_large_model_match_the_module() {
    let net = backbone(BackboneSize::Large, LARGE, 5);
    check(
        &net,
        &Fixture::open("depth_anything_v1/vitl_5blocks.safetensors"),
        16,
    );
}

/// Where the grid is the one that was learned, nothing is resampled.
#[test]
fn position_embeddings_of_the_trained_size_are_unchanged() {
    let net = backbone(BackboneSize::Small, SMALL, 1);
    let learned: Vec<f32> = net.pos_embed.val().try_into_vec_as().unwrap();
    let same: Vec<f32> = resized(net.pos_embed.val(), 37, 37, OFFSET)
        .try_into_vec_as()
        .unwrap();
    assert_eq!(learned, same);
}

/// Many queries are answered some at a time: an image of 390 patches and the same as half of a
/// batch.
#[test]
fn a_batch_equals_its_images() {
    let net = backbone(BackboneSize::Small, SMALL, 2);
    let image = m4_core::RgbImage::from_fn(14 * 26, 14 * 15, |x, y| {
        [x as u8, y as u8, (x * y / 7) as u8]
    });
    let one = normalised(&image, &cpu());
    let flipped = one.clone().flip([3]);
    let both = burn_core::tensor::Tensor::cat(vec![flipped, one.clone()], 0);
    let numbers = |tap: &Tap, at: usize| -> Vec<f32> {
        tap.patches
            .clone()
            .narrow(0, at, 1)
            .try_into_vec_as()
            .unwrap()
    };
    let one = net.taps(one, [0, 1]);
    let both = net.taps(both, [0, 1]);
    for (one, both) in one.iter().zip(&both) {
        let error = crate::fixture::relative_error(&numbers(both, 1), &numbers(one, 0));
        assert!(error < 1e-5, "{error:e}");
        assert!(numbers(both, 0) != numbers(one, 0));
    }
}
