//! Against the authors' module, with synthetic weights and the small backbone.

use super::focal::recovered;
use super::image::Grid;
use super::layout::{Config, Layout};
use super::{MoGe, MoGeOptions, Net, RENAMES, unneeded};
use crate::dinov2::BackboneSize;
use crate::fixture::{Fixture, assert_close, assert_near, assert_same_tensors, every_map, renamed};
use crate::{cpu, load};
use burn_store::pytorch_reader::PickleValue;
use m4_testkit::FormulaWeights;
use std::path::Path;
use tempfile::TempDir;

const SMALL: &str = include_str!("../../../../fixtures/moge2/vits_normal.keys.txt");
const BASE: &str = include_str!("../../../../fixtures/moge2/vitb_normal.keys.txt");
const LARGE: &str = include_str!("../../../../fixtures/moge2/vitl_normal.keys.txt");
const LARGE_WITHOUT: &str = include_str!("../../../../fixtures/moge2/vitl.keys.txt");
/// Relative error that the fixture allows; PyTorch's own in 32 bits is 6e-6.
const LIMIT: f64 = 1e-4;

fn network() -> MoGe {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("model.safetensors");
    let weights = FormulaWeights::of_keys(SMALL)
        .with("mask_head.output_blocks.4.bias", &[0.3])
        .scaled("points_head.output_blocks.4.weight", 0.3);
    weights.write(&path);
    MoGe::load(&path, cpu()).unwrap()
}

#[test]
fn small_model_matches_the_module() {
    let fixture = Fixture::open("moge2/vits_assumed.safetensors");
    let net = network();
    let image = fixture.image("image");
    let grid = Grid::of((180, 140), 80).unwrap();
    assert_eq!((grid.across, grid.down), (10, 8));
    let input = grid.tensor(&image, &cpu());
    assert_near(input.clone(), &fixture, "image_resized", 1e-5);
    let taps = &net.config.taps;
    assert_eq!(taps, &[2, 5, 8, 11]);
    let (map, class) = net.net.encoder.forward(input.clone(), taps, [8, 10]);
    assert_near(every_map(map, 4), &fixture, "encoder_strided", LIMIT);
    assert_near(class, &fixture, "cls", LIMIT);
    let places = grid.places(2, &cpu(), burn_core::tensor::DType::F32);
    assert_near(places.permute([0, 2, 3, 1]), &fixture, "uv_level2", 1e-5);
    let (levels, _) = net.net.features(input, taps, grid);
    for (i, (level, step)) in levels.into_iter().zip([96, 32, 16, 16, 16]).enumerate() {
        assert_near(
            every_map(level, step),
            &fixture,
            &format!("neck{i}_strided"),
            LIMIT,
        );
    }
    let options = MoGeOptions {
        tokens: Some(80),
        known_focal_px: None,
    };
    let raw = net.raw_output(&image, &options).unwrap();
    let near = |got: &[f32], name: &str| assert_close(name, got, &fixture.floats(name).0, LIMIT);
    near(raw.points.as_flattened(), "points");
    near(&raw.mask, "mask");
    near(&[raw.metric_scale], "metric_scale");
    // points of no scene: where the search ends is decided by its rules alone
    let likely = |i: usize| raw.mask[i] > 0.5;
    let solution = recovered(&raw.points, likely, (180, 140), None).unwrap();
    let wanted = |name: &str| f64::from(fixture.floats(name).0[0]);
    assert!((solution.focal / wanted("focal") - 1.0).abs() < 1e-4);
    assert!((solution.shift / wanted("shift") - 1.0).abs() < 1e-4);

    let map = net.infer(&image, &options).unwrap();
    let intrinsics = fixture.floats("infer_intrinsics").0;
    assert!(
        (map.focal_px / 180.0 / f64::from(intrinsics[0]) - 1.0).abs() < 1e-2,
        "{}",
        map.focal_px
    );
    let (depth, mut checked) = (fixture.floats("infer_depth_strided").0, 0);
    for (i, &want) in depth.iter().enumerate() {
        let at = (2 * (i % 90), 2 * (i / 90));
        if !map.mask[at] {
            assert_eq!(map.depth_m[at], 0.0);
            continue;
        }
        checked += 1;
        assert!((map.depth_m[at] / want - 1.0).abs() < 1e-4, "{at:?}");
    }
    assert!(
        checked > depth.len() / 4 && checked < depth.len(),
        "{checked} of {}",
        depth.len()
    );
}

