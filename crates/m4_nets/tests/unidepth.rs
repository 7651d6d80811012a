//! `UniDepth` V2 against the authors' module of mid 2024 (`oracles/unidepth_v2.py`), with synthetic
//! weights: a small backbone of five blocks and heads of 128 channels.

use crate::common::{loaded, real_weights};
use m4_core::{Plane, RgbImage};
use m4_nets::{UniDepth, UniDepthMap, cpu};
use m4_testkit::{Fixture, FormulaWeights, assert_close, same_on_any_threads};

const KEYS: &str = include_str!("../../../fixtures/unidepth_v2/formula.keys.txt");
/// Those of the fixture.
const PATCHES: usize = 48;

fn network() -> UniDepth {
    loaded(&FormulaWeights::of_keys(KEYS), |path| {
        UniDepth::load(path, cpu())
    })
}

fn fixture() -> (Fixture, RgbImage) {
    let file = Fixture::open("unidepth_v2/formula.safetensors");
    let image = file.image("image");
    (file, image)
}

/// The module in 32 bits is 4e-6 from itself in 64 bits, which the fixture holds.
#[test]
fn agrees_with_the_module_by_formula() {
    let net = network();
    let (file, image) = fixture();
    let got = net.depth_by_patches(&image, PATCHES).unwrap();
    assert_eq!(got.depth_m.size(), (151, 97));
    assert_close("depth", got.depth_m.data(), &file.floats("depth").0, 5e-5);
    let camera = got.camera;
    let want = file.floats("intrinsics").0;
    for (got, want) in [camera.fx, camera.fy, camera.cx, camera.cy]
        .into_iter()
        .zip(want)
    {
        let error = (got / f64::from(want) - 1.0).abs();
        assert!(error < 1e-5, "{got} px where {want} were expected");
    }
    assert_eq!((camera.width, camera.height), (151, 97));
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let net = network();
    let (_, image) = fixture();
    same_on_any_threads(|| net.depth_by_patches(&image, PATCHES).unwrap());
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
    for (size, message) in [
        ((0, 4), "an image with pixels"),
        ((100, 1), "100 x 1 pixels is too narrow"),
    ] {
        let error = depth(size.0, size.1, 9).unwrap_err();
        assert!(error.to_string().contains(message), "{error}");
    }
}

#[test]
fn real_weights_have_the_expected_tensors() {
    let Some(path) = real_weights("unidepth-v2-l", "model.safetensors") else {
        return;
    };
    let net = UniDepth::load(&path, cpu()).unwrap();
    let image = crate::common::png("tennis/tennis_0.png");
    let UniDepthMap { depth_m, camera } = net.depth_by_patches(&image, 300).unwrap();
    let mut depths = depth_m.data().to_vec();
    depths.sort_by(f32::total_cmp);
    let fov = camera.horizontal_fov_rad().to_degrees();
    let [near, far] = [depths.len() / 20, depths.len() * 19 / 20].map(|i| depths[i]);
    assert!(
        near > 0.3 && far < 200.0 && far > 1.2 * near,
        "{near} m to {far} m"
    );
    assert!((20.0..120.0).contains(&fov), "{fov} degrees");
}
