//! The parts of a kernel benchmark: scenes, timed steps, the minimum work of each kernel, and the
//! limits of the machine. `minute4d-lab bench` turns them into a report.

#[cfg(feature = "gpu")]
mod gpu;
mod probe;
mod scene;
mod stage;
mod work;

pub use probe::{PEAK_EVALUATIONS, PeakEvaluations, Probe};
pub use scene::SceneKind;
pub use stage::{Bench, BenchScene, SceneConfig, Times};
pub use work::{Counts, Work, useful_evaluations};
