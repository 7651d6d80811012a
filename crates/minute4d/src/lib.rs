//! The stages wired into one pipeline.
pub mod settings;
