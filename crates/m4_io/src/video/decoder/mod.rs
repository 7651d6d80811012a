//! Decoders as child processes: their limits, their supervision, and their end.
//!
//! Decoders are large programs in C that are given bytes of strangers. They run in processes of their
//! own, so that a crash, an endless loop or a claim of all memory is an error of the clip.
//!
//! ```text
//! launch       our own program, started once more: the decoder of H.264, or what limits itself and becomes another program
//! rlimits      limits of the kernel
//! child        watching; messages: standard error; end: how it ended
//! limits       how much a clip of some size may take
//! ```

mod child;
mod end;
mod launch;
mod limits;
mod messages;
mod rlimits;

pub use child::{Child, Halt, Start};
pub use end::{DecoderEnd, is_of_data, is_of_memory};
pub use launch::{DecoderProgram, NOT_STARTED, become_program, command, decoder_program, set_decoder_program};
pub use limits::{Allowed, DecoderLimits, Work};
pub use rlimits::{Confined, limit_self};
