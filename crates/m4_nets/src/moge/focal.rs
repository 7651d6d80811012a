//! Focal length and depth offset of a point map (section 3.1 of the MoGe paper).
//!
//! The network's points are right up to an unknown offset `s` of their depth. With the focal length
//! `f` in units of half the image's diagonal, a point `(x, y, z)` seen at `(u, v)` (in the same
//! units, from the image's middle) has `f (x, y) / (z + s) = (u, v)`. For a given `s` the best `f`
//! is known in closed form, which leaves one unknown: the squared differences are minimised over
//! `s` by steps of Gauss and Newton within a trust region, from `s = 0` (Moré, "The
//! Levenberg-Marquardt algorithm: Implementation and theory", 1978, for one unknown). 64 x 64 of
//! the points are enough.
//!
//! The rules for the region are MINPACK's, and the search ends where a step gains less than a
//! thousandth, as upstream's does (SciPy's `least_squares` with `ftol=1e-3`). That is part of the
//! method: where an image says little about its focal length (a wall seen from the front) the sum
//! is flat, and the offset stays near the network's own depth instead of wandering off.

use crate::NetError;

/// Rows and columns of points that take part.
const SAMPLES: usize = 64;
/// Steps at most; some ten are usual.
const STEPS: usize = 100;
/// The search ends when a step lessens the sum by no more, and was expected to lessen it by no
/// more, relative to the sum.
const ENOUGH: f64 = 1e-3;
/// How far the first step may go, in the network's units.
const FIRST_REACH: f64 = 100.0;

/// Focal length in units of half the diagonal, and what is added to depths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FocalShift {
    pub focal: f64,
    pub shift: f64,
}

struct Sighting {
    xy: [f64; 2],
    z: f64,
    uv: [f64; 2],
}

/// The focal length and shift of the points `[height][width]` of an image for which `valid` holds;
/// with `known_focal`, the shift alone is estimated.
pub fn recovered(
    points: &[[f32; 3]],
    valid: impl Fn(usize) -> bool,
    (width, height): (usize, usize),
    known_focal: Option<f64>,
) -> Result<FocalShift, NetError> {
    let sightings = sightings(points, valid, (width, height));
    if sightings.len() < 2 {
        return Err(NetError::NoDepth(
            "the network finds no depth in this image: its mask is empty",
        ));
    }
    let problem = Problem {
        sightings: &sightings,
        known_focal,
    };
    let mut shift = 0.0;
    let mut here = problem.at(shift);
    let mut reach = f64::INFINITY;
    for _ in 0..STEPS {
        let newton = -here.slope / here.curvature;
        let whole = newton.abs() <= 1.1 * reach;
        let step = if whole {
            newton
        } else {
            reach.copysign(newton)
        };
        reach = if reach.is_finite() {
            reach
        } else {
            step.abs().min(FIRST_REACH)
        };
        let expected = -(2.0 * here.slope + here.curvature * step) * step / here.cost;
        // also where nothing is left to gain, or all is infinite
        if expected.is_nan() || expected <= f64::EPSILON {
            break;
        }
        let next = problem.at(shift + step);
        let gained = 1.0 - next.cost / here.cost;
        if gained > 1e-4 * expected {
            shift += step;
            here = next;
        }
        if gained.abs() <= ENOUGH && expected <= ENOUGH {
            break;
        }
        if gained <= 0.25 * expected {
            reach = 0.5 * reach.min(10.0 * step.abs());
        } else if whole || gained >= 0.75 * expected {
            reach = 2.0 * step.abs();
        }
    }
    let result = FocalShift {
        focal: here.focal,
        shift,
    };
    if result.focal.is_finite() && result.focal > 0.0 && here.cost.is_finite() {
        Ok(result)
    } else {
        Err(NetError::NoDepth(
            "no focal length explains the points that the network sees; giving the focal length may help",
        ))
    }
}

/// The middle points of a grid over the image, where they are valid and finite: the nearest to the
/// upper left of each cell, as PyTorch's nearest resize takes them.
fn sightings(
    points: &[[f32; 3]],
    valid: impl Fn(usize) -> bool,
    (width, height): (usize, usize),
) -> Vec<Sighting> {
    let diagonal = (width as f64).hypot(height as f64);
    let at = |i: usize, from: usize| i * from / SAMPLES;
    let mut sightings = Vec::with_capacity(SAMPLES * SAMPLES);
    for (row, column) in (0..SAMPLES * SAMPLES).map(|i| (i / SAMPLES, i % SAMPLES)) {
        let (x, y) = (at(column, width), at(row, height));
        let i = y * width + x;
        let Some(&point) = points.get(i) else {
            continue;
        };
        if !valid(i) || !point.iter().all(|p| p.is_finite()) {
            continue;
        }
        let [px, py, z] = point.map(f64::from);
        let from_middle = |x: usize, side: usize| (2.0 * x as f64 + 1.0 - side as f64) / diagonal;
        sightings.push(Sighting {
            xy: [px, py],
            z,
            uv: [from_middle(x, width), from_middle(y, height)],
        });
    }
    sightings
}

struct Problem<'a> {
    sightings: &'a [Sighting],
    known_focal: Option<f64>,
}

/// The sum of squares at an offset, half its first derivative, and half its second one without the
/// residuals' own curvature.
struct Cost {
    focal: f64,
    cost: f64,
    slope: f64,
    curvature: f64,
}

