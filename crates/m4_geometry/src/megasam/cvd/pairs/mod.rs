//! Flow fields between frames: which pairs, which of their pixels count, and where they are kept.
//!
//! ```text
//! pair_list -> flow both ways (caller) -> halved -> consistency_mask -> PairStore -> PairSource
//! ```
//!
//! docs/spec/front-end.md 1.7. A million pixels of flow a second pass through here for every second of
//! video, so a stored pixel has four bytes, and what exceeds a byte budget goes to a temporary file.

mod compact;
mod consistency;
mod list;
mod store;

pub use compact::{CompactFlow, MASKED};
pub(super) use compact::{LANES, stride};
pub use consistency::{FlowView, MAX_ROUND_TRIP_PX, consistency_mask, round_trip_px};
pub use list::{FramePair, STEPS, pair_list};
pub use store::{PairSource, PairStore};
