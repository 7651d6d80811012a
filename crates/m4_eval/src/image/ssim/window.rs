//! The window over which means and variances are computed.

/// Side of the Gaussian window, pixels.
pub const SSIM_WINDOW_PX: usize = 11;
/// Standard deviation of the Gaussian window, pixels.
pub const SSIM_SIGMA_PX: f64 = 1.5;

/// A square window, the product of the same taps along rows and columns.
#[derive(Debug, Clone, PartialEq)]
pub struct Window {
    /// An odd number, of sum 1.
    taps: Vec<f64>,
    zero_padded: bool,
    unbias: f64,
}

impl Window {
    /// [`SSIM_WINDOW_PX`] taps of a Gaussian of [`SSIM_SIGMA_PX`].
    pub fn gaussian() -> Self {
        let tap = |i: usize| {
            let d = i as f64 - (SSIM_WINDOW_PX / 2) as f64;
            (-d * d / (2.0 * SSIM_SIGMA_PX * SSIM_SIGMA_PX)).exp()
        };
        let taps: Vec<f64> = (0..SSIM_WINDOW_PX).map(tap).collect();
        let total: f64 = taps.iter().sum();
        Self::of(taps.iter().map(|w| w / total).collect())
    }

    /// `side` equal taps.
    pub fn uniform(side: usize) -> Self {
        Self::of(vec![1.0 / side as f64; side])
    }

    fn of(taps: Vec<f64>) -> Self {
        Self { taps, zero_padded: false, unbias: 1.0 }
    }

    /// With zeros beyond the border, so that every pixel has a window.
    pub fn zero_padded(self) -> Self {
        Self { zero_padded: true, ..self }
    }

    /// With variances of a sample of as many pixels as the window has, whatever their weights: scikit-image's default.
    pub fn of_sample(self) -> Self {
        let n = (self.side() * self.side()) as f64;
        Self { unbias: n / (n - 1.0), ..self }
    }

    /// Pixels a side.
    pub fn side(&self) -> usize {
        self.taps.len()
    }

    /// The taps along a row or column.
    pub fn taps(&self) -> &[f64] {
        &self.taps
    }

    /// Factor of variances.
    pub fn unbias(&self) -> f64 {
        self.unbias
    }

    /// Columns and rows that have a window, of images that are as large as one at least.
    pub fn out_size(&self, width: usize, height: usize) -> (usize, usize) {
        let lost = if self.zero_padded { 0 } else { self.side() - 1 };
        (width - lost, height - lost)
    }

    /// Weighted means of `values` `[height][width]`, in [`Self::out_size`]: along rows, then along columns.
    pub fn filtered(&self, values: &[f64], width: usize, height: usize) -> Vec<f64> {
        if !self.zero_padded {
            return self.inside(values, width, height);
        }
        let pad = self.side() / 2;
        let (wide, high) = (width + 2 * pad, height + 2 * pad);
        let mut padded = vec![0.0; wide * high];
        for (row, values) in padded[pad * wide..].chunks_exact_mut(wide).zip(values.chunks_exact(width)) {
            row[pad..pad + width].copy_from_slice(values);
        }
        self.inside(&padded, wide, high)
    }

    fn inside(&self, values: &[f64], width: usize, height: usize) -> Vec<f64> {
        let out_w = width + 1 - self.side();
        let out_h = height + 1 - self.side();
        let mut rows = vec![0.0; out_w * height];
        for (target, source) in rows.chunks_exact_mut(out_w).zip(values.chunks_exact(width)) {
            for (k, &w) in self.taps.iter().enumerate() {
                for (t, s) in target.iter_mut().zip(&source[k..]) {
                    *t += w * s;
                }
            }
        }
        let mut out = vec![0.0; out_w * out_h];
        for (y, target) in out.chunks_exact_mut(out_w).enumerate() {
            for (k, &w) in self.taps.iter().enumerate() {
                let source = &rows[(y + k) * out_w..(y + k + 1) * out_w];
                for (t, s) in target.iter_mut().zip(source) {
                    *t += w * s;
                }
            }
        }
        out
    }
}
