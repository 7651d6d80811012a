//! SPZ, glTF, USD and cameras: written, read back, compared with numbers worked out by hand; broken files.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

mod cameras;
mod common;
mod gltf;
mod spz;
mod usd;
