//! The same seed gives the same bits: for any number of threads, and across a saved state.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use crate::common::{FRAMES, disturbed, video};
use crate::on_threads;
use m4_core::{Binding, Capture, Column, Pose, Silent, Splats, StateTensor, Window};
use m4_kernels::SimdLevel;
use m4_train::{ColourDegree, DensityConfig, TrainConfig, TrainError, Trainer};
use std::sync::Arc;

/// Every number of `splats` as bits.
fn bits(splats: &Splats) -> Vec<u32> {
    splats
        .columns()
        .iter()
        .flatten()
        .map(|v| v.to_bits())
        .collect()
}

/// Density control and refinement on.
fn config(iterations: usize) -> TrainConfig {
    let mut config = TrainConfig::fast();
    config.iterations = iterations;
    config.seed = 11;
    config.density = DensityConfig {
        from: 0.2,
        every: 0.2,
        prune_every: 0.4,
        ..DensityConfig::fast()
    };
    config.refine.poses = true;
    config.refine.focal = true;
    config.refine.exposure = true;
    config.refine.from = 10;
    config
}

/// Two frames per step, harmonics of colours and a fit of colours besides.
fn batched(iterations: usize) -> TrainConfig {
    let mut config = TrainConfig::fast();
    config.iterations = iterations;
    config.batch = 2;
    config.colour_fit_rounds = 2;
    config.density = DensityConfig {
        from: 0.2,
        every: 0.2,
        prune_every: 0.4,
        ..DensityConfig::fast()
    };
    config.refine.poses = true;
    config.refine.exposure = true;
    config.refine.from = 5;
    config.colour_degree = ColourDegree { space: 2, time: 1 };
    config
}

fn finish(trainer: &mut Trainer<'_>) -> Splats {
    trainer.run(&Silent, &mut |_| {}).unwrap();
    trainer.splats().clone()
}

fn start(capture: &Capture, splats: Splats, config: TrainConfig) -> Trainer<'_> {
    Trainer::new(capture, splats, config, SimdLevel::best()).unwrap()
}

#[test]
fn threads_do_not_change_a_bit() {
    let (scene, capture) = video();
    for config in [config(100), batched(40)] {
        let run = |threads| {
            on_threads(threads, || {
                finish(&mut start(&capture, disturbed(&scene, 2), config.clone()))
            })
        };
        let (one, two) = (run(1), run(2));
        assert_ne!(one.n(), scene.splats.n(), "density control did something");
        assert_eq!(one.n(), two.n());
        assert!(bits(&one) == bits(&two));
    }
}

#[test]
fn a_resumed_run_ends_with_the_bits_of_an_uninterrupted_one() {
    let (scene, capture) = video();
    for (config, stops) in [(config(200), &[100][..]), (batched(60), &[11, 12, 30, 37])] {
        let mut whole = start(&capture, disturbed(&scene, 3), config.clone());
        finish(&mut whole);
        for &stop in stops {
            let mut half = start(&capture, disturbed(&scene, 3), config.clone());
            half.run_until(stop, &Silent, &mut |_| {}).unwrap();
            let (saved, state) = (half.scene(), half.state());
            let mut rest = Trainer::resume(
                &capture,
                saved.splats,
                &state,
                config.clone(),
                SimdLevel::best(),
            )
            .unwrap();
            assert_eq!(rest.iteration(), stop);
            finish(&mut rest);
            assert!(
                bits(whole.splats()) == bits(rest.splats()),
                "stopped at {stop}"
            );
            assert_eq!(whole.state(), rest.state());
            assert_eq!(whole.scene(), rest.scene());
        }
    }
}

