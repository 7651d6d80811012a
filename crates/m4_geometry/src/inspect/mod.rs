//! What a clip shows besides one continuous take: cuts, fades, blank, repeated and frozen frames,
//! bars at the borders, logos and subtitles, changes of exposure.
//!
//! ```text
//! frames, times -> Timeline   shots, and of each the frames that are worth using (link, timeline, dissolve, repeats)
//! frames of one -> bars       the rectangle within the bars
//!               -> Overlays   pixels that stay while the scene moves; filled from around (overlay, fill)
//!               -> Exposure   brightness of the frames (exposure)
//!               -> Footage    the frames cleaned of all that, and what was done to them
//! ```
//!
//! All of it is measured against the clip itself: a share of its own detail, of its own motion, of
//! its own points that are found again. What cannot be told from ordinary footage stays as it is.

mod bars;
mod dissolve;
mod exposure;
mod fill;
mod footage;
mod link;
mod overlay;
mod repeats;
#[cfg(test)]
mod tests;
mod timeline;
mod words;

pub use bars::{Rectangle, bars};
pub use exposure::Exposure;
pub use footage::{Footage, nearest};
pub use overlay::Overlays;
pub use timeline::{LeftOut, Reason, Shot, ShotError, Shown, Timeline};

use crate::classical::sparse::luma::{WorkingSize, luma};
use m4_core::{Plane, RgbImage};

/// Luma with a longest side of at most `longest_px` pixels.
fn small(image: &RgbImage, longest_px: usize) -> Plane<f32> {
    let (width, height) = image.size();
    luma(image, WorkingSize::new(width, height, longest_px))
}

/// The part of `plane` within `area`.
fn cut_out<T: Copy>(plane: &Plane<T>, area: Rectangle) -> Plane<T> {
    Plane::from_fn(area.width, area.height, |x, y| {
        plane[(area.x + x, area.y + y)]
    })
}

/// The value that a share of `values` is below; 0 for none.
fn quantile(values: &[f32], share: f64) -> f32 {
    m4_core::quantile(&mut values.to_vec(), share).unwrap_or(0.0)
}
