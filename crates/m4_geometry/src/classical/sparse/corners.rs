//! Where tracks begin: the strongest Shi-Tomasi corner of every empty cell.

use m4_core::Plane;

/// Side of the cells that hold at least one track each, where there is texture, working pixels. 16 gives about 700 tracks on 480x360.
const CELL_PX: usize = 16;
/// New corners keep this distance from existing tracks, working pixels.
pub(super) const MIN_DISTANCE_PX: f32 = 6.0;
/// Corners weaker than this share of the strongest one are not used. Shi and Tomasi use 0.01 to 0.1; lower because cells already
/// spread the corners.
const QUALITY: f32 = 0.001;
/// Corners with a lesser eigenvalue below this (squared grey levels) are noise.
const MIN_RESPONSE: f32 = 2.0;

/// The lesser eigenvalue of the mean structure tensor over 5x5 pixels, in squared grey levels per
/// pixel (Shi and Tomasi 1994); 0 within 3 pixels of the border.
pub(crate) fn response(luma: &Plane<f32>) -> Plane<f32> {
    const RADIUS: usize = 2;
    let (w, h) = luma.size();
    let mut out = Plane::filled(w, h, 0.0);
    let border = RADIUS + 1;
    if w <= 2 * border || h <= 2 * border {
        return out;
    }
    // Columns of the tensor summed over 5 rows, then over 5 columns.
    let gradient = |x: usize, y: usize| {
        let dx = 0.5 * (luma[(x + 1, y)] - luma[(x - 1, y)]);
        let dy = 0.5 * (luma[(x, y + 1)] - luma[(x, y - 1)]);
        [dx * dx, dx * dy, dy * dy]
    };
    let products: Vec<Vec<[f32; 3]>> = (1..h - 1)
        .map(|y| (1..w - 1).map(|x| gradient(x, y)).collect())
        .collect();
    let mut columns = vec![[0.0_f32; 3]; w - 2];
    for y in border..h - border {
        for (x, sum) in columns.iter_mut().enumerate() {
            *sum = [0.0; 3];
            for row in &products[y - 1 - RADIUS..y + RADIUS] {
                for k in 0..3 {
                    sum[k] += row[x][k];
                }
            }
        }
        let line = out.row_mut(y);
        for x in border..w - border {
            let mut t = [0.0_f32; 3];
            for column in &columns[x - 1 - RADIUS..x + RADIUS] {
                for k in 0..3 {
                    t[k] += column[k];
                }
            }
            let (mean, half_difference) = (0.5 * (t[0] + t[2]), 0.5 * (t[0] - t[2]));
            line[x] = (mean - (half_difference * half_difference + t[1] * t[1]).sqrt()) / 25.0;
        }
    }
    out
}

/// New corners in the cells that hold none of `occupied` (pixel coordinates), at least
/// [`MIN_DISTANCE_PX`] away from all of them, at least `margin` pixels inside; in order of cells.
pub(crate) fn fill_empty_cells(luma: &Plane<f32>, occupied: &[[f32; 2]], margin: usize) -> Vec<[f32; 2]> {
    let (w, h) = luma.size();
    let response = response(luma);
    let (columns, rows) = (w.div_ceil(CELL_PX), h.div_ceil(CELL_PX));
    let cell = |p: [f32; 2]| {
        let along = |v: f32, n: usize| ((v.max(0.0) as usize) / CELL_PX).min(n - 1);
        along(p[1], rows) * columns + along(p[0], columns)
    };
    let mut cells: Vec<Vec<[f32; 2]>> = vec![Vec::new(); columns * rows];
    for &p in occupied {
        cells[cell(p)].push(p);
    }
    let strongest = response.data().iter().copied().fold(0.0_f32, f32::max);
    let threshold = (QUALITY * strongest).max(MIN_RESPONSE);
    let near = |cells: &[Vec<[f32; 2]>], p: [f32; 2], cx: usize, cy: usize| {
        (cy.saturating_sub(1)..(cy + 2).min(rows))
            .flat_map(|y| (cx.saturating_sub(1)..(cx + 2).min(columns)).map(move |x| y * columns + x))
            .any(|c| {
                cells[c]
                    .iter()
                    .any(|q| (q[0] - p[0]).hypot(q[1] - p[1]) < MIN_DISTANCE_PX)
            })
    };
    let mut found = Vec::new();
    for cy in 0..rows {
        for cx in 0..columns {
            if !cells[cy * columns + cx].is_empty() {
                continue;
            }
            let mut best: Option<(f32, [f32; 2])> = None;
            for y in (cy * CELL_PX).max(margin)..((cy + 1) * CELL_PX).min(h.saturating_sub(margin)) {
                for x in (cx * CELL_PX).max(margin)..((cx + 1) * CELL_PX).min(w.saturating_sub(margin)) {
                    let value = response[(x, y)];
                    let p = [x as f32, y as f32];
                    if value >= threshold && best.is_none_or(|(b, _)| value > b) && !near(&cells, p, cx, cy) {
                        best = Some((value, p));
                    }
                }
            }
            if let Some((_, p)) = best {
                cells[cy * columns + cx].push(p);
                found.push(p);
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::{fill_empty_cells, response};
    use m4_core::Plane;

    fn squares() -> Plane<f32> {
        Plane::from_fn(96, 96, |x, y| if (x / 24 + y / 24) % 2 == 0 { 30.0 } else { 200.0 })
    }

    #[test]
    fn corners_answer_and_edges_do_not() {
        let r = response(&squares());
        assert!(r[(24, 24)] > 100.0, "{}", r[(24, 24)]);
        assert!(r[(36, 24)] < 1e-2 && r[(36, 36)] < 1e-2);
    }

    #[test]
    fn occupied_cells_stay_as_they_are() {
        let all = fill_empty_cells(&squares(), &[], 8);
        assert!(all.len() >= 9, "{all:?}");
        assert!(fill_empty_cells(&squares(), &all, 8).is_empty());
        let flat = Plane::filled(96, 96, 128.0);
        assert!(fill_empty_cells(&flat, &[], 8).is_empty());
    }
}
