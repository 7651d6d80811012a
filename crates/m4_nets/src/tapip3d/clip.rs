//! What a tracker is given, and what it gives back.

use crate::error::ClipError;
use m4_core::{Camera, DepthMap, RgbImage};

/// A clip whose frames are asked for when they are needed: each some times, in order and in
/// reverse, a window of them kept. Errors say what hinders it.
pub trait PosedClip {
    /// How many frames there are.
    fn frames(&self) -> usize;

    /// The image of `frame`, in any size.
    fn image(&self, frame: usize) -> Result<RgbImage, ClipError>;

    /// z-depth of `frame` in the unit of the poses, in any size that shows what the image shows. 0,
    /// less, or not finite where it is not known.
    fn depth(&self, frame: usize) -> Result<DepthMap, ClipError>;

    /// The camera of `frame`: its pose, and its intrinsics for the image's or any other size.
    fn camera(&self, frame: usize) -> Result<Camera, ClipError>;
}

/// A point to follow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointQuery {
    /// The frame in which it is where it is.
    pub frame: usize,
    /// Where it is, in the world.
    pub world: [f64; 3],
}

/// How points are followed.
#[derive(Debug, Clone, PartialEq)]
pub struct Tapip3dOptions {
    /// Columns and rows that frames are brought to; upstream's default, the training size with
    /// twice the pixels, is [`Tapip3d::published_size`](super::Tapip3d::published_size). Time and
    /// memory of the encoder go with the pixels.
    pub size: (usize, usize),
    /// Times that each window is revised; 6, as published.
    pub iterations: usize,
    /// Rows and columns of points of the first frame that are followed beside those that are asked
    /// for, so that the network sees how the scene moves; 16, as published.
    pub support_grid: usize,
    /// Whether frames before a point's own are followed too, on the reversed clip; as published.
    pub backward: bool,
    /// Whether depth at edges of objects is replaced by that beside them; as published.
    pub clean_edges: bool,
    /// Bytes for what is worked with. More lets more points be followed together and features of
    /// more frames be kept for the way back; what is asked for and its answer come on top (some 70
    /// kB per point in 32 bits).
    pub memory_bytes: usize,
}

impl Tapip3dOptions {
    /// As published, with frames of `size`.
    #[must_use]
    pub fn at(size: (usize, usize)) -> Self {
        Self {
            size,
            iterations: 6,
            support_grid: 16,
            backward: true,
            clean_edges: true,
            memory_bytes: 2 << 30,
        }
    }
}

/// Where points went.
#[derive(Debug, Clone, PartialEq)]
pub struct PointTracks {
    /// Frames of the clip.
    pub frames: usize,
    /// Where the points are, in the world, `[query][frame]`.
    pub world: Vec<[f32; 3]>,
    /// How likely they are visible, 0 to 1, `[query][frame]`.
    pub visibility: Vec<f32>,
}
