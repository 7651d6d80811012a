//! What makes more of an iteration: several frames per step, colours by least squares, own counts
//! of steps.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use crate::common::{FRAMES, STILL, add_harmonics, disturbed, filmed, video};
use m4_core::{Capture, Column, CounterRng, Silent, Splats, StateTensor, TrainState};
use m4_kernels::SimdLevel;
use m4_testkit::StopAtPoll;
use m4_train::{DensityConfig, MetricsEvent, Outcome, TrainConfig, Trainer};

/// Nothing moves and nothing changes over the run.
fn frozen(iterations: usize) -> TrainConfig {
    let mut config = TrainConfig::fast();
    config.iterations = iterations;
    config.density.enabled = false;
    config.colour_fit_rounds = 0;
    config.lr = STILL;
    config
}

fn start(capture: &Capture, splats: Splats, config: TrainConfig) -> Trainer<'_> {
    Trainer::new(capture, splats, config, SimdLevel::best()).unwrap()
}

/// First moments of all splats, column after column; none of the trend, which splats without
/// windows lack.
fn moments(state: &TrainState<'_>, columns: usize) -> Vec<f32> {
    let column = |c: usize| match state.get(&format!("adam/m/{c:02}")) {
        Some(StateTensor::F32 { data, .. }) => data.to_vec(),
        None => Vec::new(),
        other => panic!("moments are f32, not {other:?}"),
    };
    (0..columns).flat_map(column).collect()
}

#[test]
fn the_gradient_of_a_batch_is_the_sum_of_those_of_its_frames() {
    let (scene, capture) = video();
    let splats = disturbed(&scene, 6);
    let columns = splats.columns().len();
    // the moments after a step from nothing are half of the gradient, and halve where a splat is
    // not seen
    let mut config = frozen(20);
    config.adam.beta1 = 0.5;
    config.adam.sparse = false;
    let after = |batch: usize, steps: usize| {
        let config = TrainConfig {
            batch,
            ..config.clone()
        };
        let mut trainer = start(&capture, splats.clone(), config);
        trainer.run_until(steps, &Silent, &mut |_| {}).unwrap();
        moments(&trainer.state(), columns)
    };
    for batch in [2, 3] {
        let together = after(batch, 1);
        let mut sum = vec![0.0f32; together.len()];
        let mut before = sum.clone();
        for k in 1..=batch {
            let now = after(1, k);
            for ((sum, now), before) in sum.iter_mut().zip(&now).zip(&before) {
                *sum += now - 0.5 * before;
            }
            before = now;
        }
        let largest = sum.iter().fold(0.0f32, |a, v| a.max(v.abs()));
        assert!(largest > 0.0);
        for (i, (got, want)) in together.iter().zip(&sum).enumerate() {
            let near = 1e-5 * want.abs() + 1e-7 * largest;
            assert!(
                (got - want).abs() <= near,
                "batch {batch}, value {i}: {got} for {want}"
            );
        }
    }
}

#[test]
fn a_batch_looks_at_the_frames_that_as_many_steps_would() {
    let (scene, capture) = video();
    let loss = |batch: usize| {
        let config = TrainConfig {
            batch,
            ..frozen(FRAMES)
        };
        let mut events: Vec<MetricsEvent> = Vec::new();
        let mut trainer = start(&capture, disturbed(&scene, 7), config);
        trainer
            .run_until(FRAMES / batch, &Silent, &mut |e| events.push(*e))
            .unwrap();
        events.last().unwrap().l1
    };
    // one epoch of splats that do not move: the mean over all frames
    let one = loss(1);
    for batch in [2, 4] {
        let got = loss(batch);
        assert!((got - one).abs() < 1e-6, "batch {batch}: {got} for {one}");
    }
}

#[test]
fn fitted_colours_are_nearer_to_the_video_and_touch_nothing_else() {
    let (scene, capture) = video();
    fit_of(&scene.splats, &capture);
    let mut coloured = scene.splats.clone();
    add_harmonics(&mut coloured, (1, 1));
    fit_of(&coloured, &filmed(&coloured, &scene.cameras));
}

