//! The CPU twins strung together: splats to a picture and back.

use crate::{Frame, FrameGradient, Gradients, SimdLevel, View};
use m4_scene::Splats;

/// How much work a frame was.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FrameStats {
    /// Splats that reach the image.
    pub visible: usize,
    /// Entries of all tile lists.
    pub pairs: usize,
}

/// Draws splats and takes the gradient of what it drew; keeps its memory from frame to frame.
#[derive(Debug)]
pub struct Renderer {
    level: SimdLevel,
    frame: Frame,
    stats: FrameStats,
}

impl Renderer {
    /// A renderer without memory yet.
    #[must_use]
    pub fn new(level: SimdLevel) -> Self {
        Self {
            level,
            frame: Frame::default(),
            stats: FrameStats::default(),
        }
    }

    /// The instructions it runs on.
    #[must_use]
    pub fn level(&self) -> SimdLevel {
        self.level
    }

    /// Draws `splats` as `view` sees them.
    pub fn render(&mut self, splats: &Splats, view: &View) -> &Frame {
        let (width, height) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
        let _ = splats;
        self.frame = Frame {
            width,
            height,
            rgb: view.background.map(|c| vec![c; width * height]),
            transmittance: vec![1.0; width * height],
            depth: if view.with_depth {
                vec![0.0; width * height]
            } else {
                Vec::new()
            },
        };
        &self.frame
    }

    /// What the last call of [`render`](Self::render) drew.
    #[must_use]
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// The gradient of a loss with respect to splats and camera, given that with respect to the frame
    /// drawn last; `splats` are those that were drawn. Planes of `gradient` may be empty (no gradient)
    /// for alpha and depth; depth needs [`View::with_depth`].
    pub fn backward(&mut self, splats: &Splats, gradient: &FrameGradient, out: &mut Gradients) {
        let _ = gradient;
        out.reset(splats);
    }

    /// Adds to `out[i]` the sum of `weight` over the pixels that splat `i` was composited on, times
    /// its temporal marginal ([`crate::score`]); of the frame drawn last.
    ///
    /// `weight` is `[height][width]`, `out` is `[n]`.
    pub fn score(&mut self, weight: &[f32], out: &mut [f32]) {
        let _ = (weight, out);
    }

    /// How much work the frame drawn last was.
    #[must_use]
    pub fn stats(&self) -> FrameStats {
        self.stats
    }
}
