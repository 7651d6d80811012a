//! The types that stages exchange (splats in columns, cameras, frames, masks, depth), and their
//! mathematics.
//!
//! Every stage reads and writes these types and knows no other stage. Lengths are checked once,
//! where a value is made ([`ShapeError`]); after that code may index.
//!
//! Conventions, everywhere: OpenCV camera axes (x right, y down, z forward), poses `c2w`, depth is
//! z-depth in the unit of the poses, principal points are measured from the image *corner* (the
//! centre of pixel (0, 0) is at (0.5, 0.5) there, so a point lands in pixel coordinates
//! `u = fx x / z + cx - 0.5`), colours are sRGB values divided by 255, time is counted in *frames*
//! of the training video (real-valued; frame `i` is at `t = i` when frames are evenly spaced).
//!
//! Vectors and matrices are those of [`nalgebra`], which is re-exported so that every crate uses
//! the same release. What is ours is what splatting needs beside them, generic over f32 and f64:
//! the scalar trait [`Real`], rigid motions with a left retraction ([`Se3`]), quaternions with
//! their vector-Jacobian products ([`quat`]; stored `(w, x, y, z)`), rotor pairs for 4D rotations
//! ([`rotor`]), and a random generator whose numbers depend on a key and not on the order of
//! drawing ([`CounterRng`]).
#![forbid(unsafe_code)]

pub mod advice;
pub mod packed;
pub mod quat;
pub mod rotor;

mod camera;
mod capture;
mod compact;
mod flow;
mod plane;
mod progress;
mod real;
mod resize;
mod rng;
mod scaffold;
mod se3;
mod sim3;
mod simd;
mod splats;
mod state;
mod tracks;

pub use camera::{Camera, Intrinsics};
pub use capture::{Capture, CaptureFrame, Exposure, Scene, SourceFrame, Video, VideoFrame};
pub use compact::{CompactDepth, CompactIds, CompactMask};
pub use fearless_simd;
pub use flow::{Flow, bilinear, bilinear_cell, cubic};
pub use nalgebra;
pub use plane::{Plane, ShapeError, covering};
pub use progress::{Progress, Silent};
pub use real::{Real, evenly, median, quantile};
pub use resize::{ResizeFilter, dilated, resize_rgb};
pub use rng::CounterRng;
pub use scaffold::{BINDING_NODES, Binding, Pose, Window};
pub use se3::{Se3, exp_so3, hat, log_so3};
pub use sim3::Sim3;
pub use simd::{ENV as SIMD_ENV, SimdLevel, SimdLevelError};
pub use splats::{Column, SplatLayout, Splats};
pub use state::{StateTensor, TrainState};
pub use tracks::Tracks;

/// An image with three 8-bit sRGB channels per pixel.
pub type RgbImage = Plane<[u8; 3]>;
/// z-depth per pixel; `0.0` where unknown.
pub type DepthMap = Plane<f32>;
/// `255` where the pixel shows something that moves, else `0`.
pub type Mask = Plane<u8>;
