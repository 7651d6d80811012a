//! Consistent video depth on `fixtures/cvd`: the definition against the numbers of the original
//! program, and the fast path against the definition.

mod fast;
mod optimise;

use super::Weights;
use super::pairs::{consistency_mask, halved, round_trip_px};
use super::reference::{
    Pair, Problem, Term, descend, edge_weight, gradient_loss, normal_loss, normals, pair_losses,
    scale_invariant_loss,
};
use crate::dba::Pinhole;
use crate::published::Golden;
use m4_core::nalgebra::{Quaternion, UnitQuaternion, Vector3};
use m4_core::{CounterRng, Flow, Real, Se3};
use m4_testkit::{Agreement, assert_gradient, central_differences};

const SIZE: (usize, usize) = (40, 32);
const FRAMES: usize = 6;

/// The problem of `losses.safetensors`, with the initial disparity and the edge weights of the
/// file.
fn problem<T: Real>(file: &Golden) -> Problem<T> {
    let get = |name: &str| file.values(name).into_iter().map(T::of).collect::<Vec<T>>();
    let n = SIZE.0 * SIZE.1;
    let (k, flows, masks) = (file.values("K"), get("flows"), file.values("flow_masks"));
    let (ii, jj) = (file.values("ii"), file.values("jj"));
    let pose = |p: &[f64]| {
        let turn = UnitQuaternion::new_normalize(Quaternion::new(p[6], p[3], p[4], p[5]));
        Se3 {
            rotation: turn.to_rotation_matrix().into_inner().map(T::of),
            translation: Vector3::new(p[0], p[1], p[2]).map(T::of),
        }
    };
    let lens = |shift_px: f64| Pinhole {
        fx: T::of(k[0]),
        fy: T::of(k[4]),
        cx: T::of(k[2] - shift_px),
        cy: T::of(k[5] - shift_px),
    };
    let pair = |i: usize| Pair {
        source: ii[i] as usize,
        target: jj[i] as usize,
        x: flows[2 * i * n..(2 * i + 1) * n].to_vec(),
        y: flows[(2 * i + 1) * n..(2 * i + 2) * n].to_vec(),
        mask: masks[i * n..(i + 1) * n]
            .iter()
            .map(|&m| m != 0.0)
            .collect(),
    };
    Problem {
        width: SIZE.0,
        height: SIZE.1,
        lens: lens(0.0),
        normal_lens: lens(0.5),
        w2c: file.values("poses").chunks_exact(7).map(pose).collect(),
        pairs: (0..ii.len()).map(pair).collect(),
        initial: get("init_disp"),
        edge_weight: get("fg_alpha"),
    }
}

fn f64s<T: Real>(values: &[T]) -> Vec<f64> {
    values.iter().map(|v| v.f64()).collect()
}

