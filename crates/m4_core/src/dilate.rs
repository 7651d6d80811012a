//! Dilation of masks.

/// Returns the greatest value within `radius` pixels, in the larger of the two directions, of each pixel of a mask
/// `[height][width]`: a dilation by a square of side `2 radius + 1`.
#[must_use]
pub fn dilated<T: Copy + Ord>(mask: &[T], width: usize, height: usize, radius: usize) -> Vec<T> {
    let reach = |i: usize, n: usize| i.saturating_sub(radius)..(i + radius + 1).min(n);
    let mut rows = mask.to_vec();
    for (out, row) in rows.chunks_mut(width.max(1)).zip(mask.chunks(width.max(1))) {
        for (x, out) in out.iter_mut().enumerate() {
            *out = row[reach(x, width)].iter().copied().max().unwrap_or(*out);
        }
    }
    let mut out = rows.clone();
    for y in 0..height {
        for other in reach(y, height) {
            for x in 0..width {
                out[y * width + x] = out[y * width + x].max(rows[other * width + x]);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::dilated;

    #[test]
    fn dilation_is_a_square_that_stays_inside() {
        let mut mask = vec![false; 5 * 4];
        mask[0] = true;
        mask[2 * 5 + 4] = true;
        let wide = dilated(&mask, 5, 4, 1);
        let got: Vec<usize> = (0..20).filter(|&i| wide[i]).collect();
        assert_eq!(got, [0, 1, 5, 6, 8, 9, 13, 14, 18, 19]);
        assert_eq!(dilated(&mask, 5, 4, 0), mask);
        assert_eq!(dilated::<u8>(&[], 0, 0, 3), []);
    }
}