/// Half of the dynamic splats bound to nodes of two windows that have not moved yet.
fn bound(mut splats: Splats) -> Splats {
    let anchors = vec![
        [-0.6, 0.0, 2.5],
        [0.0, 0.3, 2.5],
        [0.6, 0.0, 2.5],
        [0.0, -0.3, 2.6],
    ];
    let window = |keys: std::ops::Range<usize>| {
        let pose = |position: &[f32; 3]| Pose {
            position: *position,
            rotation: [1.0, 0.0, 0.0, 0.0],
        };
        let poses = keys
            .clone()
            .flat_map(|_| anchors.iter().map(pose))
            .collect();
        Window::new(keys.map(|k| k as f32).collect(), anchors.clone(), poses).unwrap()
    };
    let bindings = (0..splats.n_dynamic() / 2).map(|i| Binding {
        window: (i % 2) as u32,
        nodes: [0, 1, 2, 3],
        weights: [0.4, 0.3, 0.2, 0.1],
        life: if i % 2 == 0 {
            [f32::NEG_INFINITY, 3.5]
        } else {
            [3.5, f32::INFINITY]
        },
    });
    let bindings = bindings.collect();
    splats
        .bind(Arc::new(vec![window(0..4), window(4..FRAMES)]), bindings)
        .unwrap();
    splats
}

#[test]
fn a_resumed_run_with_bound_splats_ends_with_the_bits_of_an_uninterrupted_one() {
    let (scene, capture) = video();
    let config = config(60);
    let first = || bound(disturbed(&scene, 3));
    let mut whole = start(&capture, first(), config.clone());
    finish(&mut whole);
    let moved = whole
        .splats()
        .windows()
        .iter()
        .flat_map(|w| w.poses(1))
        .filter(|p| p.rotation[0] != 1.0)
        .count();
    assert!(
        moved > 4 && !whole.splats().bindings().is_empty(),
        "nodes were trained: {moved}"
    );
    let trend = whole.splats().column(Column::Trend, 0);
    assert!(
        trend[..whole.splats().bindings().len()]
            .iter()
            .any(|v| *v != 0.0)
    );
    for stop in [7, 25, 41] {
        let mut half = start(&capture, first(), config.clone());
        half.run_until(stop, &Silent, &mut |_| {}).unwrap();
        let (saved, state) = (half.scene(), half.state());
        let mut rest = Trainer::resume(
            &capture,
            saved.splats,
            &state,
            config.clone(),
            SimdLevel::best(),
        )
        .unwrap();
        finish(&mut rest);
        assert!(
            bits(whole.splats()) == bits(rest.splats()),
            "stopped at {stop}"
        );
        assert_eq!(whole.state(), rest.state());
        assert_eq!(whole.scene(), rest.scene());
    }
}

#[test]
fn another_seed_gives_another_run() {
    let (scene, capture) = video();
    let run = |seed| {
        let config = TrainConfig { seed, ..config(30) };
        finish(&mut start(&capture, disturbed(&scene, 4), config))
    };
    assert!(bits(&run(1)) != bits(&run(2)));
}

#[test]
fn a_state_that_does_not_fit_is_refused() {
    let (scene, capture) = video();
    let mut trainer = start(&capture, disturbed(&scene, 5), config(20));
    trainer.run_until(5, &Silent, &mut |_| {}).unwrap();
    let (saved, state) = (trainer.scene().splats, trainer.state());
    let level = SimdLevel::best();
    let resume = |splats: &Splats, state| {
        Trainer::resume(&capture, splats.clone(), state, config(20), level)
    };
    let mut missing = state.clone();
    missing.remove("adam/step");
    assert_eq!(
        resume(&saved, &missing).unwrap_err(),
        TrainError::BadState {
            name: "adam/step".to_owned()
        }
    );
    let mut wrong = state.clone();
    wrong.insert("train/iteration".to_owned(), StateTensor::f32(vec![5.0]));
    assert!(matches!(
        resume(&saved, &wrong),
        Err(TrainError::BadState { .. })
    ));
    let fewer = saved.gather(&[0, 1, 2]).unwrap();
    assert!(matches!(resume(&fewer, &state), Err(TrainError::Shape(_))));
}
