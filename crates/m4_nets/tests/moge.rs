//! MoGe-2 as it is called: checkpoints, images of any size, options, threads. Its layers are compared with the authors' module in the
//! crate's own tests.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::test_image;
use m4_core::{Plane, RgbImage};
use m4_nets::{BackboneSize, LoadError, MoGe, MoGeError, MoGeOptions, cpu};
use m4_testkit::FormulaWeights;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use tempfile::TempDir;

const KEYS: &str = include_str!("../../../fixtures/moge2/vits_normal.keys.txt");

fn weights() -> FormulaWeights {
    FormulaWeights::of_keys(KEYS)
        .with("mask_head.output_blocks.4.bias", &[0.3])
        .scaled("points_head.output_blocks.4.weight", 0.3)
}

/// A checkpoint with weights by the formula, made once.
fn formula_weights() -> PathBuf {
    static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
        let folder = TempDir::new().unwrap();
        weights().write(&folder.path().join("model.safetensors"));
        folder
    });
    FOLDER.path().join("model.safetensors")
}

fn network() -> MoGe {
    MoGe::load(&formula_weights(), cpu()).unwrap()
}

fn few(tokens: usize) -> MoGeOptions {
    MoGeOptions { tokens: Some(tokens), known_focal_px: None }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let net = network();
    let image = test_image(201, 99);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| net.infer(&image, &few(150)).unwrap())
    };
    let one = with(1);
    assert_eq!(one.depth_m.size(), (201, 99));
    let valid = one.mask.data().iter().filter(|&&m| m).count();
    assert!(valid > 201 * 99 / 4, "{valid} valid");
    for ((&z, &valid), n) in one.depth_m.data().iter().zip(one.mask.data()).zip(one.normal.as_ref().unwrap().data()) {
        assert_eq!(valid, z > 0.0);
        let length = n.iter().map(|x| x * x).sum::<f32>().sqrt();
        assert!(z.is_finite() && (length - f32::from(u8::from(valid))).abs() < 1e-5, "{z}, {length}");
    }
    assert_eq!(one, with(2));
    assert_eq!(one, with(5));
}

#[test]
fn known_focal_length_is_used() {
    let net = network();
    let image = test_image(60, 40);
    let options = MoGeOptions { known_focal_px: Some(70.0), ..few(24) };
    let map = net.infer(&image, &options).unwrap();
    assert_eq!(map.focal_px, 70.0);
    assert!((map.fov_x_rad - 2.0 * (30.0f64 / 70.0).atan()).abs() < 1e-12);
    let free = net.infer(&image, &few(24)).unwrap();
    assert!(free.focal_px > 0.0 && free.focal_px != 70.0);
    // the centre of the image's last pixel is half a pixel from its corner
    let points = map.points_m();
    let (x, y) = (0..2400).map(|i| (i % 60, i / 60)).rfind(|&at| map.mask[at]).unwrap();
    let [px, py, pz] = points[(x, y)];
    assert_eq!(pz, map.depth_m[(x, y)]);
    assert!((px / pz - (x as f32 - 29.5) / 70.0).abs() < 1e-6 && (py / pz - (y as f32 - 19.5) / 70.0).abs() < 1e-6);
    for wrong in [0.0, -3.0, f64::NAN, f64::INFINITY] {
        let options = MoGeOptions { known_focal_px: Some(wrong), ..few(24) };
        assert!(matches!(net.infer(&image, &options), Err(MoGeError::FocalLength(_))));
    }
}

#[test]
fn odd_sizes_and_options() {
    let net = network();
    for (w, h) in [(1, 1), (1, 90), (400, 3)] {
        // an image of few pixels need not have a focal length
        match net.infer(&test_image(w, h), &few(20)) {
            Ok(map) => assert_eq!(map.depth_m.size(), (w, h)),
            Err(error) => assert!(matches!(error, MoGeError::NoFocal | MoGeError::NothingValid), "{error}"),
        }
    }
    let none: RgbImage = Plane::filled(4, 0, [9, 9, 9]);
    assert!(matches!(net.infer(&none, &few(20)), Err(MoGeError::Empty)));
    assert!(matches!(net.infer(&test_image(9, 9), &few(0)), Err(MoGeError::Tokens(0))));
}

/// A mask that is empty everywhere: nothing can be said of the image.
#[test]
fn an_image_without_depth_is_an_error() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("model.safetensors");
    weights().with("mask_head.output_blocks.4.bias", &[-50.0]).write(&path);
    let net = MoGe::load(&path, cpu()).unwrap();
    assert!(matches!(net.infer(&test_image(40, 30), &few(12)), Err(MoGeError::NothingValid)));
}

fn refused(path: &Path) -> LoadError {
    match MoGe::load(path, cpu()) {
        Ok(_) => panic!("it was loaded"),
        Err(error) => error,
    }
}

#[test]
fn a_checkpoint_is_read_strictly() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("model.safetensors");
    let load = |list: &str| {
        m4_testkit::write_formula_weights(list, &path);
        refused(&path).to_string()
    };
    let without = |part: &str| -> String {
        let kept = KEYS.lines().filter(|line| !line.contains(part));
        kept.map(|line| format!("{line}\n")).collect()
    };
    let error = load(&without("neck.res_blocks.2.1.layers.5.bias"));
    assert!(error.contains("1 tensors are missing (neck.res_blocks.2.1.conv2.bias)"), "{error}");
    let error = load(&format!("{KEYS}head.weight 2 2\n"));
    assert!(error.contains("head.weight"), "{error}");
    let error = load(&without("points_head"));
    assert!(error.contains("points_head"), "{error}");
    let error = load(&without("output_projections.3"));
    assert!(error.contains("[2, 5, 8, 11] are to be tapped by 3 projections"), "{error}");
    let error = load("encoder.backbone.cls_token 1 1 384\n");
    assert!(error.contains("output_projections"), "{error}");
    // the first version of the network has other tensors
    let error = load("backbone.cls_token 1 1 1024\n");
    assert!(error.contains("encoder.backbone.cls_token"), "{error}");
    let text = folder.path().join("model.pt");
    fs::write(&text, "no checkpoint at all").unwrap();
    assert!(matches!(refused(&text), LoadError::Unreadable { .. }));
    assert!(matches!(refused(&folder.path().join("none.pt")), LoadError::Missing { .. }));
}

/// Without the head for normals, the rest is as it was.
#[test]
fn checkpoint_without_normals_is_accepted() {
    let net = network();
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("model.safetensors");
    let kept: String = KEYS.lines().filter(|l| !l.starts_with("normal_head")).map(|l| format!("{l}\n")).collect();
    FormulaWeights::of_keys(&kept)
        .with("mask_head.output_blocks.4.bias", &[0.3])
        .scaled("points_head.output_blocks.4.weight", 0.3)
        .write(&path);
    let other = MoGe::load(&path, cpu()).unwrap();
    assert_eq!((other.size(), other.has_normals(), net.has_normals()), (BackboneSize::Small, false, true));
    let image = test_image(50, 40);
    let (a, b) = (net.infer(&image, &few(20)).unwrap(), other.infer(&image, &few(20)).unwrap());
    assert_eq!((a.depth_m, a.focal_px), (b.depth_m, b.focal_px));
    assert!(b.normal.is_none());
}
