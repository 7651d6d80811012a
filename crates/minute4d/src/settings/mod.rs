//! Every setting of the pipeline, and how layers of them are put together.

mod layers;

pub use layers::{Layers, SettingsError};