/// The names and shapes of the module are those of the checkpoints, nothing less and nothing more.
#[test]
fn each_model_has_exactly_the_tensors_of_its_checkpoint() {
    for (size, keys) in [
        (BackboneSize::Small, SMALL),
        (BackboneSize::Base, BASE),
        (BackboneSize::Large, LARGE),
        (BackboneSize::Large, LARGE_WITHOUT),
    ] {
        let shapes = renamed(keys, &RENAMES);
        let layout = Layout::in_checkpoint(&shapes).unwrap();
        let net = Net::new(size, &layout, &cpu());
        assert_same_tensors(&net, keys, &RENAMES, unneeded);
    }
}

/// A file as PyTorch writes the official ones, with other settings than were published:
/// `model_config` beside `model`.
#[test]
fn official_file_holds_the_configuration() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/moge2/config.pt");
    let shapes = load::shapes("MoGe-2", &path, &RENAMES).unwrap();
    let names: Vec<&str> = shapes.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        ["encoder.backbone.cls_token", "neck.resamplers.3.conv.bias"]
    );
    let config = Config::of_checkpoint(&path, BackboneSize::Small).unwrap();
    assert_eq!(config.taps, [1, 4, 7, 11]);
    assert_eq!(config.tokens, (900, 2500));
    let published = Config::published(BackboneSize::Large);
    assert_eq!(
        (published.taps, published.tokens),
        (vec![5, 11, 17, 23], (1200, 3600))
    );
}

/// What a configuration may say that is not known here.
#[test]
fn an_unknown_setting_is_an_error() {
    let text = |s: &str| PickleValue::String(s.to_owned());
    let dict = |key: &str, value: PickleValue| PickleValue::Dict([(key.to_owned(), value)].into());
    for (said, word) in [
        (dict("remap_output", text("tanh")), "tanh"),
        (
            dict(
                "num_tokens_range",
                PickleValue::List(vec![PickleValue::Int(5)]),
            ),
            "num_tokens_range",
        ),
        (dict("neck", dict("activation", text("silu"))), "silu"),
        (
            dict("mask_head", dict("resamplers", text("pixel_shuffle"))),
            "pixel_shuffle",
        ),
        (
            dict("encoder", dict("intermediate_layers", PickleValue::Int(4))),
            "intermediate_layers",
        ),
    ] {
        let error = Config::published(BackboneSize::Small)
            .read(&said)
            .unwrap_err();
        assert!(error.contains(word), "{error}");
    }
}

#[test]
fn layouts_that_do_not_fit_are_refused() {
    let base = renamed(SMALL, &RENAMES);
    for (name, shape, message) in [
        (
            "points_head.output_blocks.4.weight",
            Some(vec![4, 32, 1, 1]),
            "points_head does not end in 3",
        ),
        (
            "mask_head.output_blocks.4.weight",
            None,
            "mask_head does not end in 1",
        ),
        (
            "neck.input_blocks.2.weight",
            Some(vec![128, 3, 1, 1]),
            "neck.input_blocks.2",
        ),
        (
            "mask_head.input_blocks.1.weight",
            Some(vec![256, 7, 1, 1]),
            "mask_head.input_blocks.1",
        ),
        ("scale_head.layers.2.weight", None, "scale_head"),
        (
            "encoder.output_projections.0.weight",
            None,
            "output_projections",
        ),
        (
            "neck.resamplers.0.conv.weight",
            Some(vec![1 << 20, 256, 3, 3]),
            "too large",
        ),
    ] {
        let mut shapes = base.clone();
        match shape {
            Some(shape) => shapes.insert(name.to_owned(), shape),
            None => shapes.remove(name),
        };
        let error = Layout::in_checkpoint(&shapes).unwrap_err();
        assert!(error.contains(message), "{error}");
    }
}
