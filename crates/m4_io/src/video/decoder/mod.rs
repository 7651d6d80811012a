//! Decoders as child processes: what they may take, how they are watched, and how they end.
//!
//! Decoders are large programs in C that are given bytes of strangers. They run in processes of their
//! own, so that a crash, an endless loop or a claim of all memory is an error of the clip.

mod child;
mod end;
mod limits;
mod messages;
mod program;
mod rlimits;

pub use child::{Child, Halt};
pub use end::{DecoderEnd, is_of_memory};
pub use limits::{Allowed, DecoderLimits, Work};
pub use program::{DecoderProgram, decoder_program, set_decoder_program};
pub use rlimits::limit_self;
