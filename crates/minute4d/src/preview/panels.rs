//! Places three images side by side.

use super::label;
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
                label::draw(&mut out, left + 6, 6, NAMES[i]);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::Panels;
    use m4_core::Plane;

    #[test]
    fn panels_stand_side_by_side() {
        let panels = Panels::new((8, 6), true);
        let [red, blue] = [[255, 0, 0], [0, 0, 255]].map(|c| Plane::filled(8, 6, c));
        let out = panels.compose([Some(&red), None, Some(&blue)]);
        assert_eq!(out.size(), (32, 6));
        assert_eq!(
            (out[(0, 0)], out[(12, 3)], out[(31, 5)]),
            ([255, 0, 0], [0; 3], [0, 0, 255])
        );
        assert_eq!(out[(9, 2)], [0; 3]);
    }
}
