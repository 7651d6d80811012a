//! SPZ, glTF and cameras: written, taken apart, compared with numbers worked out by hand.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

mod common;
mod gltf;
mod spz;
