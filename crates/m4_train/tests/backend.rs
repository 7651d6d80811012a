//! A backend that must be waited for gives the bits of one that need not, and one that fails leaves the last splats that were checked.

use crate::common::{Watched, disturbed, video};
use m4_core::{Silent, Splats};
use m4_kernels::SimdLevel;
use m4_train::backend::CpuBackend;
use m4_train::{DensityConfig, TrainConfig, TrainError, Trainer, config::SplitPlacement, init::FirstSplats};
use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Density control and a fit of colours within this many steps.
fn config() -> TrainConfig {
    let mut config = TrainConfig::fast();
    config.iterations = 100;
    config.seed = 5;
    config.density = DensityConfig { from: 20, every: 20, prune_every: 40, ..DensityConfig::fast() };
    config.guard_every = 25;
    config.keep_every_s = 0.0;
    config
}

#[test]
fn asynchronous_steps_and_density_control_of_the_trainer_give_the_same_bits() {
    let (scene, capture) = video();
    let mut cameras = config();
    let refine = &mut cameras.refine;
    (refine.poses, refine.focal, refine.exposure, refine.from) = (true, true, true, 20);
    let faithful = TrainConfig { iterations: 60, keep_every_s: 1e9, ..TrainConfig::faithful() };
    let drawn = DensityConfig { split_placement: SplitPlacement::Sample, ..config().density };
    let literal = DensityConfig {
        split_placement: SplitPlacement::LongestAxis,
        final_opacity: 0.1,
        from: 20,
        every: 20,
        prune_every: 20,
        ..DensityConfig::faithful()
    };
    for (config, own) in [
        (config(), 4),
        (cameras, 4),
        (TrainConfig { batch: 3, ..config() }, 4),
        (faithful, 0),
        (TrainConfig { density: drawn, ..config() }, 4),
        (TrainConfig { density: literal, keep_every_s: 1e9, ..config() }, 6),
    ] {
        let run = |watched: Option<Option<&Arc<AtomicUsize>>>| {
            let splats = disturbed(&scene, 2);
            let mut trainer = Trainer::new(&capture, splats, config.clone(), SimdLevel::best()).unwrap();
            if let Some(rounds) = watched {
                let cpu = CpuBackend::new(&capture, 0, SimdLevel::best());
                trainer.use_backend(Box::new(Watched::new(Box::new(cpu), rounds))).unwrap();
            }
            let mut events = Vec::new();
            // stopped and asked in between, as checkpoints do
            trainer.run_until(37, &Silent, &mut |e| events.push(*e)).unwrap();
            let middle = trainer.scene();
            trainer.run(&Silent, &mut |e| events.push(*e)).unwrap();
            let counts: Vec<_> = events.iter().map(|e| (e.iteration, e.splats_static, e.splats_dynamic)).collect();
            let losses: Vec<f64> = events.iter().map(|e| e.loss).collect();
            let state = format!("{:?}", trainer.state());
            (middle, trainer.scene(), state, counts, losses)
        };
        let rounds = Arc::new(AtomicUsize::new(0));
        let here = run(None);
        for (there, decider) in [(run(Some(Some(&rounds))), "the backend"), (run(Some(None)), "the trainer")] {
            assert!(here.0 == there.0, "after 37 steps, {decider} decides");
            assert!(here.1 == there.1, "at the end, {decider} decides");
            assert!(here.2 == there.2, "the optimiser's state, {decider} decides");
            assert_eq!(here.3, there.3, "splats, {decider} decides");
            for (i, (a, b)) in here.4.iter().zip(&there.4).enumerate() {
                assert!((a - b).abs() < 1e-9, "loss of event {i}: {a} and {b}");
            }
        }
        assert_eq!(rounds.load(Ordering::Relaxed), own, "rounds of the backend");
        let (first, last) = (disturbed(&scene, 2).n(), here.1.splats.n());
        assert_eq!(own > 0, first != last, "{first} splats became {last}");
    }
}

#[test]
fn densification_by_gradients_adds_splats_on_the_cpu_and_is_refused_elsewhere() {
    let (scene, capture) = video();
    let density = DensityConfig { from: 20, every: 20, ..DensityConfig::by_gradient() };
    let config = TrainConfig { density, arcs: false, ..config() };
    let start = || Trainer::new(&capture, disturbed(&scene, 2), config.clone(), SimdLevel::best()).unwrap();
    let run = |stops: &[usize]| {
        let mut trainer = start();
        for &stop in stops {
            trainer.run_until(stop, &Silent, &mut |_| {}).unwrap();
        }
        trainer.scene()
    };
    let scene_there = run(&[100]);
    let (first, last) = (disturbed(&scene, 2).n(), scene_there.splats.n());
    assert!(last > first && last <= 3 * first, "{first} splats became {last}");
    assert!(scene_there.splats.is_finite() && run(&[37, 100]) == scene_there, "stopped in between");
    let other = Watched::new(Box::new(CpuBackend::new(&capture, 0, SimdLevel::best())), None);
    let refused = start().use_backend(Box::new(other)).unwrap_err().to_string();
    assert!(refused.contains("density.loss_guided") && refused.contains("--device cpu"), "{refused}");
}

