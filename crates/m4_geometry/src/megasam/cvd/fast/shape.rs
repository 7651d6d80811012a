//! How planes lie in memory.

use crate::dba::Pinhole;
use crate::megasam::cvd::pairs::FramePair;
use crate::megasam::cvd::reference::relative;
use m4_core::{Se3, nalgebra::Matrix3};

/// Columns left of the image in a bordered plane; what is right of it is at least as wide.
const LEFT: usize = 8;

/// Two layouts of a frame. *Plain* planes are `[height][stride]`, the stride a multiple of the
/// vectors' 16 lanes. *Bordered* planes have zeros around the image, so that four taps can be read,
/// and added to, anywhere from one pixel outside without asking where they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shape {
    pub width: usize,
    pub height: usize,
    /// Of plain planes.
    pub stride: usize,
    /// Of bordered planes.
    pub tap_stride: usize,
}

impl Shape {
    pub fn new(width: usize, height: usize) -> Self {
        let stride = crate::megasam::cvd::pairs::stride(width);
        Self {
            width,
            height,
            stride,
            tap_stride: stride + 2 * LEFT,
        }
    }

    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    pub fn plain(&self) -> usize {
        self.stride * self.height
    }

    pub fn bordered(&self) -> usize {
        self.tap_stride * (self.height + 3)
    }

    /// Of the first pixel of row `y` in a bordered plane.
    pub fn tap_row(&self, y: usize) -> usize {
        (y + 1) * self.tap_stride + LEFT
    }

    /// Index in a bordered plane of pixel (0, 0).
    pub fn origin(&self) -> usize {
        self.tap_row(0)
    }

    /// `[height][width]` as a plain plane, the filling with `fill`.
    pub fn spread(&self, plane: &[f32], fill: f32) -> Vec<f32> {
        let mut out = vec![fill; self.plain()];
        for (out, row) in out
            .chunks_exact_mut(self.stride)
            .zip(plane.chunks_exact(self.width))
        {
            out[..self.width].copy_from_slice(row);
        }
        out
    }

    /// A plain plane as `[height][width]`.
    pub fn gather(&self, plane: &[f32]) -> Vec<f32> {
        let rows = plane.chunks_exact(self.stride);
        rows.flat_map(|row| &row[..self.width]).copied().collect()
    }
}

/// Where a pixel of a pair's source lands in its target, before the division:
/// `turn (x, y, 1) / disparity + shift`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Motion {
    /// `K R K^-1`, row by row.
    pub turn: [[f32; 3]; 3],
    /// `K t`.
    pub shift: [f32; 3],
}

impl Motion {
    pub fn new(lens: &Pinhole<f64>, w2c: &[Se3<f64>], pair: FramePair) -> Self {
        let step = relative(&w2c[pair.source], &w2c[pair.target]);
        let k = Matrix3::new(lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0);
        let (x, y) = (1.0 / lens.fx, 1.0 / lens.fy);
        let back = Matrix3::new(x, 0.0, -lens.cx * x, 0.0, y, -lens.cy * y, 0.0, 0.0, 1.0);
        let (turn, shift) = (k * step.rotation * back, k * step.translation);
        Self {
            turn: std::array::from_fn(|r| std::array::from_fn(|c| turn[(r, c)] as f32)),
            shift: std::array::from_fn(|r| shift[r] as f32),
        }
    }
}
