//! Dense optical flow, and values between pixels.

/// Displacement per pixel from one image to another, pixels.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Flow {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height][width]`: to the right.
    pub u: Vec<f32>,
    /// `[height][width]`: downwards.
    pub v: Vec<f32>,
}

impl Flow {
    /// No displacement.
    pub fn zero(width: usize, height: usize) -> Self {
        Self { width, height, u: vec![0.0; width * height], v: vec![0.0; width * height] }
    }

    /// Bilinear value at `(x, y)`, clamped to the image.
    #[inline]
    pub fn at(&self, x: f32, y: f32) -> (f32, f32) {
        let mix = |p: &[f32]| bilinear(self.width, self.height, p, x, y);
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

/// Index of the upper left pixel of the 2x2 cell around `(x, y)` and the weights of its right and lower pixels.
#[inline]
pub fn bilinear_cell(width: usize, height: usize, x: f32, y: f32) -> (usize, f32, f32) {
    // A NaN becomes 0 in `max`, so the index is always inside.
    let x = x.max(0.0).min((width - 1) as f32);
    let y = y.max(0.0).min((height - 1) as f32);
    let (ix, iy) = ((x as usize).min(width - 2), (y as usize).min(height - 2));
    (iy * width + ix, x - ix as f32, y - iy as f32)
}

/// Bilinear value of a plane `[height][width]`, both sides at least 2, at `(x, y)`, clamped to the image.
#[inline]
pub fn bilinear(width: usize, height: usize, plane: &[f32], x: f32, y: f32) -> f32 {
    let (i, wx, wy) = bilinear_cell(width, height, x, y);
    let top = plane[i] * (1.0 - wx) + plane[i + 1] * wx;
    let bottom = plane[i + width] * (1.0 - wx) + plane[i + width + 1] * wx;
    top * (1.0 - wy) + bottom * wy
}
