//! Places three images side by side.

use m4_core::{Plane, RgbImage};

/// Pixels between two panels.
const GAP: usize = 4;
/// The titles of the panels.
pub(super) const NAMES: [&str; 3] = ["SOURCE", "RE-RENDER", "FROZEN TIME"];

/// The layout of a preview.
#[derive(Debug, Clone, Copy)]
pub(super) struct Panels {
    width: usize,
    height: usize,
    labels: bool,
}

impl Panels {
    /// For panels of this size.
    pub fn new((width, height): (usize, usize), labels: bool) -> Self {
        Self { width, height, labels }
    }

    /// Width and height of the whole; even when those of the panels are.
    pub fn size(&self) -> (usize, usize) {
        (3 * self.width + 2 * GAP, self.height)
    }

    /// Puts panels of the right size side by side; black where there is none.
    pub fn compose(&self, panels: [Option<&RgbImage>; 3]) -> RgbImage {
        let (width, height) = self.size();
        let mut out = Plane::filled(width, height, [0; 3]);
        for (i, panel) in panels.into_iter().enumerate() {
            let left = i * (self.width + GAP);
            for y in 0..self.height {
                if let Some(panel) = panel {
                    out.row_mut(y)[left..left + self.width].copy_from_slice(panel.row(y));
                }
            }
            if self.labels && self.width >= 120 {
                draw(&mut out, left + 6, 6, NAMES[i]);
            }
        }
        out
    }
}

/// Columns and rows of a letter.
const SIZE: (usize, usize) = (5, 7);
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

/// Writes `text` in white on a darkened strip whose top left corner is at `(x, y)`; what does not fit
/// is cut off.
pub(super) fn draw(image: &mut RgbImage, x: usize, y: usize, text: &str) {
    let advance = (SIZE.0 + 1) * DOT;
    let strip = (text.chars().count() * advance + 2 * DOT, (SIZE.1 + 2) * DOT);
    let (width, height) = image.size();
    for v in y..(y + strip.1).min(height) {
        for u in x..(x + strip.0).min(width) {
            image[(u, v)] = image[(u, v)].map(|c| c / 3);
        }
    }
    for (i, letter) in text.chars().enumerate() {
        let Some(rows) = rows(letter) else { continue };
        for (r, bits) in rows.iter().enumerate() {
            for c in (0..SIZE.0).filter(|c| bits >> (SIZE.0 - 1 - c) & 1 == 1) {
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
    use super::{Panels, draw, rows};
    use m4_core::Plane;

    #[test]
    fn panels_stand_side_by_side() {
        let panels = Panels::new((8, 6), true);
        let [red, blue] = [[255, 0, 0], [0, 0, 255]].map(|c| Plane::filled(8, 6, c));
        let out = panels.compose([Some(&red), None, Some(&blue)]);
        assert_eq!(out.size(), (32, 6));
        assert_eq!((out[(0, 0)], out[(12, 3)], out[(31, 5)]), ([255, 0, 0], [0; 3], [0, 0, 255]));
        assert_eq!(out[(9, 2)], [0; 3]);
    }

    #[test]
    fn a_letter_is_drawn_and_cut_off_at_the_border() {
        let mut image = Plane::filled(40, 30, [90; 3]);
        draw(&mut image, 0, 0, "T");
        assert_eq!((image[(2, 2)], image[(2, 10)], image[(6, 10)]), ([255; 3], [30; 3], [255; 3]));
        assert_eq!(image[(39, 29)], [90; 3]);
        draw(&mut image, 36, 26, "FROZEN TIME");
    }

    #[test]
    fn every_letter_of_the_labels_exists() {
        for letter in super::super::panels::NAMES.concat().chars().filter(|c| *c != ' ') {
            assert!(rows(letter).is_some(), "{letter}");
        }
    }
}
