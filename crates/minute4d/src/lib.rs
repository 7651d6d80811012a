//! The stages wired into one pipeline.
