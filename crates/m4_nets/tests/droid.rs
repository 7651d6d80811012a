//! MegaSaM's tracking network: its checkpoint and its images.

use crate::common::real_weights;
use m4_core::{Plane, RgbImage};
use m4_nets::droid::{DroidMemory, MemoryOptions, Storage};
use m4_nets::{DroidNet, LoadError, cpu};
use m4_testkit::write_formula_weights;
use std::path::Path;
use std::sync::Arc;
use tempfile::TempDir;

const KEYS: &str = include_str!("../../../fixtures/droid/keys.txt");

fn load(folder: &Path, keys: &str) -> Result<DroidNet, LoadError> {
    let path = folder.join("weights.safetensors");
    write_formula_weights(keys, &path);
    DroidNet::load(&path, cpu())
}

fn test_image(w: usize, h: usize, moved: f32) -> RgbImage {
    Plane::from_fn(w, h, |x, y| {
        let (x, y) = (x as f32 + moved, y as f32);
        [0.31, 0.17, 0.07].map(|f: f32| (127.0 + 90.0 * (x * f).sin() * (y * f * 0.7).cos()) as u8)
    })
}

/// A memory whose frame 0 has the first size and all others the second.
fn memory_of(net: DroidNet, first: (usize, usize), later: (usize, usize)) -> DroidMemory<'static> {
    let options = MemoryOptions {
        budget_bytes: 1 << 30,
        storage: Storage::F16,
        scratch: std::env::temp_dir(),
    };
    let images = move |frame: usize| {
        let (w, h) = if frame == 0 { first } else { later };
        Ok(test_image(w, h, frame as f32))
    };
    DroidMemory::new(Arc::new(net), options, Box::new(images))
}

fn memory(net: DroidNet) -> DroidMemory<'static> {
    memory_of(net, (136, 128), (136, 128))
}

/// The published file has a third row of weights and steps, which is not used.
#[test]
fn third_rows_change_nothing() {
    let folder = TempDir::new().unwrap();
    let motion = |keys: &str| {
        memory(load(folder.path(), keys).unwrap())
            .motion_px(0, 4)
            .unwrap()
    };
    let three = [
        "weight.2.weight 2",
        "weight.2.bias 2",
        "delta.2.weight 2",
        "delta.2.bias 2",
    ];
    let three = three.iter().fold(KEYS.to_owned(), |keys, line| {
        let with = format!("{}3", line.strip_suffix('2').unwrap());
        keys.replace(&format!("update.{line}"), &format!("update.{with}"))
    });
    assert_ne!(three, KEYS);
    let two = motion(KEYS);
    assert!(two > 0.0);
    assert_eq!(two, motion(&three));
}

#[test]
fn images_of_wrong_size_are_refused() {
    let folder = TempDir::new().unwrap();
    let error = |first, later| {
        let net = load(folder.path(), KEYS).unwrap();
        memory_of(net, first, later)
            .motion_px(0, 1)
            .unwrap_err()
            .to_string()
    };
    for (w, h) in [(0, 0), (120, 200), (200, 120), (132, 128), (128, 129)] {
        let error = error((w, h), (136, 128));
        assert!(error.contains(&format!("this has {w} x {h}")), "{error}");
    }
    let error = error((136, 128), (128, 128));
    assert!(
        error.contains("frame 1 has 128 x 128 px where the frames before have 136 x 128"),
        "{error}"
    );
}

/// The published file itself, where it is.
#[test]
fn takes_the_published_file() {
    let Some(path) = real_weights("megasam", "megasam_final.pth") else {
        return;
    };
    let net = DroidNet::load(&path, cpu()).unwrap();
    let motion = memory(net).motion_px(0, 4).unwrap();
    assert!(motion.is_finite() && motion > 0.0, "{motion}");
}
