//! The viewer page: one self-contained HTML file, or the same page from a local server.
//!
//! ```text
//! Scene --payload::encode--> Payload --+
//!       --Manifest::new-----> Manifest +--page::compose--> viewer.html --page::read--> the same again
//! images --encode_frames--> Frames --+
//! ```
//!
//! [`panels`] places the images of a preview side by side, [`html`] fills templates of other pages.
//!
//! The page itself is TypeScript in `crates/m4_viewer/page`, built and kept as `page.html`.
#![forbid(unsafe_code)]

pub mod html;
pub mod page;
pub mod panels;
pub mod payload;
pub mod server;

mod frames;
mod manifest;

pub use frames::{FRAME_BYTES, Frames, FramesError, encode_frames};
pub use manifest::{
    About, FrameIndex, Live, MANIFEST_VERSION, Manifest, SafeOrbit, SourceCamera, SplatFacts,
};
