//! A flow field with its mask in four bytes a pixel.

/// The code of a pixel that does not count.
pub const MASKED: i16 = i16::MIN;

/// Rows are filled up to a multiple of this with [`MASKED`].
pub(in crate::megasam::cvd) const LANES: usize = 16;

/// Columns of a stored row.
pub(in crate::megasam::cvd) fn stride(width: usize) -> usize {
    width.next_multiple_of(LANES)
}

/// A flow field as whole numbers of `unit_px`, row by row, each row `[stride]` of x and then `[stride]` of y, with
/// `stride` the width rounded up to 16. Pixels that do not count (and the filling) have [`MASKED`] for x and 0 for y.
///
/// `unit_px` is the greatest component of a pixel that counts over 32,767: a flow of 40 pixels is within 0.0006 pixels.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CompactFlow {
    /// Pixels.
    pub unit_px: f32,
    /// `[height][2][stride]`.
    pub codes: Vec<i16>,
}

impl CompactFlow {
    /// Encodes planes of `[height][width]`, which the caller has checked. A flow that is not finite does not count.
    pub(super) fn encode(width: usize, height: usize, x: &[f32], y: &[f32], mask: &[bool]) -> Self {
        let counts = |i: usize| mask[i] && x[i].is_finite() && y[i].is_finite();
        let largest = (0..width * height)
            .filter(|&i| counts(i))
            .fold(0.0f32, |m, i| m.max(x[i].abs()).max(y[i].abs()));
        let unit_px = if largest > 0.0 { largest / 32_767.0 } else { 1.0 };
        let stride = stride(width);
        let mut codes = vec![0; 2 * stride * height];
        for (row, out) in codes.chunks_exact_mut(2 * stride).enumerate() {
            let (xs, ys) = out.split_at_mut(stride);
            xs.fill(MASKED);
            for column in 0..width {
                let i = row * width + column;
                if counts(i) {
                    xs[column] = code(x[i], unit_px);
                    ys[column] = code(y[i], unit_px);
                }
            }
        }
        Self { unit_px, codes }
    }
}

fn code(value: f32, unit: f32) -> i16 {
    (value / unit).round().clamp(-32_767.0, 32_767.0) as i16
}
