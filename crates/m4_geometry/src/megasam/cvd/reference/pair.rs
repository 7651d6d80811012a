//! The two terms that tie frames together.

use super::{DISPARITY, Problem, Term, clamp, sign, within};
use m4_core::{Real, Se3, nalgebra::Vector3};

/// Depths of the other frame that a disparity is made of. MegaSaM.
const DEPTH: [f64; 2] = [0.1, 1e3];
/// Divisors of the projection. MegaSaM.
const DIVISOR: [f64; 2] = [1e-3, 1e3];
/// Disparities that are compared. MegaSaM.
const COMPARED: [f64; 2] = [1e-3, 1e2];
/// Factor of `log(1/u)`. MegaSaM.
pub(in crate::megasam::cvd) const LOG_WEIGHT: f64 = 0.25;

/// A flow field between two frames, `[height][width]`.
#[derive(Debug, Clone)]
pub struct Pair<T> {
    /// The frame that the flow starts in.
    pub source: usize,
    /// The frame that it leads to.
    pub target: usize,
    /// To the right, pixels.
    pub x: Vec<T>,
    /// Downwards, pixels.
    pub y: Vec<T>,
    /// Whether a pixel counts.
    pub mask: Vec<bool>,
}

/// Bilinear weights of four pixels, by their index in the frame; pixels outside are left out.
fn taps<T: Real>(width: usize, height: usize, x: T, y: T) -> [Option<(usize, T)>; 4] {
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let tap = |dx: i64, dy: i64, weight: T| {
        let (x, y) = (x0.f64() as i64 + dx, y0.f64() as i64 + dy);
        let inside = x >= 0 && y >= 0 && x < width as i64 && y < height as i64;
        inside.then(|| (y as usize * width + x as usize, weight))
    };
    let one = T::one();
    [tap(0, 0, (one - fx) * (one - fy)), tap(1, 0, fx * (one - fy)), tap(0, 1, (one - fx) * fy), tap(1, 1, fx * fy)]
}

/// The ratio and the flow term: means over all pixels of all pairs that count and land in front of the camera.
///
/// With `X = R K^-1 p / d_i(p) + t`, `d^ = 1 / X_z` and `d~ = d_j(q)` at `q = p + flow`: the ratio term is
/// `u (max(d~/d^, d^/d~) - 1) + 0.25 log(1/u)`, the flow term the same of each component of `|K X / X_z - q|`.
/// What is sampled outside the frame is 0, then 1e-3.
#[must_use]
pub fn pair_losses<T: Real>(problem: &Problem<T>, disparity: &[T], uncertainty: &[T]) -> [Term<T>; 2] {
    let (w, h, lens) = (problem.width, problem.height, &problem.lens);
    let n = w * h;
    let [mut ratio, mut flow] = [Term::zero(disparity.len()), Term::zero(disparity.len())];
    let (half, log_weight) = (T::of(0.5), T::of(LOG_WEIGHT));
    let mut count = T::zero();
    for pair in &problem.pairs {
        let step = relative(&problem.w2c[pair.source], &problem.w2c[pair.target]);
        let target = &disparity[pair.target * n..(pair.target + 1) * n];
        for p in 0..n {
            let (px, py) = (T::of((p % w) as f64), T::of((p / w) as f64));
            let at = pair.source * n + p;
            let (d, u) = (disparity[at], uncertainty[at]);
            let depth = T::one() / clamp(d, DISPARITY);
            let ray = Vector3::new((px - lens.cx) / lens.fx, (py - lens.cy) / lens.fy, T::one());
            let turned = step.rotation * ray;
            let x = turned * depth + step.translation;
            if !pair.mask[p] || x.z <= T::of(DEPTH[0]) {
                continue;
            }
            count += T::one();
            let depth_gradient = if within(d, DISPARITY) { -depth * depth } else { T::zero() };
            let log_term = log_weight * (T::one() / u).ln();

            // where it lands
            let divisor = clamp(x.z, DIVISOR);
            let (qx, qy) = (px + pair.x[p], py + pair.y[p]);
            let image = [(lens.fx * x.x + lens.cx * x.z) / divisor, (lens.fy * x.y + lens.cy * x.z) / divisor];
            let slope = |focal: T, centre: T, turned_a: T, image_a: T| {
                let direct = (focal * turned_a + centre * turned.z) / divisor;
                let through_divisor = if within(x.z, DIVISOR) { image_a * turned.z / divisor } else { T::zero() };
                direct - through_divisor
            };
            let (ex, ey) = (image[0] - qx, image[1] - qy);
            let error = ex.abs() + ey.abs();
            flow.value += half * (error * u) + log_term;
            let moved = sign(ex) * slope(lens.fx, lens.cx, turned.x, image[0])
                + sign(ey) * slope(lens.fy, lens.cy, turned.y, image[1]);
            flow.disparity[at] += half * u * moved * depth_gradient;
            flow.uncertainty[at] += half * error - log_weight / u;

            // how deep it is there
            let seen_depth = clamp(x.z, DEPTH);
            let reprojected = clamp(T::one() / seen_depth, COMPARED);
            let taps = taps(w, h, qx, qy);
            let raw = taps.iter().flatten().fold(T::zero(), |s, &(i, k)| s + k * target[i]);
            let sampled = clamp(raw, COMPARED);
            let (up, down) = (sampled / reprojected, reprojected / sampled);
            let error = up.max(down) - T::one();
            ratio.value += error.abs() * u + log_term;
            ratio.uncertainty[at] += error.abs() - log_weight / u;
            // derivatives of the greater ratio; where both are 1 the error has none
            let (by_sampled, by_reprojected) = if error == T::zero() {
                (T::zero(), T::zero())
            } else if up > down {
                (T::one() / reprojected, -up / reprojected)
            } else {
                (-down / sampled, T::one() / sampled)
            };
            if within(x.z, DEPTH) && within(T::one() / seen_depth, COMPARED) {
                let by_depth = -by_reprojected / (seen_depth * seen_depth);
                ratio.disparity[at] += u * by_depth * turned.z * depth_gradient;
            }
            if within(raw, COMPARED) {
                for (i, k) in taps.into_iter().flatten() {
                    ratio.disparity[pair.target * n + i] += u * by_sampled * k;
                }
            }
        }
    }
    for term in [&mut ratio, &mut flow] {
        let scale = T::one() / (count + T::of(1e-8));
        term.value *= scale;
        for g in term.disparity.iter_mut().chain(&mut term.uncertainty) {
            *g *= scale;
        }
    }
    [ratio, flow]
}

/// From the camera of `source` to that of `target`, both `w2c`.
pub(in crate::megasam::cvd) fn relative<T: Real>(source: &Se3<T>, target: &Se3<T>) -> Se3<T> {
    target.compose(&source.inverse())
}
