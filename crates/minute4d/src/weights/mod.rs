//! Pretrained weights: the registry of known files, the store of installed ones, and their
//! download.
//!
//! ```text
//! registry (name, size, SHA-256, licence, source)
//!   fetch: network -> download (in as many attempts as it takes) -> all of the file, or a member -+
//!   add:   a file of the user's ------------------------------------------------------------------+-> checked -> Store
//! ```
//!
//! Weights are not part of the program. Only [`fetch()`] uses the network. A download is compared
//! with the published size and SHA-256, where they are known, before it is installed in the
//! [`Store`], together with its licence; where they are not, what came first is recorded and
//! trusted. An intact file is not fetched again, so the command can be repeated without a network.
//! Weights whose licence forbids commercial use need the user's consent first.

mod download;
mod fetch;
mod network;
mod registry;
mod store;

pub use crate::error::WeightsError;
pub use fetch::{add, check_licence, fetch};
pub use network::Network;
pub use registry::{Entry, Origin, SETS, all, find, select};
pub use store::{Condition, Record, Store};

#[cfg(test)]
mod tests;
