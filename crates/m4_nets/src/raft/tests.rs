//! Parts of the network against the published module, with synthetic weights.

use super::*;
use crate::cpu;
use crate::device::halved;
use crate::fixture::{Fixture, assert_near, every_map, fill_by_formula, relative_error};
use m4_testkit::FormulaWeights;

const KEYS: &str = include_str!("../../../../fixtures/raft/keys.txt");
/// The module in 32 bits is 2e-6 from itself in 64 bits.
const LIMIT: f64 = 1e-5;

fn network() -> Raft {
    let device = cpu();
    let mut net = Net::new(&device);
    fill_by_formula(&mut net, &FormulaWeights::of_keys(KEYS), &RENAMES, unneeded);
    Raft { net, device }
}

#[test]
fn parts_agree_with_the_published_module() {
    let (net, fixture) = (network(), Fixture::open("raft/flow.safetensors"));
    let input = |name: &str| {
        let image = fixture.image(name);
        Padding::of(image.size())
            .unwrap()
            .tensor(&image, &net.device)
    };
    let maps = ["1", "2"].map(|i| {
        let map = net
            .net
            .fnet
            .forward(input(&format!("image{i}")), Norm::Instance);
        let name = format!("fmap{i}_strided");
        assert_near(every_map(map.clone(), 8), &fixture, &name, LIMIT);
        map
    });
    let context = net.net.cnet.forward(input("image1"), Norm::Batch);
    assert_near(every_map(context, 8), &fixture, "cnet_strided", LIMIT);

    let [source, target] = maps.map(|map| map.squeeze_dim::<3>(0).permute([1, 2, 0]));
    let [h, w, _] = source.dims();
    let at = net.whole_positions(h, w).squeeze_dim::<3>(0) + 0.37;
    let scores = correlation::scores(
        &FeatureMap::new(source),
        &Pyramid::new(target, LEVELS),
        at,
        RADIUS,
    );
    let scores = channels_first(scores.unsqueeze::<4>());
    assert_eq!(scores.dims(), [1, 324, h, w]);
    assert_near(every_map(scores, 4), &fixture, "corr_strided", LIMIT);
}

/// The unit with the context's part taken out against its definition.
#[test]
fn the_unit_is_the_published_one() {
    use burn_core::tensor::activation::sigmoid;
    use burn_nn::conv::Conv2d;
    let net = network();
    let gru = &net.net.update_block.gru;
    let map = |key: &str| {
        let values = m4_testkit::formula_input(key, 0.0, 1.0, 2 * 128 * 7 * 9);
        tensor(values, [2, 128, 7, 9], &net.device)
    };
    let (hidden, context, motion) = (map("hidden"), map("context"), map("motion"));
    let got = gru.with_context(&context).forward(hidden.clone(), &motion);
    let x = Tensor::cat(vec![context, motion], 1);
    let want = gru.kernels().into_iter().fold(hidden, |h, [z, r, q]| {
        let through =
            |h: Tensor<4>, kernel: &Conv2d| kernel.forward(Tensor::cat(vec![h, x.clone()], 1));
        let (z, r) = (
            sigmoid(through(h.clone(), z)),
            sigmoid(through(h.clone(), r)),
        );
        let q = tanh(through(r * h.clone(), q));
        (z.ones_like() - z.clone()) * h + z * q
    });
    let [got, want]: [Vec<f32>; 2] = [got, want].map(|x| x.try_into_vec_as().unwrap());
    let error = relative_error(&got, &want);
    assert!(error < 1e-5, "{error:e}");
}

/// 16 bits are enough for a few iterations, and positions stay in 32.
#[test]
fn half_precision_stays_near() {
    let net = network();
    let fixture = Fixture::open("raft/flow.safetensors");
    let images = ["image1", "image2"].map(|name| fixture.image(name));
    let half = Raft {
        net: halved(net.net.clone()),
        device: net.device.clone(),
    };
    let [whole, half] = [&net, &half].map(|net| {
        let [a, b] = [0, 1].map(|i| net.encode(&images[i]).unwrap());
        let [flow, _] = net.flow_both(&a, &b, 2, None).unwrap();
        [flow.flow.u, flow.flow.v].concat()
    });
    let error = relative_error(&half, &whole);
    println!("half precision: {error:.1e}");
    // measured: at most 6.0e-3
    assert!(error < 1.5e-2, "{error:e}");
}
