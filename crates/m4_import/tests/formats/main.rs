//! Sources as tools, data sets and phones leave them, compared with what they were written from.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

#[path = "../common/mod.rs"]
mod common;

mod detect;
mod outside;
mod sets;
mod support;
mod tools;
