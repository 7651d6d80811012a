//! A video of known motion is learned: image quality, motion, counts (docs/spec/optimiser.md 9, T8
//! and T9).

use crate::common::{FRAMES, disturbed, video};
use m4_core::{Capture, CaptureFrame, Column, Silent, Splats};
use m4_kernels::{Renderer, SimdLevel, View};
use m4_testkit::StopAtPoll;
use m4_train::{
    DensityConfig, MetricsEvent, Outcome, TrainConfig, TrainError, Trainer,
    init::{InitConfig, initialise},
};

/// Rates for a few hundred steps instead of thousands.
fn config(iterations: usize) -> TrainConfig {
    let mut config = TrainConfig::fast();
    config.lr.colour = 0.02;
    config.lr.position = 1e-3;
    config.lr.scale = 0.01;
    config.lr.velocity = 1e-2;
    config.lr.position_end = 1e-5;
    config.lr.other_end = 0.1;
    config.iterations = iterations;
    config.metrics_every = 40;
    config.density.enabled = false;
    config
}

/// Mean velocity of the dynamic splats, weighted by how much they cover.
fn mean_velocity(splats: &Splats) -> [f32; 3] {
    let weight = |i: usize| {
        let row = splats.n_static() + i;
        let opacity = 1.0 / (1.0 + (-splats.column(Column::Opacity, 0)[row]).exp());
        opacity * (2.0 * splats.column(Column::LogScale, 0)[row]).exp()
    };
    let total: f32 = (0..splats.n_dynamic()).map(weight).sum();
    [0, 1, 2].map(|k| {
        let v = splats.column(Column::Velocity, k);
        (0..splats.n_dynamic())
            .map(|i| weight(i) * v[i])
            .sum::<f32>()
            / total
    })
}

#[test]
fn perturbed_splats_recover_image_and_velocity() {
    let (scene, capture) = video();
    let config = config(800);
    let mut splats = disturbed(&scene, 1);
    let at_start = 0.6 * scene.velocity[0];
    splats.column_mut(Column::Velocity, 0).fill(at_start);
    let mut trainer = Trainer::new(&capture, splats, config, SimdLevel::best()).unwrap();
    let mut events: Vec<MetricsEvent> = Vec::new();
    let outcome = trainer.run(&Silent, &mut |e| events.push(*e)).unwrap();
    assert_eq!(outcome, Outcome::Finished);
    assert_eq!(events.len(), 20);
    let (first, last) = (events[0], events[19]);

    assert!(last.l1 < 0.5 * first.l1, "l1 {} to {}", first.l1, last.l1);
    assert!(last.psnr > 30.0, "{} dB", last.psnr);
    assert_eq!(last.splats_static + last.splats_dynamic, scene.splats.n());
    let v = mean_velocity(trainer.splats());
    let speed = scene.velocity[0];
    assert!(
        (v[0] - speed).abs() < 0.1 * speed,
        "{v:?} where {speed} was expected"
    );
    assert!(
        v[1].abs() < 0.1 * speed && v[2].abs() < 0.3 * speed,
        "{v:?} where nothing moves"
    );
}

#[test]
fn training_from_depth_exceeds_30_db() {
    let (_, capture) = video();
    let init = InitConfig {
        max_static: Some(3000),
        max_dynamic: 1500,
        ..InitConfig::fast()
    };
    let splats = initialise(&capture, &init, &Silent).unwrap().splats;
    assert!(splats.n_static() > 1000 && splats.n_dynamic() > 300);
    let mut config = config(240);
    config.density = DensityConfig {
        from: 0.25,
        every: 40.0 / 240.0,
        prune_every: 80.0 / 240.0,
        ..DensityConfig::fast()
    };
    let first = splats.n();
    let mut trainer = Trainer::new(&capture, splats, config, SimdLevel::best()).unwrap();
    let mut last = None;
    trainer.run(&Silent, &mut |e| last = Some(*e)).unwrap();
    let last = last.unwrap();
    assert!(last.psnr > 30.0, "{} dB", last.psnr);
    let n = trainer.splats().n();
    assert!(n <= first + first / 2, "{n} splats from {first}");
    assert!(trainer.splats().is_finite());
    let source = trainer.scene().source;
    assert_eq!(source.len(), FRAMES);
    for (source, frame) in source.iter().zip(&capture.frames) {
        assert_eq!(source.distance_sigma, frame.distance_sigma);
    }
}

/// PSNR over frames of `capture`, dB.
fn psnr(splats: &Splats, capture: &Capture, frames: &[usize]) -> f64 {
    let mut renderer = Renderer::new(SimdLevel::best());
    let (mut sum, mut count) = (0.0, 0.0);
    for &i in frames {
        let CaptureFrame { camera, t, rgb, .. } = &capture.frames[i];
        let period = (capture.time_frames - 1) as f32;
        let view = View {
            camera: *camera,
            t: *t,
            background: [0.0; 3],
            near: 0.1,
            mip: true,
            period,
            with_depth: false,
        };
        let drawn = renderer.render(splats, &view);
        for (c, plane) in drawn.rgb.iter().enumerate() {
            for (value, pixel) in plane.iter().zip(rgb.data()) {
                sum += (f64::from(value.clamp(0.0, 1.0)) - f64::from(pixel[c]) / 255.0).powi(2);
                count += 1.0;
            }
        }
    }
    -10.0 * (sum / count).log10()
}