/// Fits the constant colours of `truth`, which `capture` shows.
fn fit_of(truth: &Splats, capture: &Capture) {
    // nothing but the constant colours is wrong
    let mut splats = truth.clone();
    let mut rng = CounterRng::new(8, 0, 0);
    for k in 0..3 {
        let column = splats.column_mut(Column::Colour, k);
        column
            .iter_mut()
            .for_each(|c| *c += 0.5 * rng.normal() as f32);
    }
    let run = |rounds: usize| {
        let mut config = frozen(1);
        config.colour_fit_rounds = rounds;
        let mut trainer = start(capture, splats.clone(), config);
        trainer.run(&Silent, &mut |_| {}).unwrap();
        let fitted = trainer.into_scene().splats;
        // an epoch in which nothing moves: the mean over all frames
        let mut config = frozen(FRAMES);
        config.metrics_every = FRAMES;
        let mut last = None;
        let mut trainer = start(capture, fitted.clone(), config);
        trainer.run(&Silent, &mut |e| last = Some(*e)).unwrap();
        (last.unwrap().l1, fitted)
    };
    let (before, start) = run(0);
    let (one, fitted) = run(1);
    let (eight, _) = run(8);
    assert!(one < 0.6 * before, "l1 {before} to {one}");
    assert!(eight < 0.3 * one, "l1 {one} to {eight}");
    let first = splats.layout().column(Column::Colour);
    let colour = first..first + 3;
    for (c, (a, b)) in start.columns().iter().zip(fitted.columns()).enumerate() {
        assert_eq!(a == b, !colour.contains(&c), "column {c}");
    }
}

#[test]
fn a_new_splat_moves_by_its_rate_at_first() {
    let (scene, capture) = video();
    // half of the run is over when the splats of a round are added
    let mut config = frozen(40);
    config.adam.sparse = false;
    config.adam.beta2_dynamic = config.adam.beta2;
    config.lr.opacity = 0.01;
    config.lr.other_end = 1.0;
    config.density = DensityConfig {
        from: 0.5,
        every: 0.5,
        until: 0.5,
        prune_every: 1.0,
        min_opacity: 0.0,
        final_opacity: 0.0,
        ..DensityConfig::fast()
    };
    let mut trainer = start(&capture, disturbed(&scene, 9), config);
    let opacity = |splats: &Splats| splats.column(Column::Opacity, 0).to_vec();
    trainer.run_until(20, &Silent, &mut |_| {}).unwrap();
    let before = opacity(trainer.splats());
    let is_new: Vec<bool> = match &trainer.state()["adam/v/00"] {
        StateTensor::F32 { data, .. } => data.iter().map(|&v| v == 0.0).collect(),
        other => panic!("moments are f32, not {other:?}"),
    };
    trainer.run_until(21, &Silent, &mut |_| {}).unwrap();
    let after = opacity(trainer.splats());
    let steps = before.iter().zip(&after).zip(&is_new);
    let steps = steps
        .filter(|&(_, &new)| new)
        .map(|((a, b), _)| (b - a).abs());
    // what no frame sees has no moments either, and stays where it is
    let mut steps: Vec<f32> = steps.filter(|&step| step > 0.0).collect();
    steps.sort_by(f32::total_cmp);
    assert!(steps.len() > 10, "{} new splats", steps.len());
    let middle = steps[steps.len() / 2];
    assert!((middle - 0.01).abs() < 1e-4, "{middle}");
}

#[test]
fn a_stop_is_heard_between_the_frames_of_the_fit_which_then_starts_anew() {
    let (scene, capture) = video();
    let mut config = frozen(1);
    config.colour_fit_rounds = 2;
    let begin = || start(&capture, scene.splats.clone(), config.clone());
    let mut calm = begin();
    calm.run(&Silent, &mut |_| {}).unwrap();
    // one question before the step, then one per frame and round
    for question in [1, 4, FRAMES + 3] {
        let mut stopped = begin();
        let outcome = stopped
            .run(&StopAtPoll::after(question), &mut |_| {})
            .unwrap();
        assert_eq!(
            outcome,
            Outcome::Stopped { iteration: 1 },
            "question {question}"
        );
        let (splats, state) = (stopped.splats().clone(), stopped.state());
        let mut again =
            Trainer::resume(&capture, splats, &state, config.clone(), SimdLevel::best()).unwrap();
        again.run(&Silent, &mut |_| {}).unwrap();
        assert!(
            again.scene() == calm.scene(),
            "question {question}, resumed"
        );
        stopped.run(&Silent, &mut |_| {}).unwrap();
        assert!(
            stopped.scene() == calm.scene(),
            "question {question}, continued"
        );
    }
}
