//! For tests only: synthetic scenes, tolerances, finite differences, fixture loading, and with the feature `browser` a
//! headless Chromium.
//!
//! Knows the shared types alone, so every crate may use it as a dev-dependency. Functions here panic
//! where a test should fail: that is what they are for.
#![forbid(unsafe_code)]

mod boxes;
#[cfg(feature = "browser")]
mod browser;
mod compare;
mod differences;
mod fixture;
mod formula;
mod interrupt;
mod levels;
mod mutate;
mod shared;
mod skip;
mod synthetic;

pub use boxes::{BoxScene, Hit};
#[cfg(feature = "browser")]
pub use browser::{Chromium, find_chromium};
pub use compare::{Agreement, Flips, assert_gradient, assert_image};
pub use differences::{Differences, Side, central_differences};
pub use fixture::{FixtureCamera, FixtureSplat, GradientCase, GradientFixtures, gradient_fixtures};
pub use formula::{FormulaWeights, formula, formula_input, write_formula_weights};
pub use interrupt::StopAtPoll;
pub use levels::on_every_level;
pub use mutate::mutate;
pub use shared::{repository, shared};
pub use skip::{Need, SKIPPED_VARIABLE, skip};
pub use synthetic::{
    MovingScene, SceneSpec, camera_looking_at, moving_scene, random_camera, random_scene, random_splats,
};
