//! What exists: splats in columns, cameras, frames, masks and depth.
//!
//! Every stage reads and writes these types and knows no other stage. Lengths are checked once,
//! where a value is made ([`ShapeError`]); after that code may index.
//!
//! Conventions, everywhere: OpenCV camera axes (x right, y down, z forward), poses `c2w`, depth is
//! z-depth in the unit of the poses, principal points are measured from the image *corner* (the
//! centre of pixel (0, 0) is at (0.5, 0.5) there, so a point lands in pixel coordinates
//! `u = fx x / z + cx - 0.5`), colours are sRGB values divided by 255, time is counted in *frames*
//! of the training video (real-valued; frame `i` is at `t = i` when frames are evenly spaced).
#![forbid(unsafe_code)]

pub mod covariance4;

mod cache;
mod camera;
mod capture;
mod compact_depth;
mod compact_ids;
mod compact_mask;
mod error;
mod plane;
mod progress;
mod scene;
mod splats;
mod state;
mod tracks;
mod video;

pub use cache::{Cache, NoCache, ScopedCache, kept, load, store};
pub use camera::{Camera, Intrinsics};
pub use capture::{Capture, CaptureFrame};
pub use compact_depth::CompactDepth;
pub use compact_ids::CompactIds;
pub use compact_mask::CompactMask;
pub use error::ShapeError;
pub use plane::Plane;
pub use progress::{Progress, Silent};
pub use scene::{Exposure, Scene, SourceFrame};
pub use splats::{Column, SplatLayout, Splats};
pub use state::{StateTensor, TrainState};
pub use tracks::Tracks;
pub use video::{Video, VideoFrame};

/// An image with three 8-bit sRGB channels per pixel.
pub type RgbImage = Plane<[u8; 3]>;
/// z-depth per pixel; `0.0` where unknown.
pub type DepthMap = Plane<f32>;
/// `255` where the pixel shows something that moves, else `0`.
pub type Mask = Plane<u8>;
