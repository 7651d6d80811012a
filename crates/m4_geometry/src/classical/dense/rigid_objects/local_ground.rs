//! The ground around the feet of a part: the plane of the static pixels there.
//!
//! The disparity of a plane is affine in the pixel, so that one fit of many pixels gives the ground
//! at the feet themselves, where the image shows none of it. What is filled in behind a part, and
//! what is measured right beside it, is not counted.

use super::WorkingClip;
use m4_core::quantile;
use nalgebra::{Matrix3, Vector3};

/// How far around the part the ground is read, in heights of the part below and above its lowest
/// pixel, and in widths beside it; and at least this share of the image's width.
const BELOW: f32 = 1.0 / 3.0;
const ABOVE: f32 = 1.0 / 6.0;
const BESIDE: f32 = 1.0 / 3.0;
const LEAST_REACH: f32 = 1.0 / 64.0;
/// Distance from dynamic pixels below which static ones are not counted, pixels at the working
/// size: outlines are right to a pixel, and depth beside them mixes both.
const MARGIN_PX: usize = 2;
/// Fewest pixels.
const FEWEST: usize = 40;
/// Rounds of reweighting, and the residual, in median residuals, that counts half.
const ROUNDS: usize = 8;
const TOLERANCE: f64 = 2.0;

/// Disparity as an affine function of the pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct LocalGround {
    /// By column, by row, and at pixel 0, 0.
    coefficients: Vector3<f64>,
}

impl LocalGround {
    /// The disparity at a pixel.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        self.coefficients.dot(&Vector3::new(x, y, 1.0))
    }

    /// The plane of most static pixels around the lowest of `pixels` (rising) in frame `i`; `None`
    /// where there are few.
    pub fn under(clip: &WorkingClip<'_>, i: usize, pixels: &[u32]) -> Option<Self> {
        let (w, h) = (clip.width, clip.height);
        let column = |p: &u32| *p as usize % w;
        let (left, right) = (
            pixels.iter().map(column).min()?,
            pixels.iter().map(column).max()?,
        );
        let row = |p: u32| p as usize / w;
        let (top, bottom) = (row(*pixels.first()?), row(*pixels.last()?));
        let least = LEAST_REACH * w as f32;
        let reach = |share: f32, size: usize| (share * size as f32).max(least).round() as usize;
        let beside = reach(BESIDE, right - left);
        let rows = bottom.saturating_sub(reach(ABOVE, bottom - top))
            ..(bottom + reach(BELOW, bottom - top) + 1).min(h);
        let columns = left.saturating_sub(beside)..(right + beside + 1).min(w);
        let mut samples: Vec<(Vector3<f64>, f64)> = Vec::new();
        for y in rows {
            for x in columns.clone().filter(|&x| is_clear(clip, i, x, y)) {
                let d = f64::from(clip.disparity[i][y * w + x]);
                samples.push((Vector3::new(x as f64, y as f64, 1.0), d));
            }
        }
        if samples.len() < FEWEST {
            return None;
        }
        let mut weights = vec![1.0; samples.len()];
        let mut coefficients = fitted(&samples, &weights)?;
        for _ in 0..ROUNDS {
            let residual = |(at, d): &(Vector3<f64>, f64)| d - coefficients.dot(at);
            let residuals: Vec<f64> = samples.iter().map(residual).collect();
            let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
            let scale = TOLERANCE * quantile(&mut sizes, 0.5)?;
            if scale <= 0.0 {
                break;
            }
            for (weight, residual) in weights.iter_mut().zip(&residuals) {
                *weight = (1.0 + (residual / scale).powi(2)).powi(-2);
            }
            coefficients = fitted(&samples, &weights)?;
        }
        Some(Self { coefficients })
    }
}

/// Whether a pixel and those around it are static.
fn is_clear(clip: &WorkingClip<'_>, i: usize, x: usize, y: usize) -> bool {
    let (w, h) = (clip.width, clip.height);
    (y.saturating_sub(MARGIN_PX)..(y + MARGIN_PX + 1).min(h)).all(|y| {
        let row = &clip.dynamic[i][y * w..(y + 1) * w];
        row[x.saturating_sub(MARGIN_PX)..(x + MARGIN_PX + 1).min(w)]
            .iter()
            .all(|dynamic| *dynamic == 0)
    })
}

fn fitted(samples: &[(Vector3<f64>, f64)], weights: &[f64]) -> Option<Vector3<f64>> {
    let (mut squares, mut products) = (Matrix3::zeros(), Vector3::zeros());
    for ((at, d), weight) in samples.iter().zip(weights) {
        squares += *weight * at * at.transpose();
        products += *weight * *d * at;
    }
    Some(squares.cholesky()?.solve(&products))
}

#[cfg(test)]
mod tests {
    use super::LocalGround;
    use crate::classical::dense::working::ClipData;

    const W: usize = 80;
    const H: usize = 60;

    #[test]
    fn objects_on_the_ground_and_beside_it_do_not_move_it() {
        let ground = |x: f32, y: f32| 0.2 + 0.001 * x + 0.01 * y;
        // a part, what was filled in behind it, and a static box beside it
        let part = |x: usize, y: usize| (30..50).contains(&x) && (20..40).contains(&y);
        let on = |p: usize| (p % W, p / W);
        let disparity = (0..W * H).map(|p| match on(p) {
            (x, y) if part(x, y) => 3.0,
            (x, y) if x > 52 && y < 40 => 0.9,
            (x, y) => ground(x as f32, y as f32),
        });
        let dynamic = (0..W * H).map(|p| 255 * u8::from(part(on(p).0, on(p).1)));
        let data = ClipData {
            size: (W, H),
            cameras: Vec::new(),
            dynamic: vec![dynamic.collect()],
            disparity: vec![disparity.collect()],
            flows: Vec::new(),
        };
        let pixels: Vec<u32> = (0..(W * H) as u32)
            .filter(|p| part(*p as usize % W, *p as usize / W))
            .collect();
        let plane = LocalGround::under(&data.clip(), 0, &pixels).unwrap();
        let off = (plane.at(40.0, 39.0) / f64::from(ground(40.0, 39.0))).ln();
        assert!(off.abs() < 0.005, "{off}");
    }
}
