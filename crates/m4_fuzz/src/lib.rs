//! All readers of files, as called by the fuzzer and by the replay of its findings.
//!
//! ```text
//! table     all readers of m4_io and of the program itself: a name, a file among others, valid contents, the call
//! reader    one of them: its folder, the bytes put where they belong, what came of it
//! wrap      what bytes are wrapped in so that mutations get past checksums: chunks of PNG, gzip, members of archives
//! valid     whether what was read is valid, and if not, the fault
//! malformed valid files with extremes in each field of the header, truncated, or mutated at random
//! corpus    files of earlier findings
//! worker    the process that reads: a limit of memory, one input after another
//! watch     the process that watches it
//! ```
//!
//! Two programs go through the same table: `fuzz/` (libFuzzer, with the coverage of the code as its guide: a target a family) and
//! `tests/replay.rs` (earlier findings and malformed files, within a limit of memory). Functions here panic where the fixtures are
//! not there: that is a broken checkout.
#![forbid(unsafe_code)]

mod corpus;
mod fixture;
mod limit;
mod malformed;
mod reader;
mod table;
mod valid;
mod watch;
mod worker;
mod wrap;

pub use corpus::corpus;
pub use malformed::{malformed, mutated};
pub use reader::{MAX_REASON, Outcome, Reader, Stage};
pub use table::{broken_readers, families, of_family, reader, readers};
pub use watch::{Finding, Report, watch};
pub use worker::{Meter, work};
