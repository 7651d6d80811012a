//! One patch followed from one image to another (Lucas and Kanade 1981; inverse compositional form
//! of Baker and Matthews 2004; pyramid of Bouguet 2001).

use super::luma::sample_square;
use m4_core::Plane;

/// Reach of the patch that is followed, working pixels: 5 for a side of 11.
/// docs/spec/front-end.md 7.1 has a side of 21; 11 gave trajectories as good or better, and is
/// faster (docs/decisions/0001).
pub(super) const RADIUS: usize = 5;
/// Gauss-Newton steps per level.
const ITERATIONS: usize = 12;

/// A square patch with its mean taken out, and what a step of alignment needs of it.
#[derive(Debug, Clone)]
pub(crate) struct Template {
    /// Values less their mean.
    values: Vec<f32>,
    gradient: Vec<[f32; 2]>,
    /// Inverse of the sum of gradient outer products.
    inverse: [f32; 3],
    /// Root of the sum of squared `values`.
    norm: f32,
}

impl Template {
    /// The patch around `p`; `None` when its structure tensor is singular, that is when it shows
    /// nothing to hold on to.
    pub fn new(plane: &Plane<f32>, p: [f32; 2]) -> Option<Self> {
        let (side, wide) = (2 * RADIUS + 1, 2 * RADIUS + 3);
        let reach = (RADIUS + 1) as f32;
        let mut patch = vec![0.0; wide * wide];
        sample_square(plane, p[0] - reach, p[1] - reach, wide, &mut patch);
        let mut values = Vec::with_capacity(side * side);
        let mut gradient = Vec::with_capacity(side * side);
        let mut h = [0.0_f32; 3];
        for y in 1..=side {
            for x in 1..=side {
                let i = y * wide + x;
                let g = [
                    0.5 * (patch[i + 1] - patch[i - 1]),
                    0.5 * (patch[i + wide] - patch[i - wide]),
                ];
                h = [h[0] + g[0] * g[0], h[1] + g[0] * g[1], h[2] + g[1] * g[1]];
                values.push(patch[i]);
                gradient.push(g);
            }
        }
        let norm = centre(&mut values);
        let determinant = h[0] * h[2] - h[1] * h[1];
        let trace = h[0] + h[2];
        // Lesser eigenvalue over greater one below about 1e-4: an edge or flat.
        if determinant <= 1e-4 * trace * trace || trace <= 1e-3 {
            return None;
        }
        let inverse = [h[2] / determinant, -h[1] / determinant, h[0] / determinant];
        Some(Self {
            values,
            gradient,
            inverse,
            norm,
        })
    }

    /// Moves `start` until the patch around it in `plane` looks like this template; the position
    /// and the normalised cross-correlation there.
    pub fn align(&self, plane: &Plane<f32>, start: [f32; 2]) -> ([f32; 2], f32) {
        let side = 2 * RADIUS + 1;
        let mut patch = vec![0.0; side * side];
        let mut p = start;
        let reach = RADIUS as f32;
        for _ in 0..ITERATIONS {
            sample_square(plane, p[0] - reach, p[1] - reach, side, &mut patch);
            let mean = patch.iter().sum::<f32>() / patch.len() as f32;
            let mut b = [0.0_f32; 2];
            for ((&value, &want), g) in patch.iter().zip(&self.values).zip(&self.gradient) {
                let error = value - mean - want;
                b = [b[0] + g[0] * error, b[1] + g[1] * error];
            }
            let step = [
                self.inverse[0] * b[0] + self.inverse[1] * b[1],
                self.inverse[1] * b[0] + self.inverse[2] * b[1],
            ];
            // A patch cannot see further than itself.
            let length = step[0].hypot(step[1]);
            let damp = if length > reach { reach / length } else { 1.0 };
            p = [p[0] - damp * step[0], p[1] - damp * step[1]];
            if length < 0.01 {
                break;
            }
        }
        sample_square(plane, p[0] - reach, p[1] - reach, side, &mut patch);
        let norm = centre(&mut patch);
        let dot: f32 = patch.iter().zip(&self.values).map(|(a, b)| a * b).sum();
        let correlation = if norm * self.norm > 0.0 {
            dot / (norm * self.norm)
        } else {
            0.0
        };
        (p, correlation)
    }
}

/// Partial sums, which the compiler keeps in one register.
const LANES: usize = 8;

/// Takes the mean out; the root of the sum of squares that is left.
pub(super) fn centre(values: &mut [f32]) -> f32 {
    let mean = sum(values) / values.len() as f32;
    values.iter_mut().for_each(|v| *v -= mean);
    dot(values, values).sqrt()
}

fn sum(values: &[f32]) -> f32 {
    let (chunks, rest) = values.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for chunk in chunks {
        for k in 0..LANES {
            sums[k] += chunk[k];
        }
    }
    sums.iter().sum::<f32>() + rest.iter().sum::<f32>()
}

