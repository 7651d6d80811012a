//! SPZ, glTF and cameras: written, taken apart, compared with numbers worked out by hand.

mod common;
mod gltf;
mod spz;
