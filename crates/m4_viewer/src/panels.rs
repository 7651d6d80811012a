//! Panels side by side, with labels: what a preview shows of a scene.

use m4_core::{Plane, RgbImage};

/// Places panels of one size, `(width, height)` pixels, side by side, `gap_px` apart; black where
/// there is none.
pub fn side_by_side(
    (width, height): (usize, usize),
    gap_px: usize,
    panels: &[Option<&RgbImage>],
) -> RgbImage {
    let gaps = gap_px * panels.len().saturating_sub(1);
    let mut out = Plane::filled(width * panels.len() + gaps, height, [0; 3]);
    for (i, panel) in panels.iter().enumerate() {
        let left = i * (width + gap_px);
        let Some(panel) = panel else { continue };
        for y in 0..height {
            out.row_mut(y)[left..left + width].copy_from_slice(panel.row(y));
        }
    }
    out
}

/// Columns and rows of a letter.
const LETTER: (usize, usize) = (5, 7);
/// Pixels a dot.
const DOT: usize = 2;

/// The rows of a letter, most significant of five bits to the left; `None` draws as a space.
fn rows(letter: char) -> Option<[u8; 7]> {
    Some(match letter {
        'C' => [0x0e, 0x11, 0x10, 0x10, 0x10, 0x11, 0x0e],
        'D' => [0x1e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x1e],
        'E' => [0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x1f],
        'F' => [0x1f, 0x10, 0x10, 0x1e, 0x10, 0x10, 0x10],
        'I' => [0x0e, 0x04, 0x04, 0x04, 0x04, 0x04, 0x0e],
        'M' => [0x11, 0x1b, 0x15, 0x15, 0x11, 0x11, 0x11],
        'N' => [0x11, 0x19, 0x15, 0x13, 0x11, 0x11, 0x11],
        'O' => [0x0e, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e],
        'R' => [0x1e, 0x11, 0x11, 0x1e, 0x14, 0x12, 0x11],
        'S' => [0x0f, 0x10, 0x10, 0x0e, 0x01, 0x01, 0x1e],
        'T' => [0x1f, 0x04, 0x04, 0x04, 0x04, 0x04, 0x04],
        'U' => [0x11, 0x11, 0x11, 0x11, 0x11, 0x11, 0x0e],
        'Z' => [0x1f, 0x01, 0x02, 0x04, 0x08, 0x10, 0x1f],
        '-' => [0x00, 0x00, 0x00, 0x1f, 0x00, 0x00, 0x00],
        _ => return None,
    })
}

/// Writes `text` in white on a darkened strip whose top left corner is at `(x, y)`; what does not
/// fit is cut off. The letters are those of the labels of a preview; others are left blank.
pub fn write_label(image: &mut RgbImage, x: usize, y: usize, text: &str) {
    let advance = (LETTER.0 + 1) * DOT;
    let strip = (
        text.chars().count() * advance + 2 * DOT,
        (LETTER.1 + 2) * DOT,
    );
    let (width, height) = image.size();
    for v in y..(y + strip.1).min(height) {
        for u in x..(x + strip.0).min(width) {
            image[(u, v)] = image[(u, v)].map(|c| c / 3);
        }
    }
    for (i, letter) in text.chars().enumerate() {
        let Some(rows) = rows(letter) else { continue };
        for (r, bits) in rows.iter().enumerate() {
            for c in (0..LETTER.0).filter(|c| bits >> (LETTER.0 - 1 - c) & 1 == 1) {
                let (left, top) = (x + DOT + i * advance + c * DOT, y + DOT + r * DOT);
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    if left + dx < width && top + dy < height {
                        image[(left + dx, top + dy)] = [255; 3];
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{rows, side_by_side, write_label};
    use m4_core::Plane;

    #[test]
    fn panels_are_side_by_side() {
        let [red, blue] = [[255, 0, 0], [0, 0, 255]].map(|c| Plane::filled(8, 6, c));
        let out = side_by_side((8, 6), 4, &[Some(&red), None, Some(&blue)]);
        assert_eq!(out.size(), (24 + 2 * 4, 6));
        assert_eq!(
            (out[(0, 0)], out[(12, 3)], out[(31, 5)]),
            ([255, 0, 0], [0; 3], [0, 0, 255])
        );
        assert_eq!(out[(9, 2)], [0; 3]);
    }

    #[test]
    fn every_letter_exists_and_is_cut_off_at_the_border() {
        let mut image = Plane::filled(40, 30, [90; 3]);
        write_label(&mut image, 0, 0, "T");
        assert_eq!(
            (image[(2, 2)], image[(2, 10)], image[(6, 10)]),
            ([255; 3], [30; 3], [255; 3])
        );
        assert_eq!(image[(39, 29)], [90; 3]);
        write_label(&mut image, 36, 26, "FROZEN TIME");
        for letter in "SOURCERE-RENDERFROZENTIME".chars() {
            assert!(rows(letter).is_some(), "{letter}");
        }
    }
}
