//! Dense optical flow, and values between pixels.

/// Displacement per pixel from one image to another, pixels.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Flow {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height][width]`: to the right.
    #[serde(with = "crate::packed")]
    pub u: Vec<f32>,
    /// `[height][width]`: downwards.
    #[serde(with = "crate::packed")]
    pub v: Vec<f32>,
}

impl Flow {
    /// No displacement.
    pub fn zero(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            u: vec![0.0; width * height],
            v: vec![0.0; width * height],
        }
    }

    /// Bilinear value at `(x, y)`, clamped to the image.
    #[inline]
    pub fn at(&self, x: f32, y: f32) -> (f32, f32) {
        let mix = |p: &[f32]| bilinear(self.width, self.height, p, x, y);
        (mix(&self.u), mix(&self.v))
    }

    /// The same flow on an image of another size.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (sx, sy) = (
            width as f32 / self.width as f32,
            height as f32 / self.height as f32,
        );
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

/// Index of the upper left pixel of the 2x2 cell around `(x, y)` and the weights of its right and
/// lower pixels.
#[inline]
pub fn bilinear_cell(width: usize, height: usize, x: f32, y: f32) -> (usize, f32, f32) {
    // A NaN becomes 0 in `max`, so the index is always inside.
    let x = x.max(0.0).min((width - 1) as f32);
    let y = y.max(0.0).min((height - 1) as f32);
    let (ix, iy) = ((x as usize).min(width - 2), (y as usize).min(height - 2));
    (iy * width + ix, x - ix as f32, y - iy as f32)
}

/// Value of a plane `[height][width]` at `(x, y)` by cubic convolution (Keys 1981, `a = -1/2`); the
/// border repeats.
///
/// Bilinear values are blurred by an amount that depends on the fraction of the pixel, which pulls
/// aligned images towards whole pixels; these are exact to the second order.
#[inline]
pub fn cubic(width: usize, height: usize, plane: &[f32], x: f32, y: f32) -> f32 {
    let weights = |t: f32| {
        let (t2, t3) = (t * t, t * t * t);
        [
            -0.5 * t + t2 - 0.5 * t3,
            1.0 - 2.5 * t2 + 1.5 * t3,
            0.5 * t + 2.0 * t2 - 1.5 * t3,
            0.5 * (t3 - t2),
        ]
    };
    // A NaN becomes 0 in `max`, so the indices are always inside.
    let (x, y) = (
        x.max(0.0).min((width - 1) as f32),
        y.max(0.0).min((height - 1) as f32),
    );
    let (ix, iy) = (x as usize, y as usize);
    let around = |i: usize, n: usize| {
        [
            i.saturating_sub(1),
            i,
            (i + 1).min(n - 1),
            (i + 2).min(n - 1),
        ]
    };
    let (columns, across) = (around(ix, width), weights(x - ix as f32));
    let mut sum = 0.0;
    for (row, weight) in around(iy, height).into_iter().zip(weights(y - iy as f32)) {
        let row = &plane[row * width..(row + 1) * width];
        sum += weight
            * columns
                .iter()
                .zip(across)
                .map(|(&column, weight)| weight * row[column])
                .sum::<f32>();
    }
    sum
}

/// Bilinear value of a plane `[height][width]`, both sides at least 2, at `(x, y)`, clamped to the
/// image.
#[inline]
pub fn bilinear(width: usize, height: usize, plane: &[f32], x: f32, y: f32) -> f32 {
    let (i, wx, wy) = bilinear_cell(width, height, x, y);
    let top = plane[i] * (1.0 - wx) + plane[i + 1] * wx;
    let bottom = plane[i + width] * (1.0 - wx) + plane[i + width + 1] * wx;
    top * (1.0 - wy) + bottom * wy
}

#[cfg(test)]
mod tests {
    use super::cubic;

    #[test]
    fn cubic_convolution_is_exact_for_parabolas_and_holds_the_border() {
        let (w, h) = (9, 7);
        let value = |x: f32, y: f32| 3.0 - 0.5 * x + 0.25 * x * x + 0.125 * x * y - 0.5 * y * y;
        let plane: Vec<f32> = (0..w * h)
            .map(|p| value((p % w) as f32, (p / w) as f32))
            .collect();
        for (x, y) in [(3.0, 2.0), (4.25, 3.5), (1.0, 4.9), (6.75, 1.125)] {
            assert!(
                (cubic(w, h, &plane, x, y) - value(x, y)).abs() < 1e-4,
                "({x}, {y})"
            );
        }
        for (x, y, p) in [
            (-3.0, -1.0, 0),
            (40.0, 0.0, w - 1),
            (8.0, 99.0, w * h - 1),
            (f32::NAN, f32::NAN, 0),
        ] {
            assert!(
                (cubic(w, h, &plane, x, y) - plane[p]).abs() < 1e-4,
                "({x}, {y})"
            );
        }
    }
}