/// All terms at the disparity and uncertainty of the file.
fn terms<T: Real>(file: &Golden) -> [(&'static str, Term<T>); 5] {
    let problem: Problem<T> = problem(file);
    let get = |name: &str| file.values(name).into_iter().map(T::of).collect::<Vec<T>>();
    let (d, u) = (get("disp"), get("uncertainty"));
    let [ratio, flow] = pair_losses(&problem, &d, &u);
    [
        ("ratio", ratio),
        ("flow", flow),
        ("si", scale_invariant_loss(&problem, &d)),
        ("normal", normal_loss(&problem, &d)),
        ("grad", gradient_loss(&problem, &d)),
    ]
}

/// A tight bound for all but a few entries at kinks, a bound for those, and agreement as a whole.
fn assert_up_to_kinks(what: &str, got: &[f64], want: &[f64], tolerance: f64, kinks: usize) {
    let scale = want.iter().fold(0.0f64, |m, w| m.max(w.abs()));
    let near = |i: &usize| (got[*i] - want[*i]).abs() <= tolerance * scale;
    let off = want.len() - (0..want.len()).filter(near).count();
    let a = Agreement::of(got, want);
    assert!(
        off <= kinks && a.relative_l2 < 1e-2 && a.cosine > 1.0 - 1e-4,
        "{what}: {off} entries differ by more than {tolerance:e}, {a:?}"
    );
}

#[test]
fn values_and_gradients_are_those_of_the_original() {
    let file = Golden::load("cvd/losses.safetensors");
    let mut total = 0.0;
    for ((name, term), weight) in terms::<f64>(&file)
        .into_iter()
        .zip([1.0, 0.2, 1.0, 5.0, 2.0])
    {
        let want = file.values(&format!("value_{name}"))[0];
        assert!(
            (term.value - want).abs() < 1e-8 * want,
            "{name}: {} for {want}",
            term.value
        );
        total += weight * term.value;
        let kinks = 4;
        let gradient = file.values(&format!("grad_disp_{name}"));
        assert_up_to_kinks(name, &term.disparity, &gradient, 1e-8, kinks);
        if matches!(name, "ratio" | "flow") {
            let gradient = file.values(&format!("grad_u_{name}"));
            assert_up_to_kinks(name, &term.uncertainty, &gradient, 1e-8, kinks);
        } else {
            assert!(term.uncertainty.iter().all(|&g| g == 0.0));
        }
    }
    assert!((total - file.values("value_total")[0]).abs() < 1e-8);
}

#[test]
fn in_f32_they_are_so_up_to_rounding() {
    let file = Golden::load("cvd/losses.safetensors");
    for (name, term) in terms::<f32>(&file) {
        let want = file.values(&format!("value_{name}"))[0];
        assert!((term.value.f64() - want).abs() < 1e-4 * want, "{name}");
        let gradient = file.values(&format!("grad_disp_{name}"));
        assert_up_to_kinks(name, &f64s(&term.disparity), &gradient, 1e-4, 8);
    }
}

#[test]
fn normals_and_edge_weights_are_those_of_the_original() {
    let file = Golden::load("cvd/losses.safetensors");
    let p: Problem<f64> = problem(&file);
    let n = SIZE.0 * SIZE.1;
    let want = file.values("normals_init");
    for frame in 0..FRAMES {
        let initial = &p.initial[frame * n..(frame + 1) * n];
        let actual = normals(SIZE.0, SIZE.1, &p.normal_lens, initial);
        for i in 0..n {
            for c in 0..3 {
                assert!((actual[i][c] - want[(3 * frame + c) * n + i]).abs() < 1e-10);
            }
        }
        assert_eq!(
            edge_weight(SIZE.0, SIZE.1, initial),
            p.edge_weight[frame * n..(frame + 1) * n]
        );
    }
}

#[test]
fn eight_steps_of_both_stages_are_those_of_the_original() {
    let file = Golden::load("cvd/losses.safetensors");
    let want = Golden::load("cvd/optimiser.safetensors");
    for steps in [1, 8] {
        // the second stage starts where eight steps of the first one lead
        let got = descend(
            &problem::<f64>(&file),
            &file.values("uncertainty"),
            [8, steps],
        );
        assert_gradient(
            "s2 disparity",
            &got.disparity,
            &want.values(&format!("s2_disp_{steps}")),
            1e-8,
        );
        assert_gradient(
            "s2 u",
            &got.uncertainty,
            &want.values(&format!("s2_u_{steps}")),
            1e-8,
        );
        assert_gradient("s1 losses", &got.losses[0], &want.values("s1_losses"), 1e-8);
        assert_gradient(
            "s2 losses",
            &got.losses[1],
            &want.values("s2_losses")[..steps],
            1e-8,
        );
        let got = descend(
            &problem::<f64>(&file),
            &file.values("uncertainty"),
            [steps, 0],
        );
        assert_gradient(
            "scale",
            &got.log_scale,
            &want.values(&format!("s1_log_scale_{steps}")),
            1e-8,
        );
        assert_gradient(
            "shift",
            &got.shift,
            &want.values(&format!("s1_shift_{steps}")),
            1e-8,
        );
        assert_gradient(
            "s1 u",
            &got.uncertainty,
            &want.values(&format!("s1_u_{steps}")),
            1e-8,
        );
    }
}

/// Of the total with all terms. The gradient term's weight is a constant by definition, so central
/// differences of it would be of another function: it has weight 0 here and the fixture above.
#[test]
fn gradients_are_central_differences() {
    let file = Golden::load("cvd/losses.safetensors");
    let p: Problem<f64> = problem(&file);
    let mut rng = CounterRng::new(3, 1, 4);
    let weights = Weights {
        gradient: 0.0,
        ..Weights::STAGE2
    };
    let (d, u) = (file.values("disp"), file.values("uncertainty"));
    let total = p.total(&d, &u, &weights);
    let picked: Vec<usize> = (0..60).map(|_| rng.below(d.len())).collect();
    let moved = |base: &[f64], x: &[f64]| {
        let mut out = base.to_vec();
        picked.iter().zip(x).for_each(|(&i, &x)| out[i] = x);
        out
    };
    let at = |v: &[f64]| picked.iter().map(|&i| v[i]).collect::<Vec<f64>>();
    let by_d = central_differences(&at(&d), 1e-6, |x| {
        p.total(&moved(&d, x), &u, &weights).value
    });
    let by_u = central_differences(&at(&u), 1e-6, |x| {
        p.total(&d, &moved(&u, x), &weights).value
    });
    assert_gradient("u", &at(&total.uncertainty), &by_u.gradient, 1e-5);
    assert_up_to_kinks("disparity", &at(&total.disparity), &by_d.gradient, 1e-5, 2);
}

fn field(file: &Golden, name: &str, width: usize, height: usize) -> Flow {
    let values = file.values(name);
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
    let file = Golden::load("cvd/flow_consistency.safetensors");
    let half = ["fwd", "bwd"].map(|name| {
        let got = halved(&field(&file, &format!("flow_{name}"), 64, 48));
        let want = field(&file, &format!("half_{name}"), 32, 24);
        for (got, want) in got.u.iter().chain(&got.v).zip(want.u.iter().chain(&want.v)) {
            assert!((got - want).abs() < 1e-5, "{got} {want}");
        }
        got
    });
    let [forward, backward] = &half;
    let (error, want) = (round_trip_px(forward, backward), file.values("error"));
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
    let (mask, want_mask) = (consistency_mask(forward, backward), file.values("mask"));
    let (mut compared, mut outside) = (0, 0);
    for i in 0..mask.len() {
        let (x, y) = (
            (i % 32) as f32 + forward.u[i],
            (i / 32) as f32 + forward.v[i],
        );
        if !(0.0..=31.0).contains(&x) || !(0.0..=23.0).contains(&y) {
            outside += 1;
            assert!(!mask[i], "a pixel that leaves the frame counts");
        } else if (want[i] - 1.0).abs() > 0.1 {
            compared += 1;
            assert_eq!(
                mask[i],
                want_mask[i] != 0.0,
                "pixel {i} with error {}",
                want[i]
            );
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
    let mut forward = Flow {
        width: 4,
        height: 3,
        u: vec![0.0; 12],
        v: vec![0.0; 12],
    };
    let backward = forward.clone();
    forward.u[5] = f32::NAN;
    forward.v[6] = f32::INFINITY;
    let mask = consistency_mask(&forward, &backward);
    assert_eq!((0..12).filter(|&i| !mask[i]).collect::<Vec<_>>(), [5, 6]);
}
