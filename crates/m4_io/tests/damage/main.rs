//! Damaged and malformed files: an error or a valid result, and little memory.
//!
//! ```text
//! datasets   sources of other tools: cases (what is damaged, and how it is read), mutate (the damage)
//! megasam    outputs of MegaSaM
//! scenes     scene files
//! memory     what reading takes
//! ```
//!
//! The allocator counts for the whole process, so this is a program of its own, and its tests run one after the other.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

#[path = "../common/fixtures.rs"]
mod fixtures;

mod cases;
mod datasets;
mod megasam;
mod memory;
mod mutate;
mod scenes;
