//! A backend that must be waited for gives the bits of one that need not, and one that fails leaves
//! the last splats that were checked.

use crate::common::{FRAMES, disturbed, video};
use crate::watched::{Calls, Watched};
use m4_core::{Silent, Splats};
use m4_kernels::SimdLevel;
use m4_train::backend::CpuBackend;
use m4_train::{
    ColourDegree, DensityConfig, TrainConfig, TrainError, Trainer, config::SplitPlacement,
    init::FirstSplats,
};
use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Density control and a fit of colours within this many steps.
fn config() -> TrainConfig {
    let mut config = TrainConfig::fast();
    config.iterations = 100;
    config.seed = 5;
    config.density = DensityConfig {
        from: 0.2,
        every: 0.2,
        prune_every: 0.4,
        ..DensityConfig::fast()
    };
    config.guard_every = 25;
    config.keep_every_s = 0.0;
    config
}

#[test]
fn asynchronous_steps_give_the_same_bits() {
    let (scene, capture) = video();
    let mut cameras = config();
    let refine = &mut cameras.refine;
    (refine.poses, refine.focal, refine.exposure, refine.from) = (true, true, true, 20);
    let mut paths = cameras.clone();
    paths.refine.focal = false;
    let density = DensityConfig {
        enabled: false,
        ..DensityConfig::faithful()
    };
    let faithful = TrainConfig {
        iterations: 60,
        keep_every_s: 1e9,
        density,
        ..TrainConfig::faithful()
    };
    let drawn = DensityConfig {
        split_placement: SplitPlacement::Sample,
        ..config().density
    };
    let literal = DensityConfig {
        split_placement: SplitPlacement::Halves,
        final_opacity: 0.1,
        from: 0.2,
        every: 0.2,
        prune_every: 0.2,
        ..DensityConfig::literal()
    };
    for (config, rounds, most_waits) in [
        (config(), 4, 20),
        (cameras, 4, 100),
        // all frames are drawn before one of them is drawn twice
        (paths.clone(), 4, 20 + 3 * 80 / FRAMES),
        (TrainConfig { batch: 3, ..paths }, 4, 80),
        (
            TrainConfig {
                batch: 3,
                colour_degree: ColourDegree { space: 1, time: 2 },
                ..config()
            },
            4,
            20,
        ),
        (faithful, 0, 20),
        (
            TrainConfig {
                density: drawn,
                ..config()
            },
            4,
            20,
        ),
        (
            TrainConfig {
                density: literal,
                keep_every_s: 1e9,
                ..config()
            },
            6,
            20,
        ),
    ] {
        let run = |calls: Option<&Arc<Calls>>| {
            let splats = disturbed(&scene, 2);
            let mut trainer =
                Trainer::new(&capture, splats, config.clone(), SimdLevel::best()).unwrap();
            if let Some(calls) = calls {
                let cpu = CpuBackend::new(&capture, 0, SimdLevel::best());
                trainer
                    .use_backend(Box::new(Watched::new(Box::new(cpu), calls)))
                    .unwrap();
            }
            let mut events = Vec::new();
            // stopped and asked in between, as checkpoints do
            trainer
                .run_until(37, &Silent, &mut |e| events.push(*e))
                .unwrap();
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
        let calls = Arc::default();
        let (plain, watched) = (run(None), run(Some(&calls)));
        assert!(plain.0 == watched.0, "after 37 steps");
        assert!(plain.1 == watched.1, "at the end");
        assert!(plain.2 == watched.2, "the optimiser's state");
        assert_eq!(plain.3, watched.3, "splats");
        for (i, (a, b)) in plain.4.iter().zip(&watched.4).enumerate() {
            assert!((a - b).abs() < 1e-9, "loss of event {i}: {a} and {b}");
        }
        assert_eq!(
            calls.rounds.load(Ordering::Relaxed),
            rounds,
            "rounds of density control"
        );
        let waits = calls.waits.load(Ordering::Relaxed);
        assert!(waits <= most_waits, "{waits} waits");
        let (first, last) = (disturbed(&scene, 2).n(), plain.1.splats.n());
        assert_eq!(rounds > 0, first != last, "{first} splats became {last}");
    }
}

#[test]
fn densification_by_gradients_adds_splats_on_every_backend() {
    let (scene, capture) = video();
    let density = DensityConfig {
        from: 0.2,
        every: 0.2,
        ..DensityConfig::by_gradient()
    };
    let config = TrainConfig {
        density,
        ..config()
    };
    let run = |stops: &[usize], calls: Option<&Arc<Calls>>| {
        let mut trainer = Trainer::new(
            &capture,
            disturbed(&scene, 2),
            config.clone(),
            SimdLevel::best(),
        )
        .unwrap();
        if let Some(calls) = calls {
            let cpu = CpuBackend::new(&capture, 0, SimdLevel::best());
            trainer
                .use_backend(Box::new(Watched::new(Box::new(cpu), calls)))
                .unwrap();
        }
        for &stop in stops {
            trainer.run_until(stop, &Silent, &mut |_| {}).unwrap();
        }
        trainer.scene()
    };
    let here = run(&[100], None);
    let (first, last) = (disturbed(&scene, 2).n(), here.splats.n());
    assert!(
        last > first && last <= 5 * first,
        "{first} splats became {last}"
    );
    assert!(
        here.splats.is_finite() && run(&[37, 100], None) == here,
        "stopped in between"
    );
    assert!(
        run(&[100], Some(&Arc::default())) == here,
        "on another backend"
    );
}

#[test]
fn a_backend_that_fails_leaves_the_last_good_splats() {
    let (scene, capture) = video();
    let watched = |calls: &Arc<Calls>| {
        Watched::new(
            Box::new(CpuBackend::new(&capture, 0, SimdLevel::best())),
            calls,
        )
    };
    let run_with = |watched: Watched<'_>, config: TrainConfig, iterations: usize| {
        let mut trainer =
            Trainer::new(&capture, disturbed(&scene, 2), config, SimdLevel::best()).unwrap();
        trainer.use_backend(Box::new(watched)).unwrap();
        let end = trainer.run_until(iterations, &Silent, &mut |_| {});
        (end, trainer.scene(), trainer.iteration())
    };
    let failing = |fails_at, calls: &Arc<Calls>| {
        let mut watched = watched(calls);
        watched.fails_at = fails_at;
        watched
    };
    let run =
        |fails_at, iterations| run_with(failing(fails_at, &Arc::default()), config(), iterations);
    let (end, splats, at) = run(31, 100);
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
        ("the backend broke", 30, 25, 25)
    );
    let (end, expected, _) = run(0, 25);
    end.unwrap();
    assert!(splats == expected);

    // the CPU goes on from there
    let mut trainer =
        Trainer::new(&capture, disturbed(&scene, 2), config(), SimdLevel::best()).unwrap();
    trainer
        .use_backend(Box::new(failing(31, &Arc::default())))
        .unwrap();
    assert!(trainer.run_until(100, &Silent, &mut |_| {}).is_err());
    trainer.use_cpu(SimdLevel::best()).unwrap();
    let mut losses = Vec::new();
    trainer
        .run_until(100, &Silent, &mut |event| losses.push(event.loss))
        .unwrap();
    assert_eq!(trainer.iteration(), 100);
    assert!(
        trainer.splats().is_finite() && losses.last() < losses.first(),
        "{losses:?}"
    );

    // splats are not copied more often than the settings say
    let rarely = TrainConfig {
        keep_every_s: 1e9,
        ..config()
    };
    let calls = Arc::default();
    let (end, splats, at) = run_with(failing(71, &calls), rarely, 100);
    assert!(
        matches!(
            end,
            Err(TrainError::Device {
                good_iteration: 0,
                ..
            })
        ),
        "{end:?}"
    );
    assert_eq!((at, calls.rounds.load(Ordering::Relaxed)), (0, 3));
    let (_, expected, _) = run(0, 0);
    assert!(splats == expected);

    // the backend says at the next check that a number is not finite
    let mut broken = watched(&calls);
    broken.breaks_at = 41;
    let (end, splats, at) = run_with(broken, config(), 100);
    // which the CPU does not find when it repeats the steps, so the machine is at fault
    let Err(TrainError::Device {
        why,
        iteration,
        good_iteration,
    }) = end
    else {
        panic!("{end:?}");
    };
    assert!(
        why.contains("a parameter of a splat") && why.contains("which the CPU does not"),
        "{why}"
    );
    assert_eq!((iteration, good_iteration, at), (50, 50, 50));
    assert!(splats.splats.is_finite());
    // nor is the machine charged with a run that diverges everywhere
    let mut hot = config();
    hot.lr.colour = 1e38;
    let (end, splats, _) = run_with(watched(&Arc::default()), hot, 100);
    assert!(matches!(end, Err(TrainError::Diverged { .. })), "{end:?}");
    assert!(splats.splats.is_finite());
}

