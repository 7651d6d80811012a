//! Clips: reads video files and folders of images, writes MP4.
//!
//! 8-bit H.264 in MP4 and MOV files is decoded by OpenH264, which is built in. Everything else goes
//! through an `ffmpeg` on the PATH, if there is one.
//!
//! Decoders run in processes of their own, with limits ([`DecoderLimits`]): what breaks one of them
//! is an error of the clip. `ffmpeg` is such a process anyway; for OpenH264 a program starts itself
//! once more. That only the program can arrange, at its start; a program that does not has OpenH264
//! in its own process:
//!
//! ```no_run
//! use m4_io::video::{DecoderProgram, serve_decoder, set_decoder_program};
//! # fn main() -> std::io::Result<()> {
//! let arguments: Vec<_> = std::env::args_os().skip(1).collect();
//! if arguments.first().is_some_and(|a| a == "__decode-h264") {
//!     return serve_decoder(&arguments[1..], std::io::stdin().lock(), std::io::stdout().lock());
//! }
//! // Fails only when there is one already.
//! let _ = set_decoder_program(DecoderProgram::new(std::env::current_exe()?, "__decode-h264"));
//! # Ok(())
//! # }
//! ```
//!
//! The program `m4_decode_h264` of this crate is such a decoder, for callers that cannot start
//! themselves.

mod colour;
mod decoder;
mod encode;
mod ffmpeg;
mod h264;
mod mp4;
mod plan;
mod read;
mod stream;
mod write;

pub use decoder::{DecoderLimits, DecoderProgram, decoder_program, set_decoder_program};
pub use h264::serve as serve_decoder;
pub use plan::VideoOptions;
pub use read::{image_files, read, read_with};
pub use stream::{CodedFrames, CodedOptions, encode_frames};
pub use write::Mp4Writer;
