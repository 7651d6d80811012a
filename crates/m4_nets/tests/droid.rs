//! MegaSaM's tracking network: its checkpoint and its images.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use m4_core::{Plane, RgbImage};
use m4_nets::droid::{DroidMemory, MemoryOptions, Storage};
use m4_nets::{DroidError, DroidNet, LoadError, cpu};
use m4_testkit::{Need, skip, write_formula_weights};
use std::fs;
use std::path::Path;
use std::sync::Arc;
use tempfile::TempDir;

const KEYS: &str = include_str!("../../../fixtures/droid/keys.txt");
/// Numbers of the checkpoint, and of what only training used: `conv4`, `norm_4` and `eta` of the motion head.
const ALL: usize = 5_192_467;
const TRAINING: usize = (129 * 129 * 9 + 129) + 2 * 129 + (128 * 129 * 9 + 128) + (128 * 9 + 1);

fn numbers(keys: &str) -> usize {
    let size = |line: &str| -> usize {
        let shape = line.split_whitespace().skip(1);
        shape.map(|n| n.parse::<usize>().unwrap()).product()
    };
    keys.lines().map(size).sum()
}

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

fn memory(net: DroidNet) -> DroidMemory<'static> {
    let options = MemoryOptions { budget_bytes: 1 << 30, storage: Storage::F16, scratch: std::env::temp_dir() };
    let images = |frame: usize| Ok(test_image(136, 128, frame as f32));
    DroidMemory::new(Arc::new(net), options, Box::new(images))
}

#[test]
fn takes_exactly_the_published_keys() {
    assert_eq!((KEYS.lines().count(), numbers(KEYS)), (130, ALL));
    let folder = TempDir::new().unwrap();
    let net = load(folder.path(), KEYS).unwrap();
    assert_eq!(net.parameters(), ALL - TRAINING);
    for line in KEYS.lines() {
        let training = ["agg_motion.conv4", "agg_motion.norm_4", "agg_motion.eta"];
        let unneeded = training.iter().any(|name| line.contains(name));
        let without: String = KEYS.lines().filter(|l| *l != line).map(|l| format!("{l}\n")).collect();
        if !unneeded && line.contains("update.agg.") {
            let Err(LoadError::OtherNetwork { missing, .. }) = load(folder.path(), &without) else {
                panic!("{line} is missing and nothing was said");
            };
            assert_eq!(missing.len(), 1, "{line}");
        }
    }
    let Err(error) = load(folder.path(), &format!("{KEYS}update.head.weight 2 2\n")) else {
        panic!("a tensor is left over");
    };
    assert!(error.to_string().contains("update.head.weight"), "{error}");
}

/// The published file: a prefix, and a third row that is not used.
#[test]
fn takes_prefix_and_third_rows() {
    let folder = TempDir::new().unwrap();
    let plain = load(folder.path(), KEYS).unwrap();
    let path = folder.path().join("published.safetensors");
    let two = fs::read(folder.path().join("weights.safetensors")).unwrap();
    let two = safetensors::SafeTensors::deserialize(&two).unwrap();
    let published: Vec<(String, Vec<usize>, Vec<u8>)> = two
        .tensors()
        .into_iter()
        .map(|(name, view)| {
            let (mut shape, mut data) = (view.shape().to_vec(), view.data().to_vec());
            if name.starts_with("update.weight.2.") || name.starts_with("update.delta.2.") {
                let row = data.len() / 2;
                data.extend(vec![0x41; row]);
                shape[0] = 3;
            }
            (format!("module.{name}"), shape, data)
        })
        .collect();
    let views = published.iter().map(|(name, shape, data)| {
        let view = safetensors::tensor::TensorView::new(safetensors::Dtype::F32, shape.clone(), data).unwrap();
        (name.as_str(), view)
    });
    safetensors::serialize_to_file(views, None, &path).unwrap();
    let three = DroidNet::load(&path, cpu()).unwrap();
    assert_eq!(three.parameters(), plain.parameters());
    let (mut a, mut b) = (memory(plain), memory(three));
    let motion = a.motion_px(0, 4).unwrap();
    assert_eq!(motion, b.motion_px(0, 4).unwrap());
    assert!(motion > 0.0);
    // four rows are no checkpoint of it
    let four = KEYS.replace("update.delta.2.weight 2", "update.delta.2.weight 4");
    let Err(error) = load(folder.path(), &four) else {
        panic!("four rows");
    };
    assert!(error.to_string().contains("do not fit"), "{error}");
}

#[test]
fn images_of_wrong_size_are_refused() {
    let folder = TempDir::new().unwrap();
    let mut memory = memory(load(folder.path(), KEYS).unwrap());
    for (w, h) in [(0, 0), (120, 200), (200, 120), (132, 128), (128, 129)] {
        let error = memory.add_frame(0, &test_image(w, h, 0.0)).unwrap_err();
        assert!(matches!(error, DroidError::Size { width, height } if (width, height) == (w, h)), "{error}");
    }
    assert_eq!(memory.grid(), None);
    memory.add_frame(0, &test_image(136, 128, 0.0)).unwrap();
    assert_eq!(memory.grid(), Some((17, 16)));
    let error = memory.add_frame(1, &test_image(128, 128, 0.0)).unwrap_err();
    assert!(matches!(error, DroidError::OtherSize { frame: 1, .. }), "{error}");
}

/// The published file itself, where it is.
#[test]
fn takes_the_published_file() {
    let folder = std::env::var_os("MINUTE4D_WEIGHTS").map(std::path::PathBuf::from);
    let path = folder.map(|folder| folder.join("megasam/megasam_final.pth"));
    let Some(path) = path.filter(|path| path.is_file()) else {
        skip(Need::Weights, "MINUTE4D_WEIGHTS names no folder with megasam/megasam_final.pth");
        return;
    };
    let net = DroidNet::load(&path, cpu()).unwrap();
    assert_eq!(net.parameters(), ALL - TRAINING);
    let motion = memory(net).motion_px(0, 4).unwrap();
    assert!(motion.is_finite() && motion > 0.0, "{motion}");
}