/// The bits of static splats, in no order.
fn static_bits(splats: &Splats, rows: impl Iterator<Item = usize>) -> HashSet<Vec<u32>> {
    let columns = splats.columns();
    let shared = &columns[..splats.layout().shared_columns()];
    rows.map(|row| shared.iter().map(|column| column[row].to_bits()).collect())
        .collect()
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
        let first = FirstSplats {
            splats: splats.clone(),
            fixed,
        };
        Trainer::new(&capture, first, config(), level).unwrap()
    };
    let unchanged_count = |trainer: &Trainer<'_>| {
        let now = static_bits(trainer.splats(), 0..trainer.splats().n_static());
        bits.intersection(&now).count()
    };
    let finish = |trainer: &mut Trainer<'_>| trainer.run(&Silent, &mut |_| {}).map(|_| ());

    let mut free = start(0..0);
    finish(&mut free).unwrap();
    assert!(
        2 * unchanged_count(&free) < bits.len(),
        "those in view are trained otherwise"
    );

    let mut whole = start(fixed.clone());
    finish(&mut whole).unwrap();
    assert_eq!(unchanged_count(&whole), bits.len());
    assert!(
        whole.splats().n() > splats.n(),
        "density control adds others"
    );

    let mut half = start(fixed.clone());
    half.run_until(37, &Silent, &mut |_| {}).unwrap();
    let (saved, state) = (half.scene(), half.state());
    let mut rest = Trainer::resume(&capture, saved.splats, &state, config(), level).unwrap();
    finish(&mut rest).unwrap();
    assert!(rest.scene() == whole.scene(), "resumed");

    let dynamic = splats.n_static()..splats.n();
    assert!(
        start(dynamic).state() == start(0..0).state(),
        "dynamic splats are trained all the same"
    );

    // without the state of the optimiser, which a device keeps for itself when it fails
    let mut broken = Watched::new(
        Box::new(CpuBackend::new(&capture, 0, level)),
        &Arc::default(),
    );
    broken.fails_at = 31;
    let mut moved = start(fixed);
    moved.use_backend(Box::new(broken)).unwrap();
    assert!(finish(&mut moved).is_err());
    moved.use_cpu(level).unwrap();
    finish(&mut moved).unwrap();
    assert_eq!(unchanged_count(&moved), bits.len(), "after a device failed");
}
