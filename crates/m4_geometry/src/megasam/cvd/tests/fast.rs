//! The fast path against the definition and the original's numbers.

use super::{FRAMES, SIZE, problem};
use crate::megasam::cvd::Weights;
use crate::megasam::cvd::fast::{Descent, Moves, Start};
use crate::megasam::cvd::optimise::{Course, run};
use crate::megasam::cvd::pairs::{CompactFlow, FramePair, MASKED, PairStore};
use crate::megasam::cvd::reference::{Problem, descend};
use crate::published::Golden;
use m4_core::{Flow, Silent, SimdLevel};
use m4_testkit::{Agreement, on_every_level};

const PIXELS: usize = SIZE.0 * SIZE.1;

/// The fixture's pairs in the compact form, and the fixture with the flow that this form holds.
fn compacted(budget: usize) -> (PairStore, Problem<f64>) {
    let mut problem: Problem<f64> = problem(&Golden::load("cvd/losses.safetensors"));
    let mut store = PairStore::new(SIZE.0, SIZE.1, budget);
    for (k, pair) in problem.pairs.iter_mut().enumerate() {
        let flow = Flow {
            width: SIZE.0,
            height: SIZE.1,
            u: f32s(&pair.x),
            v: f32s(&pair.y),
        };
        let of = FramePair {
            source: pair.source,
            target: pair.target,
        };
        store.push(of, &flow, &pair.mask).unwrap();
        let mut buffer = CompactFlow::default();
        let field = store.flow(k, &mut buffer).unwrap();
        for (row, codes) in field.codes.chunks_exact(2 * 48).enumerate() {
            for column in 0..SIZE.0 {
                let i = row * SIZE.0 + column;
                assert_eq!(codes[column] != MASKED, pair.mask[i]);
                if pair.mask[i] {
                    pair.x[i] = f64::from(codes[column]) * f64::from(field.unit_px);
                    pair.y[i] = f64::from(codes[48 + column]) * f64::from(field.unit_px);
                }
            }
        }
    }
    (store, problem)
}

fn f32s(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&v| v as f32).collect()
}

fn descent<'a>(
    level: SimdLevel,
    problem: &Problem<f64>,
    store: &'a PairStore,
    disparity: &[f32],
    uncertainty: &[f32],
) -> Descent<'a> {
    let starts: Vec<Start<'_>> = (0..FRAMES)
        .map(|i| Start {
            disparity: &disparity[i * PIXELS..(i + 1) * PIXELS],
            uncertainty: &uncertainty[i * PIXELS..(i + 1) * PIXELS],
        })
        .collect();
    Descent::new(
        level,
        [problem.lens, problem.normal_lens],
        &problem.w2c,
        store,
        &starts,
    )
}

fn flat(planes: Vec<Vec<f32>>) -> Vec<f64> {
    planes.concat().into_iter().map(f64::from).collect()
}

const LEVELS: [&str; 3] = ["sse2", "avx2", "avx512"];

/// After a first step with a large epsilon the variables have moved by the gradient times a known
/// factor. The state is taken away from the initial one first, or the shape terms would have no
/// gradient.
#[test]
fn loss_and_gradients_are_those_of_the_definition() {
    let (store, problem) = compacted(usize::MAX);
    let only = |k: usize| {
        let mut w = [0.0; 5];
        w[k] = 1.0;
        Weights {
            ratio: w[0],
            flow: w[1],
            scale_invariant: w[2],
            gradient: w[3],
            normal: w[4],
        }
    };
    let names = ["ratio", "flow", "si", "grad", "normal"];
    on_every_level(&SimdLevel::available(), SimdLevel::name, &LEVELS, |level| {
        for (k, name) in names.into_iter().enumerate() {
            let u0 = f32s(&Golden::load("cvd/losses.safetensors").values("uncertainty"));
            let mut fast = descent(level, &problem, &store, &f32s(&problem.initial), &u0);
            fast.begin();
            for step in 1..=3 {
                fast.step(Moves::Pixels, &Weights::STAGE2, 5e-3, 1e-8, step)
                    .unwrap();
            }
            let [d, u] = [flat(fast.disparity()), flat(fast.uncertainty())];
            // the moments of the steps so far would be added to the gradient
            let want = problem.total(&d, &u, &only(k));
            let mut fast = descent(level, &problem, &store, &f32s(&problem.initial), &f32s(&u));
            fast.begin();
            fast.place(&f32s(&d));
            let factor = 100.0;
            let report = fast
                .step(Moves::Pixels, &only(k), factor * 1e3, 1e3, 1)
                .unwrap();
            assert!(
                (report.loss - want.value).abs() < 2e-5 * want.value.abs(),
                "{name} on {}: {} for {}",
                level.name(),
                report.loss,
                want.value
            );
            let moved = |before: &[f64], after: Vec<f64>| -> Vec<f64> {
                before
                    .iter()
                    .zip(after)
                    .map(|(b, a)| (b - a) / factor)
                    .collect()
            };
            let gradients = [
                (moved(&d, flat(fast.disparity())), &want.disparity),
                (moved(&u, flat(fast.uncertainty())), &want.uncertainty),
            ];
            for (got, want) in gradients.into_iter().take(if k < 2 { 2 } else { 1 }) {
                let largest = want.iter().fold(0.0f64, |m, g| m.max(g.abs()));
                assert!(largest > 0.0, "{name}: the test compares nothing");
                let near = |i: &usize| (got[*i] - want[*i]).abs() <= 3e-4 * largest;
                let off = got.len() - (0..got.len()).filter(near).count();
                let a = Agreement::of(&got, want);
                assert!(
                    off <= got.len() / 500 && a.cosine > 1.0 - 2e-4 && a.relative_l2 < 2e-2,
                    "{name} on {}: {off} entries off, {a:?}",
                    level.name()
                );
            }
        }
    });
}