#[test]
fn a_backend_that_fails_leaves_the_last_good_splats() {
    let (scene, capture) = video();
    let watched = |rounds: Option<&Arc<AtomicUsize>>| {
        Watched::new(Box::new(CpuBackend::new(&capture, 0, SimdLevel::best())), rounds)
    };
    let run_with = |watched: Watched<'_>, config: TrainConfig, iterations: usize| {
        let mut trainer = Trainer::new(&capture, disturbed(&scene, 2), config, SimdLevel::best()).unwrap();
        trainer.use_backend(Box::new(watched)).unwrap();
        let end = trainer.run_until(iterations, &Silent, &mut |_| {});
        (end, trainer.scene(), trainer.iteration())
    };
    let failing = |fails_at, rounds: Option<&Arc<AtomicUsize>>| {
        let mut watched = watched(rounds);
        watched.fails_at = fails_at;
        watched
    };
    let run = |fails_at, iterations| run_with(failing(fails_at, None), config(), iterations);
    let (end, kept, at) = run(31, 100);
    let Err(TrainError::Device { why, iteration, good_iteration }) = end else {
        panic!("{end:?}");
    };
    assert_eq!((why.as_str(), iteration, good_iteration, at), ("the backend broke", 30, 25, 25));
    let (end, there, _) = run(0, 25);
    end.unwrap();
    assert!(kept == there);

    // the CPU goes on from there
    let mut trainer = Trainer::new(&capture, disturbed(&scene, 2), config(), SimdLevel::best()).unwrap();
    trainer.use_backend(Box::new(failing(31, None))).unwrap();
    assert!(trainer.run_until(100, &Silent, &mut |_| {}).is_err());
    trainer.use_cpu(SimdLevel::best()).unwrap();
    let mut losses = Vec::new();
    trainer.run_until(100, &Silent, &mut |event| losses.push(event.loss)).unwrap();
    assert_eq!(trainer.iteration(), 100);
    assert!(trainer.splats().is_finite() && losses.last() < losses.first(), "{losses:?}");

    // splats are not copied more often than the settings say
    let rarely = TrainConfig { keep_every_s: 1e9, arcs: false, ..config() };
    let rounds = Arc::new(AtomicUsize::new(0));
    let (end, kept, at) = run_with(failing(71, Some(&rounds)), rarely, 100);
    assert!(matches!(end, Err(TrainError::Device { good_iteration: 0, .. })), "{end:?}");
    assert_eq!((at, rounds.load(Ordering::Relaxed)), (0, 3));
    let (_, there, _) = run(0, 0);
    assert!(kept == there);

    // the backend says at the next check that a number is not finite
    let mut broken = watched(Some(&rounds));
    broken.breaks_at = 41;
    let (end, kept, at) = run_with(broken, config(), 100);
    let Err(TrainError::Diverged { what, iteration, good_iteration }) = end else {
        panic!("{end:?}");
    };
    assert_eq!((what, iteration, good_iteration, at), ("a parameter of a splat", 50, 25, 25));
    let (_, there, _) = run(0, 25);
    assert!(kept == there);
}

/// The bits of static splats, in no order.
fn static_bits(splats: &Splats, rows: impl Iterator<Item = usize>) -> HashSet<Vec<u32>> {
    let columns = splats.columns();
    let shared = &columns[..splats.layout().shared_columns()];
    rows.map(|row| shared.iter().map(|column| column[row].to_bits()).collect()).collect()
}

#[test]
fn fixed_splats_are_drawn_but_never_trained_cloned_or_pruned() {
    let (scene, capture) = video();
    let splats = disturbed(&scene, 2);
    let fixed = 3..splats.n_static() / 2;
    let bits = static_bits(&splats, fixed.clone());
    assert!(bits.len() == fixed.len() && bits.len() > 20);
    let level = SimdLevel::best();
    let start = |fixed: std::ops::Range<usize>| {
        let first = FirstSplats { splats: splats.clone(), fixed };
        Trainer::new(&capture, first, config(), level).unwrap()
    };
    let kept = |trainer: &Trainer<'_>| {
        let now = static_bits(trainer.splats(), 0..trainer.splats().n_static());
        bits.intersection(&now).count()
    };
    let finish = |trainer: &mut Trainer<'_>| trainer.run(&Silent, &mut |_| {}).map(|_| ());

    let mut free = start(0..0);
    finish(&mut free).unwrap();
    assert!(2 * kept(&free) < bits.len(), "those in view are trained otherwise");

    let mut whole = start(fixed.clone());
    finish(&mut whole).unwrap();
    assert_eq!(kept(&whole), bits.len());
    assert!(whole.splats().n() > splats.n(), "density control adds others");

    let mut half = start(fixed.clone());
    half.run_until(37, &Silent, &mut |_| {}).unwrap();
    let (saved, state) = (half.scene(), half.state());
    let mut rest = Trainer::resume(&capture, saved.splats, &state, config(), level).unwrap();
    finish(&mut rest).unwrap();
    assert!(rest.scene() == whole.scene(), "resumed");

    let dynamic = splats.n_static()..splats.n();
    assert!(start(dynamic).state() == start(0..0).state(), "dynamic splats are trained all the same");

    // without the state of the optimiser, which a device keeps for itself when it fails
    let mut broken = Watched::new(Box::new(CpuBackend::new(&capture, 0, level)), None);
    broken.fails_at = 31;
    let mut moved = start(fixed);
    moved.use_backend(Box::new(broken)).unwrap();
    assert!(finish(&mut moved).is_err());
    moved.use_cpu(level).unwrap();
    finish(&mut moved).unwrap();
    assert_eq!(kept(&moved), bits.len(), "after a device failed");
}
