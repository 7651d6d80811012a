//! Dense optical flow: inverse search on patches, refined by a variational energy, coarse to fine.

mod pyramid;
mod search;
mod variational;

use super::config::{DenseConfig, FlowConfig};
use super::working::WorkingFrame;
use pyramid::Pyramid;

/// Displacement a pixel, pixels.
#[derive(Debug, Clone, Default)]
pub(crate) struct Flow {
    pub width: usize,
    pub height: usize,
    /// `[height][width]`: to the right.
    pub u: Vec<f32>,
    /// `[height][width]`: downwards.
    pub v: Vec<f32>,
}

impl Flow {
    pub fn zero(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            u: vec![0.0; width * height],
            v: vec![0.0; width * height],
        }
    }

    /// Bilinear value at `(x, y)`, clamped to the image.
    pub fn at(&self, x: f32, y: f32) -> (f32, f32) {
        let (i, wx, wy) = cell(self.width, self.height, x, y);
        let mix = |p: &[f32]| {
            let top = p[i] * (1.0 - wx) + p[i + 1] * wx;
            let bottom = p[i + self.width] * (1.0 - wx) + p[i + self.width + 1] * wx;
            top * (1.0 - wy) + bottom * wy
        };
        (mix(&self.u), mix(&self.v))
    }

    /// The same flow on an image of another size.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (sx, sy) = (width as f32 / self.width as f32, height as f32 / self.height as f32);
        let mut out = Self::zero(width, height);
        for y in 0..height {
            for x in 0..width {
                let (u, v) = self.at((x as f32 + 0.5) / sx - 0.5, (y as f32 + 0.5) / sy - 0.5);
                (out.u[y * width + x], out.v[y * width + x]) = (u * sx, v * sy);
            }
        }
        out
    }
}

/// The upper left pixel of the 2x2 cell around `(x, y)` and the weights of its right and lower pixels.
fn cell(width: usize, height: usize, x: f32, y: f32) -> (usize, f32, f32) {
    // A NaN becomes 0 in `max`, so the index is always inside.
    let x = x.max(0.0).min((width - 1) as f32);
    let y = y.max(0.0).min((height - 1) as f32);
    let (ix, iy) = ((x as usize).min(width - 2), (y as usize).min(height - 2));
    (iy * width + ix, x - ix as f32, y - iy as f32)
}

/// Flow between a frame and the next, both ways.
pub(super) struct FlowPair {
    pub forward: Flow,
    pub backward: Flow,
    /// `[height][width]`: see [`round_trip_px`].
    pub forward_round_trip: Vec<f32>,
    pub backward_round_trip: Vec<f32>,
}

impl FlowPair {
    pub fn new(a: &WorkingFrame, b: &WorkingFrame, config: &DenseConfig) -> Self {
        let pyramid = |f: &WorkingFrame| Pyramid::new(f.width, f.height, &f.grey);
        let (a, b) = (pyramid(a), pyramid(b));
        let (forward, backward) = (flow(&a, &b, &config.flow), flow(&b, &a, &config.flow));
        Self {
            forward_round_trip: round_trip_px(&forward, &backward),
            backward_round_trip: round_trip_px(&backward, &forward),
            forward,
            backward,
        }
    }
}

/// The flow from `a` to `b`.
fn flow(a: &Pyramid, b: &Pyramid, config: &FlowConfig) -> Flow {
    let mut flow: Option<Flow> = None;
    for (a, b) in a.levels.iter().zip(&b.levels).rev() {
        let start = match &flow {
            Some(coarse) => coarse.resized(a.width, a.height),
            None => Flow::zero(a.width, a.height),
        };
        let mut fine = search::search(a, b, &start, config);
        variational::refine(a, b, &mut fine, config);
        flow = Some(fine);
    }
    flow.unwrap_or_default()
}

/// How far a pixel lands from where it started after going there and back, pixels; infinite outside.
fn round_trip_px(there: &Flow, back: &Flow) -> Vec<f32> {
    let (w, h) = (there.width, there.height);
    let mut out = vec![0.0; w * h];
    for y in 0..h {
        for x in 0..w {
            let i = y * w + x;
            let (qx, qy) = (x as f32 + there.u[i], y as f32 + there.v[i]);
            let inside = qx >= 0.0 && qy >= 0.0 && qx <= (w - 1) as f32 && qy <= (h - 1) as f32;
            out[i] = if inside {
                let (u, v) = back.at(qx, qy);
                (there.u[i] + u).hypot(there.v[i] + v)
            } else {
                f32::INFINITY
            };
        }
    }
    out
}