impl Problem<'_> {
    fn at(&self, shift: f64) -> Cost {
        // p = (x, y) / (z + s) and its derivative q = -p / (z + s)
        let projected = |s: &Sighting| {
            let depth = s.z + shift;
            let p = s.xy.map(|x| x / depth);
            (p, p.map(|p| -p / depth))
        };
        let dot = |a: [f64; 2], b: [f64; 2]| a[0] * b[0] + a[1] * b[1];
        let (mut pu, mut pp, mut qu, mut pq) = (0.0, 0.0, 0.0, 0.0);
        for s in self.sightings {
            let (p, q) = projected(s);
            pu += dot(p, s.uv);
            pp += dot(p, p);
            qu += dot(q, s.uv);
            pq += dot(p, q);
        }
        let (focal, focal_slope) = match self.known_focal {
            Some(focal) => (focal, 0.0),
            None => (pu / pp, qu / pp - 2.0 * pu * pq / (pp * pp)),
        };
        let (mut cost, mut slope, mut curvature) = (0.0, 0.0, 0.0);
        for s in self.sightings {
            let (p, q) = projected(s);
            let r = [0, 1].map(|i| focal * p[i] - s.uv[i]);
            let dr = [0, 1].map(|i| focal_slope * p[i] + focal * q[i]);
            cost += dot(r, r);
            slope += dot(r, dr);
            curvature += dot(dr, dr);
        }
        Cost {
            focal,
            cost,
            slope,
            curvature,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{FocalShift, NetError, recovered};
    use crate::fixture::Fixture;

    /// A noisy map whose focal length is 1.1 and whose depths lack 0.6; the reference stops at a
    /// relative change of 1e-3.
    #[test]
    fn agrees_with_the_reference_on_a_noisy_map() {
        let fixture = Fixture::open("moge2/focal_shift.safetensors");
        let (points, shape) = fixture.floats("points");
        let points = points.as_chunks::<3>().0;
        let mask = fixture.bytes("mask");
        let number = |name| f64::from(fixture.floats(name).0[0]);
        let size = (shape[1], shape[0]);
        let check = |known_focal, focal: f64, shift: f64| {
            let got = recovered(points, |i| mask[i] != 0, size, known_focal).unwrap();
            assert!(
                (got.focal / focal - 1.0).abs() < 1e-3,
                "{got:?}, focal {focal}"
            );
            assert!(
                (got.shift / shift - 1.0).abs() < 1e-3,
                "{got:?}, shift {shift}"
            );
            got
        };
        check(None, number("focal"), number("shift"));
        let known_focal = number("known_focal");
        let got = check(Some(known_focal), known_focal, number("shift_known_focal"));
        assert_eq!(got.focal, known_focal);
    }

    /// A plane that leans, of an image of 90 x 60 pixels.
    fn leaning(focal: f64, shift: f64) -> Vec<[f32; 3]> {
        let (w, h) = (90, 60);
        let diagonal = f64::hypot(90.0, 60.0);
        let point = |i: usize| {
            let (x, y) = ((i % w) as f64, (i / w) as f64);
            let (u, v) = (
                (2.0 * x + 1.0 - 90.0) / diagonal,
                (2.0 * y + 1.0 - 60.0) / diagonal,
            );
            let z = 2.0 + 0.02 * x + 0.01 * y * y / 60.0;
            [u * z / focal, v * z / focal, z - shift].map(|p| p as f32)
        };
        (0..w * h).map(point).collect()
    }

    #[test]
    fn exact_points_give_exact_numbers() {
        for (focal, shift) in [(0.7, -0.9), (1.6, 1.2), (3.0, 0.0)] {
            let points = leaning(focal, shift);
            let FocalShift { focal: f, shift: s } =
                recovered(&points, |_| true, (90, 60), None).unwrap();
            assert!(
                (f / focal - 1.0).abs() < 1e-4 && (s - shift).abs() < 1e-3,
                "{f}, {s} for {focal}, {shift}"
            );
            let actual = recovered(&points, |_| true, (90, 60), Some(focal)).unwrap();
            assert!(
                (actual.shift - shift).abs() < 1e-5,
                "{actual:?} for {shift}"
            );
        }
    }

    #[test]
    fn nan_points_are_ignored_and_too_few_are_an_error() {
        let mut points = leaning(1.2, 0.5);
        for i in (0..points.len()).step_by(7) {
            points[i] = [f32::NAN, 1.0, f32::INFINITY];
        }
        let actual = recovered(&points, |i| i % 5 != 0, (90, 60), None).unwrap();
        assert!(
            (actual.focal - 1.2).abs() < 1e-2 && (actual.shift - 0.5).abs() < 1e-2,
            "{actual:?}"
        );
        let none =
            |error| matches!(error, Err(NetError::NoDepth(why)) if why.contains("mask is empty"));
        assert!(none(recovered(&points, |_| false, (90, 60), None)));
        assert!(none(recovered(&points, |_| false, (90, 60), Some(1.0))));
        assert!(none(recovered(
            &[[f32::NAN; 3]; 5400],
            |_| true,
            (90, 60),
            None
        )));
        assert!(none(recovered(&[], |_| true, (0, 0), None)));
        // all on the axis, or behind one another: no focal length explains them
        for point in [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]] {
            let result = recovered(&vec![point; 5400], |_| true, (90, 60), None);
            assert!(
                matches!(result, Err(NetError::NoDepth(why)) if why.contains("no focal length")),
                "{result:?}"
            );
        }
        // points that are turned upside down
        let turned: Vec<[f32; 3]> = leaning(1.2, 0.0)
            .iter()
            .map(|&[x, y, z]| [-x, -y, z])
            .collect();
        assert!(matches!(
            recovered(&turned, |_| true, (90, 60), None),
            Err(NetError::NoDepth(_))
        ));
    }
}
