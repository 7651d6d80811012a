//! For every pixel the nearest one of a set, exactly, in time that goes with the pixels (Meijster et al., "A General Algorithm for
//! Computing Distance Transforms in Linear Time", 2000).

use rayon::prelude::*;

/// For each pixel of an image of `w` by `h` the nearest one that is `in_set`; `None` if there is none.
pub fn nearest_pixels(in_set: &[bool], w: usize, h: usize) -> Vec<Option<usize>> {
    let rows = nearest_in_columns(in_set, w, h);
    let mut out = vec![None; w * h];
    if w == 0 {
        return out;
    }
    out.par_chunks_mut(w).zip(rows.par_chunks(w)).enumerate().for_each(|(y, (out, rows))| along_row(out, rows, y, w));
    out
}

/// For each pixel the row of the nearest one in its column.
fn nearest_in_columns(in_set: &[bool], w: usize, h: usize) -> Vec<Option<usize>> {
    let mut rows: Vec<Option<usize>> = vec![None; w * h];
    for y in 0..h {
        for x in 0..w {
            let above = if y > 0 { rows[(y - 1) * w + x] } else { None };
            rows[y * w + x] = if in_set[y * w + x] { Some(y) } else { above };
        }
    }
    for y in (0..h.saturating_sub(1)).rev() {
        for x in 0..w {
            let below = rows[(y + 1) * w + x];
            let near = |row: Option<usize>| row.map_or(usize::MAX, |row| row.abs_diff(y));
            if near(below) < near(rows[y * w + x]) {
                rows[y * w + x] = below;
            }
        }
    }
    rows
}

/// The lower envelope of the parabolas that the columns' distances are.
fn along_row(out: &mut [Option<usize>], rows: &[Option<usize>], y: usize, w: usize) {
    let height = |x: usize| rows[x].map(|row| (row.abs_diff(y) as f64).powi(2));
    // columns whose parabola is lowest somewhere, and where that begins
    let mut columns: Vec<(usize, f64)> = Vec::new();
    for x in 0..w {
        let Some(g) = height(x) else { continue };
        let mut from = f64::NEG_INFINITY;
        while let Some(&(other, begins)) = columns.last() {
            let (a, b) = (other as f64, x as f64);
            let g_other = height(other).unwrap_or(f64::INFINITY);
            from = ((b * b + g) - (a * a + g_other)) / (2.0 * (b - a));
            if from > begins {
                break;
            }
            columns.pop();
            from = f64::NEG_INFINITY;
        }
        columns.push((x, from));
    }
    let mut k = 0;
    for (x, out) in out.iter_mut().enumerate() {
        while columns.get(k + 1).is_some_and(|&(_, begins)| begins < x as f64) {
            k += 1;
        }
        *out = columns.get(k).and_then(|&(column, _)| rows[column].map(|row| row * w + column));
    }
}

#[cfg(test)]
mod tests {
    use super::nearest_pixels;

    #[test]
    fn agrees_with_looking_at_all() {
        let (w, h) = (23, 17);
        for step in [3, 7, 29, 101, 1000] {
            let set: Vec<bool> = (0..w * h).map(|i| (i * i * 31 + 5) % step == 1).collect();
            let got = nearest_pixels(&set, w, h);
            let square = |i: usize, j: usize| (i % w).abs_diff(j % w).pow(2) + (i / w).abs_diff(j / w).pow(2);
            for (i, got) in got.iter().enumerate() {
                let want = (0..w * h).filter(|&j| set[j]).map(|j| square(i, j)).min();
                assert_eq!(got.map(|j| square(i, j)), want, "{i}");
                assert!(got.is_none_or(|j| set[j]));
            }
        }
        assert!(nearest_pixels(&[], 0, 0).is_empty());
    }
}
