//! Training steps on a GPU agree with those of the CPU. Without a GPU they run on a software Vulkan
//! driver (lavapipe), where that is installed (`apt-get install mesa-vulkan-drivers`); without that
//! either, every test says so and ends.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

mod batch;
mod bound;
#[path = "../common/mod.rs"]
mod common;
mod density;
mod fixed;
mod gradient;
mod room;
mod score;
mod step;
mod training;

use m4_kernels::gpu::Gpu;

/// A GPU, or a software Vulkan driver (lavapipe); `None`, and said so, where there is neither.
#[track_caller]
fn gpu(test: &str) -> Option<Gpu> {
    match Gpu::for_tests() {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            m4_testkit::skip(m4_testkit::Need::Vulkan, &format!("{test}: {error}"));
            None
        }
    }
}
