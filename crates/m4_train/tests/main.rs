//! The integration tests of this crate, in one program.

mod backend;
mod colour_degree;
mod common;
mod determinism;
mod fewer_steps;
mod init;
mod synthetic_video;
mod watched;

/// Runs `f` on a pool of that many threads.
fn on_threads<R: Send>(threads: usize, f: impl FnOnce() -> R + Send) -> R {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("a pool of threads")
        .install(f)
}
