//! The optimisation loop: schedule, loss, sparse Adam, loss-guided density control, checkpoints.
//!
//! [`Trainer`] takes a capture and its first splats and makes them look like the frames: pick a
//! frame in an order drawn again for each epoch, draw it, compare (L1 + SSIM), step every splat
//! that was seen. Every hundred steps [`density`] looks at what is still wrong and adds or removes
//! splats there.
//!
//! Steps are taken by a [`backend`], the CPU or a GPU ([`Trainer::use_backend`]); schedule, choice
//! of frames and checkpoints are the same for both.
//!
//! A run is a function of capture, first splats, settings and seed: the same bits come out for any
//! number of threads, and a run that was stopped, saved ([`Trainer::state`]) and resumed
//! ([`Trainer::resume`]) ends with the bits of the uninterrupted one.
#![forbid(unsafe_code)]

pub mod backend;
pub mod config;
pub mod density;
pub mod init;

mod colour_degree;
mod colour_fit;
mod error;
mod frames;
mod metrics;
mod pace;
mod refine;
mod scale;
mod schedule;
mod state;
mod trainer;
mod warm_up;

pub use backend::{Backend, BackendError, BackendMaker};
pub use colour_degree::ColourDegree;
pub use config::{AdamConfig, DensityConfig, RateConfig, RefineConfig, TrainConfig};
pub use error::TrainError;
pub use metrics::MetricsEvent;
pub use pace::affordable_iterations;
pub use scale::SceneScale;
pub use trainer::{Outcome, Trainer};
pub use warm_up::warm_up;
