//! All readers of files, as called by the fuzzer and by the replay of its findings.
//!
//! ```text
//! table     all readers of m4_io and of the program itself: a name, a file among others, sound contents, the call
//! reader    one of them: its folder, the bytes put where they belong, what came of it
//! dress     what bytes are wrapped in so that harm goes deeper than a checksum: chunks of PNG, gzip, members of archives
//! sound     what is wrong with what was read, if something is
//! hostile   files made to do harm: extremes in each field of the head, cuts, nothing
//! corpus    files that once did harm
//! worker    the process that reads: a limit of memory, one input after another
//! watch     the process that watches it
//! ```
//!
//! Two programs go through the same table: `fuzz/` (libFuzzer, with the coverage of the code as its guide: a target a family) and
//! `tests/replay.rs` (what was found, and malformed heads, within a limit of memory). Functions here panic where the fixtures are
//! not there: that is a broken checkout.
#![forbid(unsafe_code)]

mod corpus;
mod dress;
mod fixture;
mod hostile;
mod limit;
mod reader;
mod sound;
mod table;
mod watch;
mod worker;

pub use corpus::corpus;
pub use hostile::hostile;
pub use reader::{MAX_REASON, Outcome, Reader, Stage};
pub use table::{broken_readers, families, of_family, reader, readers};
pub use watch::{Finding, Report, watch};
pub use worker::{Meter, work};