/// Three of four splats of the wall are missing at the start. Measured: 25.09 dB without, 26.53 dB
/// with density control, and 24.70 dB where it chooses the splats of the lowest scores.
#[test]
fn density_control_improves_frames_that_were_not_trained_on() {
    let (scene, capture) = video();
    let indices = (0..scene.splats.n()).filter(|i| *i >= scene.splats.n_static() || i % 4 == 0);
    let rows: Vec<u32> = indices.map(|i| i as u32).collect();
    let start = disturbed(&scene, 3).gather(&rows).unwrap();
    let held_out = [1, 3, 5];
    let mut train = capture.clone();
    let mut i = 0;
    train.frames.retain(|_| {
        i += 1;
        !held_out.contains(&(i - 1))
    });
    let scores = [false, true].map(|enabled| {
        let mut config = config(400);
        let density = DensityConfig {
            from: 0.15,
            every: 0.1,
            prune_every: 0.2,
            ..DensityConfig::fast()
        };
        config.density = DensityConfig {
            enabled,
            budget: 0.05,
            max_growth: 1.5,
            ..density
        };
        let mut trainer = Trainer::new(&train, start.clone(), config, SimdLevel::best()).unwrap();
        trainer.run(&Silent, &mut |_| {}).unwrap();
        (
            psnr(trainer.splats(), &capture, &held_out),
            trainer.splats().n(),
        )
    });
    let [(without, _), (with, _)] = scores;
    assert!(with > without + 0.7, "{scores:?}");
}

#[test]
fn pose_refinement_recovers_a_perturbed_pose() {
    let (scene, mut capture) = video();
    let truth = capture.frames[3].camera;
    capture.frames[3].camera.c2w.translation.x += 0.03;
    // Turning and shifting look alike: what counts is where points land, at the depth of wall and
    // ball.
    let off_px = |t: &Trainer<'_>| {
        let fit = t.scene().source[3].camera;
        let corners = [
            [10.0, 10.0, 4.0],
            [80.0, 60.0, 4.0],
            [48.0, 36.0, 2.5],
            [48.0, 36.0, 4.0],
        ];
        let miss = corners.map(|[u, v, z]| {
            let ([a, b], _) = fit.project(&truth.unproject(u, v, z));
            (a - u).hypot(b - v)
        });
        miss.iter().sum::<f64>() / 4.0
    };
    let mut config = config(320);
    // The splats are those of the scene: only the pose is wrong.
    (config.lr.position, config.lr.scale, config.lr.opacity) = (0.0, 0.0, 0.0);
    (config.lr.colour, config.lr.velocity) = (0.0, 0.0);
    config.refine.poses = true;
    config.refine.from = 0;
    config.refine.translation_lr = 2e-4;
    config.refine.rotation_lr = 1e-4;
    let mut trainer =
        Trainer::new(&capture, scene.splats.clone(), config, SimdLevel::best()).unwrap();
    let before = off_px(&trainer);
    trainer.run(&Silent, &mut |_| {}).unwrap();
    assert!(
        off_px(&trainer) < 0.3 * before,
        "{} px of {before} are left",
        off_px(&trainer)
    );
    assert_eq!(trainer.scene().source[0].camera, capture.frames[0].camera);
}

#[test]
fn a_stopped_run_keeps_what_it_has() {
    let (scene, capture) = video();
    let mut trainer = Trainer::new(
        &capture,
        disturbed(&scene, 1),
        config(100),
        SimdLevel::best(),
    )
    .unwrap();
    let stop = StopAtPoll::after(25);
    let outcome = trainer.run(&stop, &mut |_| {}).unwrap();
    assert_eq!(outcome, Outcome::Stopped { iteration: 25 });
    assert_eq!(trainer.iteration(), 25);
    assert!(trainer.scene().splats.is_finite());
}

#[test]
fn a_run_that_diverges_says_so_and_keeps_the_last_good_splats() {
    let (scene, capture) = video();
    let mut config = config(100);
    config.guard_every = 10;
    config.lr.colour = 1e38;
    let mut trainer =
        Trainer::new(&capture, disturbed(&scene, 1), config, SimdLevel::best()).unwrap();
    let error = trainer.run(&Silent, &mut |_| {}).unwrap_err();
    assert!(matches!(error, TrainError::Diverged { .. }), "{error}");
    assert!(trainer.splats().is_finite());
}

#[test]
fn bad_starts_are_refused() {
    let (scene, capture) = video();
    let level = SimdLevel::best();
    let mut broken = scene.splats.clone();
    broken.column_mut(Column::Mean, 0)[0] = f32::NAN;
    assert_eq!(
        Trainer::new(&capture, broken, config(1), level).unwrap_err(),
        TrainError::BadSplats
    );
    let none = scene.splats.gather(&[]).unwrap();
    assert_eq!(
        Trainer::new(&capture, none, config(1), level).unwrap_err(),
        TrainError::NoSplats
    );
    let mut empty = capture;
    empty.frames.clear();
    assert_eq!(
        Trainer::new(&empty, scene.splats.clone(), config(1), level).unwrap_err(),
        TrainError::NoFrames
    );
}
