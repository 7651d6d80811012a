//! For tests only: synthetic scenes, tolerances, finite differences, fixture loading, and with the
//! feature `browser` a headless Chromium.
//!
//! Knows the shared types alone, so every crate may use it as a dev-dependency. Functions here
//! panic where a test should fail: that is what they are for.
#![forbid(unsafe_code)]

mod boxes;
#[cfg(feature = "browser")]
mod browser;
pub mod clips;
mod compare;
mod fixture;
mod formula;
mod mutate;
mod progress;
mod server;
mod skip;
mod synthetic;
mod tensors;
mod threads;

pub use boxes::{BoxScene, Hit};
#[cfg(feature = "browser")]
pub use browser::{Chromium, find_chromium};
pub use compare::{
    Agreement, Differences, Flips, Side, assert_gradient, assert_image, central_differences,
};
pub use fixture::{FixtureCamera, FixtureSplat, GradientCase, GradientFixtures, gradient_fixtures};
pub use formula::{FormulaWeights, formula, formula_input, write_formula_weights};
pub use mutate::mutate;
pub use progress::{Heard, StopAtPoll};
pub use server::Server;
pub use skip::{Need, SKIPPED_VARIABLE, on_every_level, repository, shared, skip};
pub use synthetic::{
    MovingScene, SceneSpec, bare_scene, bind_at_random, bound_scene, camera_looking_at,
    moving_scene, random_camera, random_scene, random_splats,
};
pub use tensors::{Fixture, assert_close, relative_error};
pub use threads::same_on_any_threads;