#[test]
fn eight_steps_of_both_stages_are_those_of_the_original() {
    let (store, problem) = compacted(usize::MAX);
    let want = Golden::load("cvd/optimiser.safetensors");
    let u0 = f32s(&Golden::load("cvd/losses.safetensors").values("uncertainty"));
    on_every_level(&SimdLevel::available(), SimdLevel::name, &LEVELS, |level| {
        let mut fast = descent(level, &problem, &store, &f32s(&problem.initial), &u0);
        let Course { affine, losses, .. } = run(&mut fast, 16, [8, 8], &Silent).unwrap();
        for (frame, (scale, shift)) in affine.into_iter().enumerate() {
            assert!((scale.ln() - want.values("s1_log_scale_8")[frame]).abs() < 1e-4);
            assert!((shift - want.values("s1_shift_8")[frame]).abs() < 1e-4);
        }
        for (got, name) in losses.iter().zip(["s1_losses", "s2_losses"]) {
            for (got, want) in got.iter().zip(want.values(name)) {
                assert!((got - want).abs() < 1e-4 * want, "{name}: {got} for {want}");
            }
        }
        // Adam makes whole steps of tiny gradients, whose sign is rounding: a few pixels go the
        // other way
        for (what, got, want) in [
            (
                "disparity",
                flat(fast.disparity()),
                want.values("s2_disp_8"),
            ),
            ("u", flat(fast.uncertainty()), want.values("s2_u_8")),
        ] {
            let off = (0..got.len())
                .filter(|&i| (got[i] - want[i]).abs() > 1e-4)
                .count();
            let a = Agreement::of(&got, &want);
            assert!(
                off < got.len() / 30 && a.relative_l2 < 5e-4,
                "{what} on {}: {off} pixels off, {a:?}",
                level.name()
            );
        }
    });
}

#[test]
fn fast_descent_matches_the_reference() {
    let (store, problem) = compacted(usize::MAX);
    let u0 = Golden::load("cvd/losses.safetensors").values("uncertainty");
    let steps = [30, 60];
    let want = descend(&problem, &u0, steps);
    let mut fast = descent(
        SimdLevel::best(),
        &problem,
        &store,
        &f32s(&problem.initial),
        &f32s(&u0),
    );
    let Course { losses, .. } = run(&mut fast, 16, steps, &Silent).unwrap();
    let (first, last) = (want.losses[0][0], want.losses[1][59]);
    assert!(last < 0.8 * first, "{first} {last}");
    assert!(
        (losses[1][59] - last).abs() < 1e-3 * last,
        "{} for {last}",
        losses[1][59]
    );
    let a = Agreement::of(&flat(fast.disparity()), &want.disparity);
    assert!(a.relative_l2 < 1e-2, "{a:?}");
}

fn bits(threads: usize, budget: usize) -> Vec<u32> {
    let (store, problem) = compacted(budget);
    let u0 = f32s(&Golden::load("cvd/losses.safetensors").values("uncertainty"));
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap();
    pool.install(|| {
        let mut fast = descent(
            SimdLevel::best(),
            &problem,
            &store,
            &f32s(&problem.initial),
            &u0,
        );
        let Course { losses, .. } = run(&mut fast, 16, [3, 4], &Silent).unwrap();
        let values = [fast.disparity().concat(), fast.uncertainty().concat()].concat();
        let losses = losses.concat().into_iter().map(|l| l as f32);
        values.into_iter().chain(losses).map(f32::to_bits).collect()
    })
}

#[test]
fn bits_are_independent_of_threads_and_flow_storage() {
    let want = bits(1, usize::MAX);
    for threads in [2, 3, 7] {
        assert!(bits(threads, usize::MAX) == want, "{threads} threads");
    }
    assert!(bits(3, 0) == want, "from the file");
}
