//! Readers and writers for the types of m4_core: video, images, captures, data sets of other tools,
//! scene files.
//!
//! Everything that comes from outside is checked here, once: counts in headers against the size of
//! the file before anything is allocated, numbers against their ranges ([`range`]), sizes for
//! agreeing. Axes and units are converted here too, so that the rest of the program knows one
//! convention ([`m4_core`]). Every error names the file, what is wrong with it and what to do next,
//! and has its [`ErrorKind`]. Files are written atomically ([`atomic`]).
#![forbid(unsafe_code)]

pub mod atomic;
pub mod capture;
pub mod dataset;
pub mod files;
pub mod image;
pub mod npy;
pub mod range;
pub mod reach;
pub mod results;
pub mod scene;
pub mod tracks;
pub mod trajectory;
pub mod video;

mod error;
mod pose;

pub use error::{
    DecoderEnd, ErrorKind, Fault, OutsideError, ReadError, WriteError, WriteFault, shortened,
};
