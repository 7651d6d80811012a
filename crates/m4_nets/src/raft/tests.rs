//! Parts of the network against the published module, with weights by a formula.

use super::*;
use crate::cpu;
use m4_scene::Plane;
use m4_testkit::write_formula_weights;
use safetensors::SafeTensors;

const KEYS: &str = include_str!("../../../../fixtures/raft/keys.txt");

fn fixture() -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/raft/flow.safetensors");
    std::fs::read(path).unwrap()
}

fn floats(file: &[u8], name: &str) -> Vec<f32> {
    let tensors = SafeTensors::deserialize(file).unwrap();
    let words = tensors.tensor(name).unwrap().data().as_chunks::<4>().0.to_vec();
    words.into_iter().map(f32::from_le_bytes).collect()
}

fn picture(file: &[u8], name: &str) -> RgbImage {
    let tensors = SafeTensors::deserialize(file).unwrap();
    let view = tensors.tensor(name).unwrap();
    let [3, h, w] = *view.shape() else {
        panic!("{name} is no picture");
    };
    let bytes = view.data();
    Plane::from_fn(w, h, |x, y| [0, 1, 2].map(|c| bytes[(c * h + y) * w + x]))
}

fn network() -> Raft {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("weights.safetensors");
    write_formula_weights(KEYS, &path);
    Raft::load(&path, &cpu()).unwrap()
}

/// Every `step`-th channel of `[1, c, h, w]` against `want`, relative to its largest number.
fn assert_channels(name: &str, got: Tensor<4>, step: usize, want: &[f32]) {
    let [_, _, h, w] = got.dims();
    let got: Vec<f32> = got.try_into_vec_as().unwrap();
    let got: Vec<f32> = got.chunks(h * w).step_by(step).flatten().copied().collect();
    assert_eq!(got.len(), want.len(), "{name}");
    let largest = want.iter().fold(0f32, |m, x| m.max(x.abs()));
    let off = got.iter().zip(want).map(|(a, b)| (a - b).abs());
    let error = off.fold(0.0, |m: f32, x| if x.is_nan() { f32::NAN } else { m.max(x) }) / largest;
    println!("{name}: {error:.1e} of {largest}");
    assert!(largest > 0.1 && error < 1e-5, "{name}: {error:.1e} of {largest}");
}

/// The module in f32 is 2e-6 from itself in f64.
#[test]
fn parts_agree_with_the_published_module() {
    let (net, file) = (network(), fixture());
    let input = |name: &str| {
        let image = picture(&file, name);
        let padding = Padding::of(image.width(), image.height(), FACTOR, LEAST).unwrap();
        padding.tensor(&image, |x, _| 2.0 * x - 1.0, &net.device)
    };
    let maps = ["1", "2"].map(|i| {
        let map = net.net.fnet.forward(input(&format!("image{i}")));
        let name = format!("fmap{i}_strided");
        assert_channels(&name, map.clone(), 8, &floats(&file, &name));
        map
    });
    let context = net.net.cnet.forward(input("image1"));
    assert_channels("cnet", context, 8, &floats(&file, "cnet_strided"));

    let [source, target] = maps.map(|map| map.squeeze_dim::<3>(0).permute([1, 2, 0]));
    let [h, w, _] = source.dims();
    let at = net.whole_positions(h, w).squeeze_dim::<3>(0) + 0.37;
    let found = correlation::scores(&FeatureMap::new(source), &Pyramid::new(target, LEVELS), at, RADIUS);
    let found = channels_first(found.unsqueeze::<4>());
    assert_eq!(found.dims(), [1, 324, h, w]);
    assert_channels("corr", found, 4, &floats(&file, "corr_strided"));
}

/// The unit with the context's part taken out against its definition.
#[test]
fn the_unit_is_the_published_one() {
    use burn_core::tensor::activation::sigmoid;
    use burn_core::tensor::module::conv2d;
    use burn_core::tensor::ops::ConvOptions;
    let net = network();
    let gru = &net.net.update_block.gru;
    let map = |key: &str| {
        let values = m4_testkit::formula_input(key, 0.0, 1.0, 2 * 128 * 7 * 9);
        crate::ops::tensor(values, [2, 128, 7, 9], &net.device)
    };
    let (hidden, context, motion) = (map("hidden"), map("context"), map("motion"));
    let got = gru.with_context(&context).forward(hidden.clone(), &motion);
    let x = Tensor::cat(vec![context, motion], 1);
    let want = gru.kernels().into_iter().fold(hidden, |h, [z, r, q]| {
        let through = |h: Tensor<4>, (weight, bias): (Tensor<4>, Tensor<1>)| {
            let [_, _, rows, columns] = weight.dims();
            let options = ConvOptions::new([1, 1], [rows / 2, columns / 2], [1, 1], 1);
            conv2d(Tensor::cat(vec![h, x.clone()], 1), weight, Some(bias), options)
        };
        let (z, r) = (sigmoid(through(h.clone(), z)), sigmoid(through(h.clone(), r)));
        let q = tanh(through(r * h.clone(), q));
        (z.ones_like() - z.clone()) * h + z * q
    });
    let want: Vec<f32> = want.try_into_vec_as().unwrap();
    assert_channels("unit", got, 1, &want);
}
