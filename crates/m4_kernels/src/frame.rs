//! The inputs and outputs of one frame, shared by all versions of the kernels, and statistics of
//! training steps.

use m4_core::{Camera, Splats};

/// What to draw: a camera at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Lens and pose; its width and height are those of the image.
    pub camera: Camera,
    /// Frames.
    pub t: f64,
    /// Colour behind everything, 0..1.
    pub background: [f32; 3],
    /// Splats with a z-depth of at most this are skipped, world units.
    pub near: f32,
    /// Opacity-compensated 2D filter (docs/spec/optimiser.md 1.6).
    pub mip: bool,
    /// Period of the first temporal harmonic of the colour, frames.
    pub period: f32,
    /// Also composite the z-depth ([`Frame::depth`]).
    pub with_depth: bool,
}

/// A rendered image, one plane per channel, `[height][width]` each, row by row.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Frame {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Colour, background included, not clamped.
    pub rgb: [Vec<f32>; 3],
    /// Light that passes every splat; alpha is one minus this.
    pub transmittance: Vec<f32>,
    /// Sum of blending weight times z-depth (not divided by alpha); empty unless asked for.
    pub depth: Vec<f32>,
}

/// The gradient of a loss with respect to one camera.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CameraGradient {
    /// Left twist of the world-to-camera pose, translation part (docs/spec/optimiser.md 1.6).
    pub tau: [f64; 3],
    /// Left twist, rotation part.
    pub omega: [f64; 3],
    /// fx, fy, cx, cy.
    pub intrinsics: [f64; 4],
}

/// The gradient of a loss with respect to splats and camera.
#[derive(Debug, Clone, Default)]
pub struct Gradients {
    /// Same columns as [`Splats::columns`]; rows that are not `touched` hold arbitrary values.
    pub columns: Vec<Vec<f32>>,
    /// `[n]`: 1 where the splat reached a pixel of this frame, else 0.
    pub touched: Vec<u8>,
    /// `[n]`: length of the gradient with respect to the projected centre in units of half the
    /// image (docs/spec/optimiser.md 1.7); `None` unless asked for, arbitrary in rows that are not
    /// `touched`.
    pub image: Option<Vec<f32>>,
    /// With respect to the camera; 0 unless asked for.
    pub camera: CameraGradient,
    /// With respect to the background colour.
    pub background: [f32; 3],
    /// With respect to nodes, of each window that has a key at the instant.
    pub nodes: Vec<NodeGradients>,
}

/// Parameters of a node at a key: its position, and a turn about it (left, world axes).
pub const NODE_PARAMETERS: usize = 6;

/// The gradient of a loss with respect to the nodes of a window at one of its keys.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NodeGradients {
    /// Index of the window.
    pub window: usize,
    /// Index of its key.
    pub key: usize,
    /// Of each node: with respect to its position, and to a turn about it (left, world axes).
    pub nodes: Vec<[f32; NODE_PARAMETERS]>,
}

impl Gradients {
    /// Makes room for the gradients of `splats` alone, all untouched.
    pub fn reset(&mut self, splats: &Splats) {
        self.resize(splats);
        self.touched.fill(0);
    }

    /// Makes room for the gradients of `splats`; what the rows hold is anything.
    pub(crate) fn resize(&mut self, splats: &Splats) {
        self.columns.resize_with(splats.columns().len(), Vec::new);
        for (gradient, column) in self.columns.iter_mut().zip(splats.columns()) {
            gradient.resize(column.len(), 0.0);
        }
        self.touched.resize(splats.n(), 0);
        if let Some(image) = &mut self.image {
            image.resize(splats.n(), 0.0);
        }
        self.camera = CameraGradient::default();
        self.background = [0.0; 3];
    }
}

/// What training steps found since the last time that they were asked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StepStats {
    /// Steps; the rest is unspecified where there were none.
    pub steps: usize,
    /// Frames rendered: as many per step as a batch has.
    pub frames: usize,
    /// Mean of the absolute differences over channels, pixels and frames; not finite if an image
    /// was not.
    pub l1: f64,
    /// Mean structural similarity.
    pub ssim: f64,
    /// PSNR of the frame rendered last, dB, colours clamped to 0..1, at most 100; NaN where it was
    /// not measured.
    pub psnr: f64,
    /// Splats that a step moved, mean.
    pub touched: f64,
    /// Gradients of the cameras that were requested, in the order of the views, each with the
    /// number of its frame.
    pub cameras: Vec<(usize, CameraGradient)>,
    /// Gradients of the exposures that were requested, likewise: rows of the matrix, each followed
    /// by its offset.
    pub exposures: Vec<(usize, [f64; 12])>,
    /// No step moved a parameter to NaN or infinity.
    pub splats_are_finite: bool,
}
