//! The mask of the pairs against the original's (OpenCV and NumPy).

use super::fixture::Tensors;
use crate::megasam::cvd::pairs::{FlowView, consistency_mask, round_trip_px};
use m4_core::Flow;

fn field(file: &Tensors, name: &str, width: usize, height: usize) -> Flow {
    let values = file.get(name);
    let (pixels, _) = values.as_chunks::<2>();
    Flow {
        width,
        height,
        u: pixels.iter().map(|p| p[0] as f32).collect(),
        v: pixels.iter().map(|p| p[1] as f32).collect(),
    }
}

#[test]
fn halved_flows_and_masks_are_those_of_the_original() {
    let file = Tensors::open("flow_consistency.safetensors");
    let half = ["fwd", "bwd"].map(|name| {
        let got = FlowView::from(&field(&file, &format!("flow_{name}"), 64, 48)).halved();
        let want = field(&file, &format!("half_{name}"), 32, 24);
        for (got, want) in got.u.iter().chain(&got.v).zip(want.u.iter().chain(&want.v)) {
            assert!((got - want).abs() < 1e-5, "{got} {want}");
        }
        got
    });
    let [there, back] = half.each_ref().map(FlowView::from);
    let (error, want) = (round_trip_px(there, back), file.get("error"));
    // the original rounds positions to 1/32 pixel
    let steepest = (0..error.len())
        .map(|i| (f64::from(error[i]) - want[i]).abs())
        .fold(0.0, f64::max);
    assert!(steepest < 0.1, "{steepest}");
    let mean = (0..error.len())
        .map(|i| (f64::from(error[i]) - want[i]).abs())
        .sum::<f64>()
        / error.len() as f64;
    assert!(mean < 0.01, "{mean}");
    let (mask, want_mask) = (consistency_mask(there, back), file.get("mask"));
    let (mut compared, mut outside) = (0, 0);
    for i in 0..mask.len() {
        let (x, y) = ((i % 32) as f32 + there.x[i], (i / 32) as f32 + there.y[i]);
        if !(0.0..=31.0).contains(&x) || !(0.0..=23.0).contains(&y) {
            outside += 1;
            assert!(!mask[i], "a pixel that leaves the frame counts");
        } else if (want[i] - 1.0).abs() > 0.1 {
            compared += 1;
            assert_eq!(mask[i], want_mask[i] != 0.0, "pixel {i} with error {}", want[i]);
        }
    }
    let on = mask.iter().filter(|m| **m).count();
    assert!(compared > 500 && outside > 0, "{compared} {outside}");
    assert!(
        on > 50 && on < mask.len() - 50,
        "{on} pixels count: the fixture tests nothing"
    );
}

#[test]
fn nan_pixels_are_ignored() {
    let mut there = Flow {
        width: 4,
        height: 3,
        u: vec![0.0; 12],
        v: vec![0.0; 12],
    };
    let back = there.clone();
    there.u[5] = f32::NAN;
    there.v[6] = f32::INFINITY;
    let mask = consistency_mask((&there).into(), (&back).into());
    assert_eq!((0..12).filter(|&i| !mask[i]).collect::<Vec<_>>(), [5, 6]);
}
