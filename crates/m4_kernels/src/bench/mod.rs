//! The parts of a kernel benchmark: synthetic scenes and timed steps. `minute4d bench` turns them into a report.

mod scene;
mod stage;

pub use scene::SceneKind;
pub use stage::{Bench, BenchScene, Kernel, SceneConfig, Times};
