//! Training on a device is training: one that is made of the processor's own kernels ends with the bits of a run
//! without a device, and one that fails leaves the last splats that were looked at.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

mod mirror;

use crate::common::{disturbed, video};
use m4_core::Silent;
use m4_kernels::SimdLevel;
use m4_train::{DensityConfig, TrainConfig, TrainError, Trainer, config::SplitPlacement};
use mirror::Mirror;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Density control, a fit of colours and a new order within this many steps.
fn config() -> TrainConfig {
    let mut config = TrainConfig::fast();
    config.iterations = 100;
    config.seed = 5;
    config.density = DensityConfig {
        from: 20,
        every: 20,
        prune_every: 40,
        ..DensityConfig::fast()
    };
    config.reorder_every = 30;
    config.guard_every = 25;
    config.keep_every_s = 0.0;
    config
}

#[test]
fn a_device_of_the_same_kernels_gives_the_same_bits() {
    let (scene, capture) = video();
    let mut cameras = config();
    let refine = &mut cameras.refine;
    (refine.poses, refine.focal, refine.exposure, refine.from) = (true, true, true, 20);
    let faithful = TrainConfig {
        iterations: 60,
        keep_every_s: 1e9,
        ..TrainConfig::faithful()
    };
    let drawn = DensityConfig {
        split_placement: SplitPlacement::Sample,
        ..config().density
    };
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
        // random draws are the trainer's; the last pruning is not one
        (
            TrainConfig {
                density: drawn,
                ..config()
            },
            1,
        ),
        (
            TrainConfig {
                density: literal,
                keep_every_s: 1e9,
                ..config()
            },
            6,
        ),
    ] {
        let run = |device: Option<Option<&Arc<AtomicUsize>>>| {
            let splats = disturbed(&scene, 2);
            let mut trainer = Trainer::new(&capture, splats, config.clone(), SimdLevel::best()).unwrap();
            if let Some(rounds) = device {
                trainer.use_device(Box::new(Mirror::new(0, rounds)));
            }
            let mut events = Vec::new();
            // stopped and asked in between, as checkpoints do
            trainer.run_until(37, &Silent, &mut |e| events.push(*e)).unwrap();
            let middle = trainer.scene();
            trainer.run(&Silent, &mut |e| events.push(*e)).unwrap();
            let counts: Vec<_> = events
                .iter()
                .map(|e| (e.iteration, e.splats_static, e.splats_dynamic))
                .collect();
            let losses: Vec<f64> = events.iter().map(|e| e.loss).collect();
            let state = format!("{:?}", trainer.state());
            (middle, trainer.scene(), state, counts, losses)
        };
        let rounds = Arc::new(AtomicUsize::new(0));
        let here = run(None);
        for (there, who) in [
            (run(Some(Some(&rounds))), "the device"),
            (run(Some(None)), "the trainer"),
        ] {
            assert!(here.0 == there.0, "after 37 steps, {who} decides");
            assert!(here.1 == there.1, "at the end, {who} decides");
            assert!(here.2 == there.2, "the optimiser's state, {who} decides");
            assert_eq!(here.3, there.3, "splats, {who} decides");
            for (i, (a, b)) in here.4.iter().zip(&there.4).enumerate() {
                assert!((a - b).abs() < 1e-9, "loss of event {i}: {a} and {b}");
            }
        }
        assert_eq!(
            rounds.load(Ordering::Relaxed),
            own,
            "rounds that the device did by itself"
        );
        let (first, last) = (disturbed(&scene, 2).n(), here.1.splats.n());
        assert_eq!(own > 0, first != last, "{first} splats became {last}");
    }
}

#[test]
fn a_device_that_fails_leaves_the_last_good_splats() {
    let (scene, capture) = video();
    let run_with = |mirror: Mirror, config: TrainConfig, iterations: usize| {
        let mut trainer = Trainer::new(&capture, disturbed(&scene, 2), config, SimdLevel::best()).unwrap();
        trainer.use_device(Box::new(mirror));
        let end = trainer.run_until(iterations, &Silent, &mut |_| {});
        (end, trainer.scene(), trainer.iteration())
    };
    let run = |fails_at, iterations| run_with(Mirror::new(fails_at, None), config(), iterations);
    let (end, kept, at) = run(31, 100);
    let Err(TrainError::Device {
        why,
        iteration,
        good_iteration,
    }) = end
    else {
        panic!("{end:?}");
    };
    assert_eq!(
        (why.as_str(), iteration, good_iteration, at),
        ("the mirror broke", 30, 25, 25)
    );
    let (end, there, _) = run(0, 25);
    end.unwrap();
    assert!(kept == there);

    // what is kept is not brought more often than is asked for
    let rarely = TrainConfig {
        keep_every_s: 1e9,
        ..config()
    };
    let rounds = Arc::new(AtomicUsize::new(0));
    let (end, kept, at) = run_with(Mirror::new(71, Some(&rounds)), rarely, 100);
    assert!(
        matches!(end, Err(TrainError::Device { good_iteration: 0, .. })),
        "{end:?}"
    );
    assert_eq!((at, rounds.load(Ordering::Relaxed)), (0, 3));
    let (_, there, _) = run(0, 0);
    assert!(kept == there);

    // the device says at the next check that a number is not finite
    let mut broken = Mirror::new(0, Some(&rounds));
    broken.breaks_at = 41;
    let (end, kept, at) = run_with(broken, config(), 100);
    let Err(TrainError::Diverged {
        what,
        iteration,
        good_iteration,
    }) = end
    else {
        panic!("{end:?}");
    };
    assert_eq!(
        (what, iteration, good_iteration, at),
        ("a parameter of a splat", 50, 25, 25)
    );
    let (_, there, _) = run(0, 25);
    assert!(kept == there);
}
