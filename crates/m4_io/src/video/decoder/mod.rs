//! Decoders as child processes: their limits, their supervision, and their end.
//!
//! Decoders are large programs in C that are given bytes of strangers. They run in processes of their
//! own, so that a crash, an endless loop or a claim of all memory is an error of the clip.
//!
//! ```text
//! program      our own program, started once more: the decoder of H.264, and what limits itself for other programs
//! environment  the variables that they get
//! launch       our own program becomes another
//! rlimits      limits of the kernel; tasks: how many processes a user has
//! child        watching; messages: standard error; end: how it ended
//! limits       how much a clip of some size may take
//! ```

mod child;
mod end;
mod environment;
mod launch;
mod limits;
mod messages;
mod program;
mod rlimits;
#[cfg(target_os = "linux")]
mod tasks;

pub use child::{Child, Halt, Start};
pub use end::{DecoderEnd, is_of_data, is_of_memory};
pub use launch::{NOT_STARTED, become_program, command};
pub use limits::{Allowed, DecoderLimits, Work};
pub use program::{DecoderProgram, decoder_program, set_decoder_program};
pub use rlimits::{Confined, limit_self};
