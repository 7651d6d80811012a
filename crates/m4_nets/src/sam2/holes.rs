//! Small holes of masks.

use m4_core::Plane;

/// What fills a hole: just above the border.
const FILLED: f32 = 0.1;

/// Fills the holes of a mask, above 0 where the object is, that have at most `most` pixels: what is not the object and hangs together, over
/// corners too.
pub fn fill(logits: &mut Plane<f32>, most: usize) {
    if most == 0 {
        return;
    }
    let (w, h) = logits.size();
    // what is no number is no hole
    let mut open: Vec<bool> = logits.data().iter().map(|&x| x <= 0.0).collect();
    let mut part = Vec::new();
    for start in 0..w * h {
        if !open[start] {
            continue;
        }
        open[start] = false;
        part.clear();
        part.push(start);
        let mut next = 0;
        while let Some(&at) = part.get(next) {
            next += 1;
            let (x, y) = (at % w, at / w);
            for ny in y.saturating_sub(1)..(y + 2).min(h) {
                for nx in x.saturating_sub(1)..(x + 2).min(w) {
                    if std::mem::take(&mut open[ny * w + nx]) {
                        part.push(ny * w + nx);
                    }
                }
            }
        }
        if part.len() <= most {
            for &at in &part {
                logits.data_mut()[at] = FILLED;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::fill;
    use m4_core::Plane;

    fn mask(rows: &[&str]) -> Plane<f32> {
        Plane::from_fn(rows[0].len(), rows.len(), |x, y| match rows[y].as_bytes()[x] {
            b'#' => 3.0,
            _ => -2.0,
        })
    }

    #[test]
    fn small_holes_are_filled_and_large_ones_stay() {
        let before = mask(&["#####.", "#.##..", "##.#..", "#####.", "#.#.#.", "###.#."]);
        for (most, filled) in [(0, vec![]), (1, vec![(1, 4)]), (2, vec![(1, 1), (2, 2), (1, 4), (3, 4), (3, 5)])] {
            let mut after = before.clone();
            fill(&mut after, most);
            for (y, x) in (0..6).flat_map(|y| (0..6).map(move |x| (y, x))) {
                let want = if filled.contains(&(x, y)) { 0.1 } else { before[(x, y)] };
                assert_eq!(after[(x, y)], want, "{most}: column {x}, row {y}");
            }
        }
        for (most, left) in [(7, 8), (8, 0)] {
            let mut after = before.clone();
            fill(&mut after, most);
            assert_eq!(after.data().iter().filter(|&&x| x <= 0.0).count(), left);
        }
    }

    #[test]
    fn hole_filling_keeps_nan() {
        let mut mask = Plane::filled(3, 3, f32::NAN);
        fill(&mut mask, 100);
        assert!(mask.data().iter().all(|x| x.is_nan()));
        fill(&mut Plane::filled(0, 0, 0.0), 8);
    }
}
