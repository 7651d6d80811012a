//! Every loss term, its gradients and the descent against the original program in f64, and against central differences.

use super::fixture::{FRAMES, SIZE, Tensors, problem};
use crate::megasam::cvd::reference::{
    Problem, Term, descend, edge_weight, gradient_loss, normal_loss, normals, pair_losses, scale_invariant_loss,
};
use crate::megasam::cvd::{CvdSettings, Weights};
use m4_core::{CounterRng, Real};
use m4_testkit::{Agreement, assert_gradient, central_differences};

fn f64s<T: Real>(values: &[T]) -> Vec<f64> {
    values.iter().map(|v| v.f64()).collect()
}

/// All terms at the disparity and uncertainty of the file.
fn terms<T: Real>(file: &Tensors) -> [(&'static str, Term<T>); 5] {
    let problem: Problem<T> = problem(file);
    let get = |name: &str| file.get(name).into_iter().map(T::of).collect::<Vec<T>>();
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
    let file = Tensors::open("losses.safetensors");
    let mut total = 0.0;
    for ((name, term), weight) in terms::<f64>(&file).into_iter().zip([1.0, 0.2, 1.0, 5.0, 2.0]) {
        let want = file.get(&format!("value_{name}"))[0];
        assert!(
            (term.value - want).abs() < 1e-8 * want,
            "{name}: {} for {want}",
            term.value
        );
        total += weight * term.value;
        let kinks = 4;
        let gradient = file.get(&format!("grad_disp_{name}"));
        assert_up_to_kinks(name, &term.disparity, &gradient, 1e-8, kinks);
        if matches!(name, "ratio" | "flow") {
            let gradient = file.get(&format!("grad_u_{name}"));
            assert_up_to_kinks(name, &term.uncertainty, &gradient, 1e-8, kinks);
        } else {
            assert!(term.uncertainty.iter().all(|&g| g == 0.0));
        }
    }
    assert!((total - file.get("value_total")[0]).abs() < 1e-8);
}

#[test]
fn in_f32_they_are_so_up_to_rounding() {
    let file = Tensors::open("losses.safetensors");
    for (name, term) in terms::<f32>(&file) {
        let want = file.get(&format!("value_{name}"))[0];
        assert!((term.value.f64() - want).abs() < 1e-4 * want, "{name}");
        let gradient = file.get(&format!("grad_disp_{name}"));
        assert_up_to_kinks(name, &f64s(&term.disparity), &gradient, 1e-4, 8);
    }
}

#[test]
fn normals_and_edge_weights_are_those_of_the_original() {
    let file = Tensors::open("losses.safetensors");
    let p: Problem<f64> = problem(&file);
    let n = SIZE.0 * SIZE.1;
    let want = file.get("normals_init");
    for frame in 0..FRAMES {
        let initial = &p.initial[frame * n..(frame + 1) * n];
        let found = normals(SIZE.0, SIZE.1, &p.lens, initial);
        for i in 0..n {
            for c in 0..3 {
                assert!((found[i][c] - want[(3 * frame + c) * n + i]).abs() < 1e-10);
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
    let file = Tensors::open("losses.safetensors");
    let want = Tensors::open("optimiser.safetensors");
    for steps in [1, 8] {
        // the second stage starts where eight steps of the first one lead
        let settings = CvdSettings { steps: [8, steps] };
        let got = descend(&problem::<f64>(&file), &file.get("uncertainty"), &settings);
        assert_gradient(
            "s2 disparity",
            &got.disparity,
            &want.get(&format!("s2_disp_{steps}")),
            1e-8,
        );
        assert_gradient("s2 u", &got.uncertainty, &want.get(&format!("s2_u_{steps}")), 1e-8);
        assert_gradient("s1 losses", &got.losses[0], &want.get("s1_losses"), 1e-8);
        assert_gradient("s2 losses", &got.losses[1], &want.get("s2_losses")[..steps], 1e-8);
        let settings = CvdSettings { steps: [steps, 0] };
        let got = descend(&problem::<f64>(&file), &file.get("uncertainty"), &settings);
        assert_gradient(
            "scale",
            &got.log_scale,
            &want.get(&format!("s1_log_scale_{steps}")),
            1e-8,
        );
        assert_gradient("shift", &got.shift, &want.get(&format!("s1_shift_{steps}")), 1e-8);
        assert_gradient("s1 u", &got.uncertainty, &want.get(&format!("s1_u_{steps}")), 1e-8);
    }
}

/// Of the total with all terms. The gradient term's weight is a constant by definition, so central
/// differences of it would be of another function: it has weight 0 here and the fixture above.
#[test]
fn gradients_are_central_differences() {
    let file = Tensors::open("losses.safetensors");
    let p: Problem<f64> = problem(&file);
    let mut rng = CounterRng::new(3, 1, 4);
    let weights = Weights {
        gradient: 0.0,
        ..Weights::STAGE2
    };
    let (d, u) = (file.get("disp"), file.get("uncertainty"));
    let total = p.total(&d, &u, &weights);
    let picked: Vec<usize> = (0..60).map(|_| rng.below(d.len())).collect();
    let moved = |base: &[f64], x: &[f64]| {
        let mut out = base.to_vec();
        picked.iter().zip(x).for_each(|(&i, &x)| out[i] = x);
        out
    };
    let at = |v: &[f64]| picked.iter().map(|&i| v[i]).collect::<Vec<f64>>();
    let by_d = central_differences(&at(&d), 1e-6, |x| p.total(&moved(&d, x), &u, &weights).value);
    let by_u = central_differences(&at(&u), 1e-6, |x| p.total(&d, &moved(&u, x), &weights).value);
    assert_gradient("u", &at(&total.uncertainty), &by_u.gradient, 1e-5);
    assert_up_to_kinks("disparity", &at(&total.disparity), &by_d.gradient, 1e-5, 2);
}
