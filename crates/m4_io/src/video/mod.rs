//! Clips: reading video files and folders of pictures, writing MP4.
//!
//! 8-bit H.264 in MP4 and MOV files is decoded by the program itself. Everything else goes through
//! an `ffmpeg` on the PATH, as a child process, if there is one.

mod colour;
mod error;
mod ffmpeg;
mod folder;
mod h264;
mod mp4;
mod options;
mod orient;
mod plan;
mod read;
mod write;

pub use error::{ReadVideoError, WriteVideoError};
pub use folder::{natural, pictures};
pub use options::VideoOptions;
pub use read::read;
pub use write::Mp4Writer;
