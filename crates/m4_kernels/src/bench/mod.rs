//! The parts of a kernel benchmark: scenes, timed steps, the minimum work of each kernel, and the limits of the machine. `minute4d bench`
//! turns them into a report.

mod probe;
mod scene;
mod stage;
mod work;

pub use probe::{PEAK_EVALUATIONS, PeakEvaluations, Probe};
pub use scene::SceneKind;
pub use stage::{Bench, BenchScene, SceneConfig, Times};
pub use work::{Counts, Kernel, Work, useful_evaluations};
