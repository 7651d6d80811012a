//! Colours that change with direction or time are learned by harmonics of that degree.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use crate::common::{
    FRAMES, STILL, add_harmonics, filmed, halves_have_the_colour_of_their_time, video,
};
use m4_core::{Camera, Capture, Column, Intrinsics, Silent, Splats};
use m4_kernels::SimdLevel;
use m4_testkit::camera_looking_at;
use m4_train::{ColourDegree, RateConfig, TrainConfig, Trainer};

/// Cameras on an arc of 80 degrees around the ball.
fn arc() -> Vec<Camera> {
    let angle = |i: usize| 1.4 * (i as f64 / (FRAMES - 1) as f64 - 0.5);
    let at = |a: f64| [2.5 * a.sin(), 0.3 * a.cos(), 2.5 - 2.5 * a.cos()];
    let lens = Intrinsics::centred(96, 72, 90.0);
    (0..FRAMES)
        .map(|i| camera_looking_at(lens, at(angle(i)), [0.0, 0.0, 2.5]))
        .collect()
}

/// Splats with constant colours, and the video of the same splats with harmonics of these degrees.
fn clip(space: usize, time: usize) -> (Splats, Capture) {
    let (scene, _) = video();
    let mut truth = scene.splats.clone();
    add_harmonics(&mut truth, (space, time));
    (scene.splats, filmed(&truth, &arc()))
}

/// The mean L1 of the last epoch where colours alone are trained, and the splats.
fn trained(splats: &Splats, capture: &Capture, colour_degree: ColourDegree) -> (f64, Splats) {
    let mut config = TrainConfig {
        iterations: 50 * FRAMES,
        metrics_every: FRAMES,
        colour_degree,
        ..TrainConfig::fast()
    };
    config.density.enabled = false;
    config.colour_fit_rounds = 0;
    config.lr = RateConfig {
        colour: 0.02,
        colour_harmonics: 0.02,
        ..STILL
    };
    let mut trainer = Trainer::new(capture, splats.clone(), config, SimdLevel::best()).unwrap();
    let mut last = None;
    trainer.run(&Silent, &mut |e| last = Some(*e)).unwrap();
    (last.unwrap().l1, trainer.into_scene().splats)
}

#[test]
fn colours_that_depend_on_direction_need_harmonics_of_direction() {
    let (splats, capture) = clip(2, 0);
    let l1 = |space| trained(&splats, &capture, ColourDegree { space, time: 0 }).0;
    let (constant, first, second) = (l1(0), l1(1), l1(2));
    assert!(first < 0.7 * constant, "l1 {constant} to {first}");
    assert!(second < 0.4 * constant, "l1 {constant} to {second}");
}

#[test]
fn colours_that_vary_in_time_need_harmonics_of_time() {
    let (mut splats, capture) = clip(0, 1);
    let l1 = |time| trained(&splats, &capture, ColourDegree { space: 0, time });
    let ((constant, _), (first, learned)) = (l1(0), l1(1));
    // the wall has no time
    assert!(first < 0.7 * constant, "l1 {constant} to {first}");
    let n_static = learned.n_static();
    let harmonic = learned.column(Column::Colour, 3);
    assert!(harmonic[n_static..].iter().any(|&k| k != 0.0));
    splats.raise_degrees(0, 2);
    assert_eq!(
        trained(&splats, &capture, ColourDegree::default())
            .1
            .layout(),
        splats.layout(),
        "no degree falls"
    );
}

#[test]
fn halves_drawn_at_another_time_have_the_colour_of_that_time() {
    halves_have_the_colour_of_their_time(None);
}