/// Inner product.
pub(super) fn dot(a: &[f32], b: &[f32]) -> f32 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for (x, y) in a.iter().zip(b) {
        for k in 0..LANES {
            sums[k] += x[k] * y[k];
        }
    }
    sums.iter().sum::<f32>() + a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum::<f32>()
}

/// True when the patch around `p` lies in the image.
pub(crate) fn inside(plane: &Plane<f32>, p: [f32; 2]) -> bool {
    let r = RADIUS as f32;
    p[0] >= r
        && p[1] >= r
        && p[0] <= plane.width() as f32 - 1.0 - r
        && p[1] <= plane.height() as f32 - 1.0 - r
}

/// Follows the patch around `p` of the pyramid `from` into `to` (levels, finest first), coarse to
/// fine; the position and the correlation at the finest level. `None` when the patch shows nothing
/// at some level or leaves the image.
pub(crate) fn follow(
    from: &[Plane<f32>],
    to: &[Plane<f32>],
    p: [f32; 2],
) -> Option<([f32; 2], f32)> {
    let levels = from.len().min(to.len());
    let mut offset = [0.0_f32; 2];
    let mut correlation = 0.0;
    for level in (0..levels).rev() {
        let unit = 1.0 / (1_u32 << level) as f32;
        let at = [p[0] * unit, p[1] * unit];
        let template = match Template::new(&from[level], at) {
            Some(template) => template,
            // A coarse level may be flat; the finest must not be.
            None if level > 0 => {
                offset = [2.0 * offset[0], 2.0 * offset[1]];
                continue;
            }
            None => return None,
        };
        let (place, c) = template.align(&to[level], [at[0] + offset[0], at[1] + offset[1]]);
        correlation = c;
        offset = [place[0] - at[0], place[1] - at[1]];
        if level > 0 {
            offset = [2.0 * offset[0], 2.0 * offset[1]];
        }
    }
    let place = [p[0] + offset[0], p[1] + offset[1]];
    (place[0].is_finite() && place[1].is_finite() && inside(&to[0], place))
        .then_some((place, correlation))
}

#[cfg(test)]
mod tests {
    use super::{Template, follow};
    use crate::classical::sparse::luma::halvings;
    use m4_core::Plane;

    /// A smooth image, seen through `x -> (x - t) / s`, scaled and offset in brightness.
    fn pattern(shift: [f32; 2], stretch: f32, gain: f32) -> Vec<Plane<f32>> {
        let value = |x: f32, y: f32| {
            let wave = |a: f32, b: f32, c: f32| (a * x + b * y + c).sin();
            128.0
                + 30.0 * wave(0.31, 0.12, 0.3)
                + 25.0 * wave(-0.11, 0.27, 1.0)
                + 20.0 * wave(0.05, -0.07, 2.0)
        };
        let look = |x: usize, y: usize| {
            let (u, v) = ((x as f32 - 80.0) / stretch, (y as f32 - 60.0) / stretch);
            gain * value(u + 80.0 - shift[0], v + 60.0 - shift[1]) + 3.0
        };
        halvings(Plane::from_fn(160, 120, look))
    }

    #[test]
    fn a_shift_is_measured_to_a_fiftieth_of_a_pixel() {
        let (a, b) = (
            pattern([0.0, 0.0], 1.0, 1.0),
            pattern([6.3, -4.8], 1.0, 1.0),
        );
        let (p, likeness) = follow(&a, &b, [70.0, 60.0]).expect("texture");
        assert!(
            (p[0] - 76.3).abs() < 0.02 && (p[1] - 55.2).abs() < 0.02,
            "{p:?}"
        );
        assert!(likeness > 0.999);
    }

    #[test]
    fn a_change_of_scale_and_brightness_leaves_the_centre_in_place() {
        let (a, b) = (
            pattern([0.0, 0.0], 1.0, 1.0),
            pattern([2.0, 1.0], 1.03, 0.97),
        );
        let (p, _) = follow(&a, &b, [90.0, 50.0]).expect("texture");
        // u + 80 - 2 = 90 at x = 80 + 1.03 * 12, likewise y.
        let want = [80.0 + 1.03 * 12.0, 60.0 + 1.03 * -9.0];
        assert!(
            (p[0] - want[0]).abs() < 0.15 && (p[1] - want[1]).abs() < 0.15,
            "{p:?} {want:?}"
        );
    }

    #[test]
    fn edges_and_flat_patches_are_refused() {
        let edge = Plane::from_fn(64, 64, |x, _| if x < 32 { 0.0 } else { 200.0 });
        assert!(Template::new(&edge, [32.0, 32.0]).is_none());
        assert!(Template::new(&Plane::filled(64, 64, 9.0), [32.0, 32.0]).is_none());
        // Where the image went flat there is nothing that looks alike.
        let a = pattern([0.0, 0.0], 1.0, 1.0);
        let flat = halvings(Plane::filled(160, 120, 128.0));
        assert!(follow(&a, &flat, [80.0, 60.0]).is_none_or(|(_, c)| c < 0.5));
    }
}
