//! RAFT against its authors' module, with synthetic weights.

use crate::common::loaded;
use m4_core::{Flow, Plane, RgbImage};
use m4_nets::cpu;
use m4_nets::raft::{Raft, RaftFlow};
use m4_testkit::{Fixture, FormulaWeights, assert_close, same_on_any_threads};

const KEYS: &str = include_str!("../../../fixtures/raft/keys.txt");

fn network() -> Raft {
    loaded(&FormulaWeights::of_keys(KEYS), |path| {
        Raft::load(path, cpu())
    })
}

fn pair() -> (Fixture, RgbImage, RgbImage) {
    let file = Fixture::open("raft/flow.safetensors");
    let (a, b) = (file.image("image1"), file.image("image2"));
    (file, a, b)
}

/// `want` `[2, h, w]` against `flow`. The module in f32 is 2e-6 from itself in f64.
fn assert_flow(name: &str, flow: &Flow, want: &[f32]) {
    assert_close(name, &[&flow.u[..], &flow.v].concat(), want, 2e-5);
}

#[test]
fn agrees_with_the_module_by_formula() {
    let net = network();
    let (file, a, b) = pair();
    let (a, b) = (net.encode(&a).unwrap(), net.encode(&b).unwrap());
    for iterations in [1, 4, 12] {
        let [forward, back] = net.flow_both(&a, &b, iterations, None).unwrap();
        let name = format!("flow_low_{iterations}");
        assert_flow(&name, &forward.low, &file.floats(&name).0);
        if iterations != 4 {
            let name = format!("flow_up_{iterations}");
            assert_flow(&name, &forward.flow, &file.floats(&name).0);
        }
        assert_ne!(forward, back);
        if iterations == 4 {
            assert_eq!(net.flow_both(&b, &a, 4, None).unwrap(), [back, forward]);
        }
    }
}

#[test]
fn a_warm_start_uses_the_given_flow() {
    let net = network();
    let (file, a, b) = pair();
    let (a, b) = (net.encode(&a).unwrap(), net.encode(&b).unwrap());
    let values = file.floats("flow_init").0;
    let (u, v) = values.split_at(16 * 20);
    let start = Flow {
        width: 20,
        height: 16,
        u: u.to_vec(),
        v: v.to_vec(),
    };
    let none = Flow {
        width: 20,
        height: 16,
        u: vec![0.0; 320],
        v: vec![0.0; 320],
    };
    let [warm, cold] = net.flow_both(&a, &b, 2, Some([&start, &none])).unwrap();
    assert_flow("warm2", &warm.low, &file.floats("flow_low_warm2").0);
    let [_, want] = net.flow_both(&a, &b, 2, None).unwrap();
    assert_eq!(cold, want, "each direction has its own start");
}

/// An image with an edge repeated by hand gets the flow of the one that is padded inside.
#[test]
fn odd_sizes_are_padded_and_cropped() {
    let net = network();
    let (_, a, b) = pair();
    for (w, h) in [(155, 128), (90, 33)] {
        let crop = |image: &RgbImage| Plane::from_fn(w, h, |x, y| image.row(y)[x]);
        let side = |n: usize| n.next_multiple_of(8).max(128);
        let (padded_w, padded_h) = (side(w), side(h));
        let (left, top) = ((padded_w - w) / 2, (padded_h - h) / 2);
        let pad = |image: &RgbImage| {
            Plane::from_fn(padded_w, padded_h, |x: usize, y: usize| {
                image.row(y.saturating_sub(top).min(h - 1))[x.saturating_sub(left).min(w - 1)]
            })
        };
        let flow = |a: &RgbImage, b: &RgbImage| -> RaftFlow {
            let [flow, _] = net
                .flow_both(&net.encode(a).unwrap(), &net.encode(b).unwrap(), 2, None)
                .unwrap();
            flow
        };
        let got = flow(&crop(&a), &crop(&b));
        let want = flow(&pad(&a), &pad(&b));
        assert_eq!((got.flow.width, got.flow.height), (w, h));
        assert_eq!((got.flow.u.len(), got.flow.v.len()), (w * h, w * h));
        assert_eq!(got.low, want.low);
        for y in 0..h {
            let inside = (y + top) * padded_w + left;
            assert_eq!(
                got.flow.u[y * w..][..w],
                want.flow.u[inside..][..w],
                "row {y}"
            );
            assert_eq!(
                got.flow.v[y * w..][..w],
                want.flow.v[inside..][..w],
                "row {y}"
            );
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let net = network();
    let (_, a, b) = pair();
    same_on_any_threads(|| {
        let (a, b) = (net.encode(&a).unwrap(), net.encode(&b).unwrap());
        net.flow_both(&a, &b, 3, None).unwrap()
    });
}

#[test]
fn zero_iterations_and_mismatched_sizes_are_refused() {
    let net = network();
    let small: RgbImage = Plane::filled(1, 1, [9, 9, 9]);
    let small = net.encode(&small).unwrap();
    let [flow, _] = net.flow_both(&small, &small, 1, None).unwrap();
    assert!(flow.flow.u[0].is_finite() && flow.flow.u.len() == 1);
    assert_eq!((flow.low.width, flow.low.height), (16, 16));
    let start = |width, height, numbers| {
        let (u, v) = (vec![0.0; 256], vec![0.0; numbers]);
        Flow {
            width,
            height,
            u,
            v,
        }
    };
    let other = net.encode(&Plane::filled(2, 1, [9, 9, 9])).unwrap();
    let from = |low: &Flow| {
        net.flow_both(&small, &small, 1, Some([&flow.low, low]))
            .map(drop)
    };
    for (result, message) in [
        (
            net.flow_both(&small, &small, 0, None).map(drop),
            "at least one iteration",
        ),
        (
            net.flow_both(&small, &other, 1, None).map(drop),
            "1 x 1 and 2 x 1 pixels",
        ),
        (
            net.encode(&Plane::filled(0, 4, [9; 3])).map(drop),
            "images with pixels",
        ),
        (
            from(&start(15, 16, 256)),
            "has 15 x 16 pixels (256 numbers), these images need 16 x 16",
        ),
        (
            from(&start(16, 16, 255)),
            "has 16 x 16 pixels (255 numbers), these images need 16 x 16",
        ),
    ] {
        let error = result.unwrap_err();
        assert!(error.to_string().contains(message), "{error}");
    }
}
