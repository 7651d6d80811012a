//! `UniDepth` V2 against upstream's code, with synthetic weights: a small backbone of five blocks and heads of 128 channels.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{fixtures, floats, read_image, real_weights};
use m4_core::{Plane, RgbImage};
use m4_nets::{BackboneSize, LoadError, UniDepth, UniDepthError, UniDepthMap, cpu};
use m4_testkit::write_formula_weights;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use tempfile::TempDir;

const KEYS: &str = include_str!("../../../fixtures/unidepth_v2/formula.keys.txt");
/// Those of the fixture.
const PATCHES: usize = 48;

/// A checkpoint with weights by the formula, made once.
fn formula_weights() -> &'static Path {
    static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
        let folder = TempDir::new().unwrap();
        write_formula_weights(KEYS, &folder.path().join("weights.safetensors"));
        folder
    });
    static PATH: LazyLock<PathBuf> = LazyLock::new(|| FOLDER.path().join("weights.safetensors"));
    &PATH
}

fn network() -> UniDepth {
    UniDepth::load(formula_weights(), cpu()).unwrap()
}

fn fixture() -> (Vec<u8>, RgbImage) {
    let file = fs::read(fixtures().join("unidepth_v2/formula.safetensors")).unwrap();
    let image = read_image(&file, "image");
    (file, image)
}

/// The reference in 32 bits is 4e-6 from itself in 64 bits, which the fixture holds.
#[test]
fn agrees_with_upstream_by_formula() {
    let net = network();
    assert_eq!(net.size(), BackboneSize::Small);
    let (file, image) = fixture();
    let got = net.depth_by_patches(&image, PATCHES).unwrap();
    let want = floats(&file, "depth");
    assert_eq!(got.depth_m.size(), (151, 97));
    let largest = want.iter().fold(0f32, |m, x| m.max(x.abs()));
    let off = got.depth_m.data().iter().zip(&want).map(|(a, b)| (a - b).abs());
    let error = off.fold(0.0, |m: f32, x| if x.is_nan() { f32::NAN } else { m.max(x) }) / largest;
    println!("depth: {error:.1e} of {largest} m");
    assert_eq!(got.depth_m.data().len(), want.len());
    assert!(largest > 10.0 && error < 5e-5, "{error:.1e} of {largest} m");
    let camera = got.camera;
    let want = floats(&file, "intrinsics");
    for (got, want) in [camera.fx, camera.fy, camera.cx, camera.cy].into_iter().zip(want) {
        let error = (got / f64::from(want) - 1.0).abs();
        assert!(error < 1e-5, "{got} px where {want} were expected");
    }
    assert_eq!((camera.width, camera.height), (151, 97));
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let net = network();
    let (_, image) = fixture();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| net.depth_by_patches(&image, PATCHES).unwrap())
    };
    let one = with(1);
    assert_eq!(one, with(2));
    assert_eq!(one, with(5));
}

#[test]
fn images_of_any_size_are_accepted_and_empty_ones_refused() {
    let net = network();
    let depth = |w: usize, h: usize, patches: usize| {
        let image: RgbImage = Plane::from_fn(w, h, |x, y| [x as u8, y as u8, 90]);
        net.depth_by_patches(&image, patches)
    };
    for (w, h, patches) in [(1, 1, 0), (1, 1, 1), (3, 48, 9), (16, 1, 4)] {
        let UniDepthMap { depth_m, camera } = depth(w, h, patches).unwrap();
        assert_eq!(depth_m.size(), (w, h));
        assert!(depth_m.data().iter().all(|&d| d.is_finite() && d >= 0.0));
        assert!(camera.fx > 0.0 && camera.fx.is_finite(), "{camera:?}");
    }
    assert!(matches!(depth(0, 4, 9), Err(UniDepthError::Empty)));
    let error = depth(100, 1, 9).unwrap_err();
    assert!(matches!(error, UniDepthError::Narrow { width: 100, height: 1 }), "{error}");
}

#[test]
fn a_checkpoint_is_read_strictly() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("weights.safetensors");
    let load = |list: &str| {
        write_formula_weights(list, &path);
        UniDepth::load(&path, cpu()).map(|_| ())
    };
    let without = |name: &str| -> String {
        let kept = KEYS.lines().filter(|line| !line.starts_with(name));
        kept.map(|line| format!("{line}\n")).collect()
    };
    for (name, n) in [
        ("pixel_decoder.level_embeds", 1),
        ("pixel_encoder.cls_token", 1),
        ("pixel_encoder.blocks.", 1),
        ("pixel_decoder.depth_layer.ups.2.up.3.bias", 1),
        ("pixel_decoder.global_token_adapter.input_adapters.1.1.", 2),
    ] {
        let Err(LoadError::OtherNetwork { missing, wrong, .. }) = load(&without(name)) else {
            panic!("{name} is missing");
        };
        assert_eq!((missing.len(), wrong), (n, vec![]), "{name}: {missing:?}");
    }
    // neither of use here
    load(&without("pixel_encoder.register_tokens")).unwrap();
    load(&without("pixel_decoder.depth_layer.confidence_mlp.")).unwrap();
    let Err(error) = load(&format!("{KEYS}head.weight 2 2\n")) else {
        panic!("a tensor is left over");
    };
    assert!(error.to_string().contains("head.weight"), "{error}");
    for (from, to) in [("level_embeds 4 128", "level_embeds 4 100"), ("to_depth.bias 1\n", "to_depth.bias 2\n")] {
        let Err(LoadError::OtherNetwork { wrong, .. }) = load(&KEYS.replace(from, to)) else {
            panic!("a tensor has another shape");
        };
        assert_eq!(wrong.len(), 1, "{wrong:?}");
    }
}

#[test]
fn real_weights_have_the_expected_tensors() {
    let Some(path) = real_weights("unidepth-v2-l", "model.safetensors") else {
        return;
    };
    let net = UniDepth::load(&path, cpu()).unwrap();
    assert_eq!(net.size(), BackboneSize::Large);
    let image = crate::common::png("tennis/tennis_0.png");
    let UniDepthMap { depth_m, camera } = net.depth_by_patches(&image, 300).unwrap();
    let mut depths = depth_m.data().to_vec();
    depths.sort_by(f32::total_cmp);
    let fov = camera.horizontal_fov_rad().to_degrees();
    let [near, far] = [depths.len() / 20, depths.len() * 19 / 20].map(|i| depths[i]);
    assert!(near > 0.3 && far < 200.0 && far > 1.2 * near, "{near} m to {far} m");
    assert!((20.0..120.0).contains(&fov), "{fov} degrees");
}
