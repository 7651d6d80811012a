//! From frames to cameras, depth and a map of what stands still.
mod backend;
mod correspondence;
mod error;
mod frontend;
mod keyframes;
mod settings;
mod update;

pub use backend::Backend;
pub use correspondence::*;
pub use error::TrackerError;
pub use frontend::{Frontend, Submitted};
pub use keyframes::{FrameInput, Keyframes};
pub use settings::TrackerSettings;
