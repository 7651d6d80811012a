//! Turns a casual video into a dynamic 3D scene: 4D Gaussian splats that a camera can look at from
//! elsewhere, at any time.
//!
//! ```no_run
//! use minute4d::prelude::*;
//! # fn main() -> Result<(), minute4d::Error> {
//! let options = Options::new().seconds(60.0);
//! let capture = reconstruct(&Video::open("clip.mp4")?, &options)?.capture;
//! let scene = train(&capture, &options)?;
//! let image = scene.render(&capture.frames[0].camera, 12.5)?;
//! scene.write("scene.safetensors")?;
//! # Ok(())
//! # }
//! ```
//!
//! ```text
//! Video --reconstruct--> Capture --train--> Scene --at, render, write, export, page-->
//! ```
//!
//! A stage is a function of its input, its [`Settings`] and the seed. It keeps nothing on disk; the
//! program `minute4d` adds folders with records, checkpoints and resuming. [`geometry`],
//! [`enhance`], [`train`](mod@train), [`mod@render`], [`export`], [`import`] and [`page`] have the
//! parts of the stages.
//!
//! Clips are decoded in this process. A host that wants damaged clips to be decoded in a process of
//! its own registers a program for it: [`m4_io::video::set_decoder_program`].
#![forbid(unsafe_code)]

pub mod cache;
pub mod device;
pub mod enhance;
pub mod environment;
pub mod export;
pub mod geometry;
pub mod hash;
pub mod import;
pub mod json;
pub mod layout;
pub mod networks;
pub mod observer;
mod options;
pub mod page;
pub mod prelude;
pub mod render;
pub mod settings;
pub mod train;
#[cfg(feature = "nets")]
pub mod weights;

mod error;
mod time;
mod video;

pub use error::{Category, Error, NetworkError, NetworkMethod, OutputError, Refusal};
pub use json::plain_json;
pub use layout::Existing;
pub use observer::{Observer, RecordingObserver, StageEvent};
pub use options::{Event, Options};
pub use settings::Settings;
pub use video::{Video, reconstruct, train};

pub use m4_core::{self, Capture, Progress, Scene, Silent};
#[cfg(feature = "nets")]
pub use m4_nets;
pub use {m4_geometry, m4_io, m4_kernels, m4_train, m4_viewer};
