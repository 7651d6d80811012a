//! Parts of the network against the authors' module (`oracles/unidepth_v2.py`), with synthetic
//! weights: a small backbone of five blocks and heads of 128 channels.

use super::*;
use crate::cpu;
use crate::device::halved;
use crate::fixture::{
    Fixture, assert_near, assert_same_tensors, every, fill_by_formula, relative_error,
};
use m4_testkit::FormulaWeights;

const FORMULA: &str = include_str!("../../../../fixtures/unidepth_v2/formula.keys.txt");
const LARGE: &str = include_str!("../../../../fixtures/unidepth_v2/vitl.keys.txt");
/// The module in 32 bits is 2e-6 to 4e-6 from itself in 64 bits, which the fixture holds.
const LIMIT: f64 = 2e-5;

fn network() -> Net {
    let mut net = Net::new(BackboneSize::Small, 5, 128, &cpu());
    fill_by_formula(
        &mut net,
        &FormulaWeights::of_keys(FORMULA),
        &RENAMES,
        unneeded,
    );
    net
}

/// Every `rows`-th row and `columns`-th column.
fn thinned(x: Tensor<2>, rows: usize, columns: usize) -> Tensor<2> {
    let [h, w] = x.dims();
    let pick = |n: usize, step: usize| Tensor::arange_step(0..n as i64, step, &cpu());
    x.select(0, pick(h, rows)).select(1, pick(w, columns))
}

#[test]
fn parts_agree_with_the_module() {
    let (net, fixture) = (network(), Fixture::open("unidepth_v2/formula.safetensors"));
    let image = fixture.image("image");
    let patches = Patches::of(image.size(), 48).unwrap();
    assert_eq!(patches.grid, [6, 9]);
    let input = patches.tensor(&image, &cpu());
    let channels = (0..3).map(|c| {
        thinned(
            input.clone().slice([0..1, c..c + 1]).reshape([84, 126]),
            4,
            4,
        )
    });
    assert_near(
        Tensor::stack::<3>(channels.collect(), 0),
        &fixture,
        "input_strided",
        LIMIT,
    );

    let taps = net.pixel_encoder.taps(input.clone(), [1, 2, 3, 4]);
    let last: Tensor<2> = taps[3].patches.clone().squeeze_dim(0);
    assert_near(every(last, 4), &fixture, "feature_last_strided", LIMIT);

    let decoder = &net.pixel_decoder;
    let levels = taps
        .iter()
        .map(|tap| tap.patches.clone().squeeze_dim(0))
        .collect();
    let levels = decoder.input_adapter.forward(levels);
    let heads = net.heads(input, patches).unwrap();
    let rays = Rays::of(&heads.camera);
    let scene = DecoderInputs {
        levels: &levels,
        positions: decoder.positions(patches.grid, &cpu()),
        rays: &rays,
        grid: patches.grid,
    };
    let first = decoder.depth_layer.encoded_rays(&scene, 0);
    let latents = decoder.depth_layer.latents(&scene, first.clone());
    assert_near(
        every(latents.clone(), 4),
        &fixture,
        "prompt_camera_strided",
        LIMIT,
    );
    let mixed = decoder.depth_layer.processed(latents, &first);
    assert_near(every(mixed, 4), &fixture, "processed_strided", LIMIT);

    let logarithms: Tensor<2> = heads.logarithms.clone().reshape([84, 126]);
    assert_near(thinned(logarithms, 3, 3), &fixture, "logdepth", LIMIT);
    let (global, _) = fixture.floats("scale_shift");
    let error = |got: f64, want: f32| (got / f64::from(want) - 1.0).abs();
    assert!(error(heads.log_scale.exp(), global[0]) < 1e-5, "{heads:?}");
    assert!(error(heads.offset, global[1]) < 1e-5, "{heads:?}");
    let camera = patches.camera_of_image(&heads.camera);
    let (want, _) = fixture.floats("intrinsics");
    for (got, want) in [camera.fx, camera.fy, camera.cx, camera.cy]
        .into_iter()
        .zip(want)
    {
        assert!(
            error(got, want) < 1e-5,
            "{got} px where {want} were expected"
        );
    }
}

/// The whole list of the published checkpoint; what has no field is named in `unneeded`.
#[test]
fn the_published_checkpoint_fits() {
    let net = Net::new(BackboneSize::Large, 24, 512, &cpu());
    assert_same_tensors(&net, LARGE, &RENAMES, unneeded);
    let numbers = |keep: &dyn Fn(&str) -> bool| -> usize {
        let numbers = |line: &str| {
            let mut words = line.split_whitespace();
            let name = words.next().unwrap();
            let count: usize = words.map(|w| w.parse::<usize>().unwrap()).product();
            if keep(name) { count } else { 0 }
        };
        LARGE.lines().map(numbers).sum()
    };
    assert_eq!(numbers(&|_| true), 363_206_788);
    assert_eq!(net.num_params(), numbers(&|name| !unneeded(name)));
}

#[test]
fn patches_have_the_aspect_of_the_image() {
    let grid = |w, h, n| Patches::of((w, h), n).unwrap().grid;
    // as published
    assert_eq!(grid(640, 360, 2400), [37, 66]);
    assert_eq!(grid(360, 640, 2400), [65, 37]);
    assert_eq!(grid(1, 1, 2400), [49, 49]);
    assert_eq!(grid(16, 1, 1), [1, 16]);
    assert_eq!(grid(1, 16, 1), [4, 1]);
}

/// 16 bits are enough, and rays stay in 32.
#[test]
fn half_precision_stays_near() {
    let net = network();
    let image = Fixture::open("unidepth_v2/formula.safetensors").image("image");
    let patches = Patches::of(image.size(), 48).unwrap();
    let [whole, half] = [net.clone(), halved(net)].map(|net| {
        let heads = net.heads(patches.tensor(&image, &cpu()), patches).unwrap();
        let logarithms = numbers(heads.logarithms).unwrap();
        let depth = patches.depth(&logarithms, heads.log_scale, heads.offset);
        depth.data().to_vec()
    });
    let error = relative_error(&half, &whole);
    println!("half precision: {error:.1e}");
    // measured: at most 6.0e-3
    assert!(error < 1.5e-2, "{error:e}");
}
