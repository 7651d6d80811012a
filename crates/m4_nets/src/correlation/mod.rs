//! Correlation of two feature maps, looked up around positions: what DROID's and RAFT's updates see of the images.
//!
//! ```text
//! score(p, q) = f(p) . g(q) / 16
//! g is pooled 2 x 2 (mean; a last odd row or column is dropped) once a level
//! lookup(p)[level][dx][dy] = bilinear score(p, position(p) / 2^level + (dx, dy)),  |dx|, |dy| <= radius, 0 outside
//! ```
//!
//! - Papers: Teed and Deng, "RAFT", ECCV 2020, section 3.2, and "DROID-SLAM", NeurIPS 2021, section 3.2. Upstreams:
//!   princeton-vl/RAFT and princeton-vl/DROID-SLAM, BSD-3.
//! - Both divide by 16, whatever the width of the features: RAFT as `sqrt(256)`, DROID as two divisions by 4. Here each map is
//!   divided by 4, which is exact and keeps half precision in range.
//! - The offset in x is the slow index, as published.
//!
//! Positions are pixels of the maps whose centres are whole numbers. No scores of all pairs are kept: on the processor
//! [`scores`] computes those that a window touches; elsewhere it makes them some rows of the source at a time. Pooling and
//! the product commute, so pooled features give what pooled scores give.

mod pyramid;
#[cfg(test)]
mod tests;
mod volume;
mod window;

pub use pyramid::{FeatureMap, Pyramid};
pub use window::window_scores;

use burn_core::tensor::Tensor;
use pyramid::Values;

/// Offsets of a window a side.
pub const fn side(radius: usize) -> usize {
    2 * radius + 1
}

/// Numbers that a lookup gives a pixel: `levels * (2 radius + 1)^2`.
pub const fn taps(levels: usize, radius: usize) -> usize {
    levels * side(radius) * side(radius)
}

/// The scores of each pixel of `source` `[h, w, c]` around `centres` `[h, w, 2]` (x, then y; pixels of the finest level of
/// `target`, 32 bits): `[h, w, levels * (2 radius + 1)^2]`, of which the level is the slowest index and the offset in y the
/// fastest. A centre that is no number lies outside. Source and target are on one device and of one width; the result is
/// in the type of their features.
pub fn scores(source: &FeatureMap, target: &Pyramid, centres: Tensor<3>, radius: usize) -> Tensor<3> {
    let [h, w, c] = source.size();
    debug_assert_eq!(target.channels(), c, "maps of one width");
    match source.values() {
        Values::Processor(features) => {
            let device = centres.device();
            let centres = centres.into_data();
            let centres = centres.iter::<f32>().collect::<Vec<_>>();
            let width = taps(target.levels().len(), radius);
            let mut out = vec![0.0; h * w * width];
            window_scores(features, c, w, target, &centres, radius, &mut out);
            crate::ops::tensor(out, [h, w, width], &device)
        }
        Values::Device(features) => volume::scores(features.clone(), target, centres, radius),
    }
}

/// The first of the whole positions that a window at `centre` touches, and how far `centre` lies beyond the whole number
/// before it. Positions so far outside of `0..extent` that no tap matters are drawn near, and so is what is no number.
fn first_and_fraction(centre: f32, extent: usize, radius: usize) -> (i32, f32) {
    let [low, high] = reach(extent, radius);
    let centre = centre.max(low).min(high);
    let whole = centre.floor();
    (whole as i32 - radius as i32, centre - whole)
}

/// Centres below the first or above the second touch nothing of `0..extent`, and nor do these two.
fn reach(extent: usize, radius: usize) -> [f32; 2] {
    [-(radius as f32) - 2.0, (extent + radius) as f32 + 1.0]
}
