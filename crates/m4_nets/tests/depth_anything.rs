//! Depth-Anything V1 as it is called: checkpoints, images of any size, threads. Its layers are compared with the authors' module in
//! the crate's own tests.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::test_image;
use m4_core::{Plane, RgbImage};
use m4_nets::{BackboneSize, DepthAnything, DisparityError, LoadError, cpu};
use m4_testkit::{FormulaWeights, write_formula_weights};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use tempfile::TempDir;

const KEYS: &str = include_str!("../../../fixtures/depth_anything_v1/vits.keys.txt");
/// The last number of the network: most of the disparity is above 0 then, and some is not.
const LAST: &str = "depth_head.scratch.output_conv2.2.bias";

/// A checkpoint with weights by the formula, made once.
fn formula_weights() -> PathBuf {
    static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
        let folder = TempDir::new().unwrap();
        let weights = FormulaWeights::of_keys(KEYS).with(LAST, &[2.5]);
        weights.write(&folder.path().join("depth-anything-v1-l.safetensors"));
        folder
    });
    FOLDER.path().join("depth-anything-v1-l.safetensors")
}

fn network() -> DepthAnything {
    DepthAnything::load(&formula_weights(), cpu()).unwrap()
}

/// A name says nothing about what a file holds: this one says L.
#[test]
fn size_is_read_from_the_checkpoint() {
    let net = network();
    assert_eq!(net.size(), BackboneSize::Small);
    // the checkpoint's 24,785,089 numbers without the token that training needed
    assert_eq!(net.parameters(), 24_785_089 - 384);
}

#[test]
fn disparity_has_the_size_of_the_image_and_is_independent_of_threads() {
    let net = network();
    let image = test_image(301, 43);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| net.disparity(&image).unwrap())
    };
    let one = with(1);
    assert_eq!(one.size(), (301, 43));
    assert!(one.data().iter().all(|&d| d >= 0.0 && d.is_finite()));
    let positive = one.data().iter().filter(|&&d| d > 0.0).count();
    assert!(positive > one.data().len() / 2, "{positive} of {} above 0", one.data().len());
    let (least, most) = one.data().iter().fold((f32::MAX, 0.0f32), |(a, b), &d| (a.min(d), b.max(d)));
    assert!(most > 1.2 * least, "hardly anything but a constant: {least} to {most}");
    assert_eq!(one, with(2));
    assert_eq!(one, with(5));
}

#[test]
fn images_of_odd_sizes_have_a_disparity() {
    let net = network();
    for (w, h) in [(1, 40), (700, 1), (15, 200)] {
        let disparity = net.disparity(&test_image(w, h)).unwrap();
        assert_eq!(disparity.size(), (w, h));
        assert!(disparity.data().iter().all(|d| d.is_finite()));
    }
    let none: RgbImage = Plane::filled(0, 4, [9, 9, 9]);
    assert!(matches!(net.disparity(&none), Err(DisparityError::Empty)));
}

fn refused(path: &Path) -> LoadError {
    match DepthAnything::load(path, cpu()) {
        Ok(_) => panic!("it was loaded"),
        Err(error) => error,
    }
}

#[test]
fn a_checkpoint_is_read_strictly() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("weights.safetensors");
    let load = |list: &str| {
        write_formula_weights(list, &path);
        refused(&path).to_string()
    };
    let without = |part: &str| -> String {
        let kept = KEYS.lines().filter(|line| !line.contains(part));
        kept.map(|line| format!("{line}\n")).collect()
    };
    let error = load(&without("blocks.11.norm2.bias"));
    assert!(error.contains("1 tensors are missing (pretrained.blocks.11.norm2."), "{error}");
    let error = load(&without("cls_token"));
    assert!(error.contains("pretrained.cls_token"), "{error}");
    let error = load(&format!("{KEYS}pretrained.register_tokens 1 4 384\n"));
    assert!(error.contains("pretrained.register_tokens"), "{error}");
    let error = load("pretrained.cls_token 1 1 1536\n");
    assert!(error.contains("1536") && error.contains("1024 of ViT-L"), "{error}");
    // widths of a large backbone and the head of a small one
    let error = load(&KEYS.replace("cls_token 1 1 384", "cls_token 1 1 768"));
    assert!(error.contains("do not fit"), "{error}");
    let text = folder.path().join("text.pth");
    fs::write(&text, "no checkpoint at all").unwrap();
    assert!(matches!(refused(&text), LoadError::Unreadable { .. }));
    assert!(matches!(refused(&folder.path().join("none.pth")), LoadError::Missing { .. }));
}
