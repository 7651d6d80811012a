//! The parts of a kernel benchmark: scenes, timed steps, the minimum work of each kernel, and the limits of the machine. `minute4d bench`
//! turns them into a report.

mod count;
mod film;
mod probe;
mod scene;
mod stage;
mod work;

pub use count::useful_evaluations;
pub use film::film;
pub use probe::{PEAK_EVALUATIONS, PeakEvaluations, Probe};
pub use scene::{FRAMES, SceneKind};
pub use stage::{Bench, BenchScene, SceneConfig, Times};
pub use work::{Counts, Kernel, Work};
