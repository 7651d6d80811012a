//! What it takes to time the kernels: scenes, one step on a clock, what each kernel had to do, and
//! what the machine can do at most. `minute4d bench` makes a report of it.

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
