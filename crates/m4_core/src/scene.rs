//! A trained scene: what a renderer needs and nothing else.

use crate::{Camera, Splats};

/// Per-frame colour correction `c' = matrix c + offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Row-major 3x3, identity when nothing is corrected.
    pub matrix: [[f32; 3]; 3],
    /// Added after the matrix.
    pub offset: [f32; 3],
}

impl Exposure {
    /// Changes nothing.
    pub const IDENTITY: Self = Self { matrix: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], offset: [0.0; 3] };
}

/// Camera, moment and exposure of one training frame, as optimised.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SourceFrame {
    /// Lens and pose.
    pub camera: Camera,
    /// Frames.
    pub t: f64,
    /// Colour correction of this frame.
    pub exposure: Exposure,
}

/// Splats and the cameras that saw them.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// The Gaussians.
    pub splats: Splats,
    /// Colour behind everything, 0..1.
    pub background: [f32; 3],
    /// Time runs from 0 to `time_frames - 1` frames.
    pub time_frames: usize,
    /// Seconds from the first to the last frame, where known.
    pub duration_s: Option<f64>,
    /// Opacity-compensated 2D filter on (Mip filter, docs/spec/optimiser.md 1.6).
    pub mip: bool,
    /// Splats nearer than this z-depth are not drawn, world units.
    pub near: f32,
    /// The training cameras, in order of time.
    pub source: Vec<SourceFrame>,
}
