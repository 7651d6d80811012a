//! The two terms that tie frames together, and the one that keeps surfaces facing the way they did.

use super::{DISPARITY, Problem, Term, clamp, sign, within};
use crate::dba::Pinhole;
use m4_core::nalgebra::Vector3;
use m4_core::{Real, Se3};

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
    [
        tap(0, 0, (one - fx) * (one - fy)),
        tap(1, 0, fx * (one - fy)),
        tap(0, 1, (one - fx) * fy),
        tap(1, 1, fx * fy),
    ]
}

/// The ratio and the flow term: means over all pixels of all pairs that count and land in front of
/// the camera.
///
/// With `X = R K^-1 p / d_i(p) + t`, `d^ = 1 / X_z` and `d~ = d_j(q)` at `q = p + flow`: the ratio
/// term is `u (max(d~/d^, d^/d~) - 1) + 0.25 log(1/u)`, the flow term the same of each component of
/// `|K X / X_z - q|`. What is sampled outside the frame is 0, then 1e-3.
#[must_use]
pub fn pair_losses<T: Real>(
    problem: &Problem<T>,
    disparity: &[T],
    uncertainty: &[T],
) -> [Term<T>; 2] {
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
            let depth_gradient = if within(d, DISPARITY) {
                -depth * depth
            } else {
                T::zero()
            };
            let log_term = log_weight * (T::one() / u).ln();

            // where it lands
            let divisor = clamp(x.z, DIVISOR);
            let (qx, qy) = (px + pair.x[p], py + pair.y[p]);
            let image = [
                (lens.fx * x.x + lens.cx * x.z) / divisor,
                (lens.fy * x.y + lens.cy * x.z) / divisor,
            ];
            let slope = |focal: T, centre: T, turned_a: T, image_a: T| {
                let direct = (focal * turned_a + centre * turned.z) / divisor;
                let through_divisor = if within(x.z, DIVISOR) {
                    image_a * turned.z / divisor
                } else {
                    T::zero()
                };
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
            let raw = taps
                .iter()
                .flatten()
                .fold(T::zero(), |s, &(i, k)| s + k * target[i]);
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

/// Of the Gaussian that smooths depth, pixels. MegaSaM: a 5x5 kernel of standard deviation 2.
const BLUR_SD_PX: f64 = 2.0;

/// The weights of the Gaussian.
pub(in crate::megasam::cvd) fn blur_weights() -> [f64; 5] {
    let raw =
        [-2.0f64, -1.0, 0.0, 1.0, 2.0].map(|x| (-x * x / (2.0 * BLUR_SD_PX * BLUR_SD_PX)).exp());
    raw.map(|w| w / raw.iter().sum::<f64>())
}

/// Index `i` of a row of `n` reflected about its ends, which are not repeated.
pub(in crate::megasam::cvd) fn reflect(i: isize, n: usize) -> usize {
    let last = n as isize - 1;
    let i = i.abs();
    (if i > last { 2 * last - i } else { i }) as usize
}

/// Index `i` clamped to a row of `n`.
fn replicate(i: isize, n: usize) -> usize {
    i.clamp(0, n as isize - 1) as usize
}

/// The taps of a Sobel filter along x at a pixel: index and weight, in eighths.
fn sobel(width: usize, height: usize, p: usize, along_x: bool) -> [(usize, f64); 6] {
    let (x, y) = ((p % width) as isize, (p / width) as isize);
    let mut out = [(0, 0.0); 6];
    for k in 0..3 {
        for (side, out) in out[2 * k..2 * k + 2].iter_mut().enumerate() {
            let (across, along) = (k as isize - 1, 2 * side as isize - 1);
            let (dx, dy) = if along_x {
                (along, across)
            } else {
                (across, along)
            };
            let index = replicate(y + dy, height) * width + replicate(x + dx, width);
            *out = (index, along as f64 * [1.0, 2.0, 1.0][k] / 8.0);
        }
    }
    out
}

/// One frame: smoothed depth as points, and what their cross products are made of.
struct Surface<T: Real> {
    /// Length 1, `[height][width]`.
    rays: Vec<Vector3<T>>,
    along: [Vec<Vector3<T>>; 2],
    /// Not of length 1.
    normals: Vec<Vector3<T>>,
}

fn surface<T: Real>(width: usize, height: usize, lens: &Pinhole<T>, disparity: &[T]) -> Surface<T> {
    let n = width * height;
    let depth: Vec<T> = disparity
        .iter()
        .map(|&d| T::one() / clamp(d, DISPARITY))
        .collect();
    let smooth = blur(width, height, &depth);
    let ray = |p: usize| {
        let (x, y) = (T::of((p % width) as f64), T::of((p / width) as f64));
        Vector3::new((x - lens.cx) / lens.fx, (y - lens.cy) / lens.fy, T::one())
    };
    let rays: Vec<Vector3<T>> = (0..n).map(ray).collect();
    let points: Vec<Vector3<T>> = (0..n).map(|p| rays[p] * smooth[p]).collect();
    let along = [true, false].map(|along_x| {
        let at = |p| {
            let taps = sobel(width, height, p, along_x);
            taps.into_iter()
                .fold(Vector3::zeros(), |s: Vector3<T>, (i, k)| {
                    s + points[i] * T::of(k)
                })
        };
        (0..n).map(at).collect::<Vec<_>>()
    });
    let normals = (0..n).map(|p| along[0][p].cross(&along[1][p])).collect();
    Surface {
        rays,
        along,
        normals,
    }
}

/// The taps of the Gaussian at a pixel.
fn blur_taps(width: usize, height: usize, p: usize) -> impl Iterator<Item = (usize, f64)> {
    let (x, y, weights) = ((p % width) as isize, (p / width) as isize, blur_weights());
    (0..25).map(move |k| {
        let (dx, dy) = (k % 5, k / 5);
        let index =
            reflect(y + dy as isize - 2, height) * width + reflect(x + dx as isize - 2, width);
        (index, weights[dx] * weights[dy])
    })
}

fn blur<T: Real>(width: usize, height: usize, plane: &[T]) -> Vec<T> {
    let at = |p| blur_taps(width, height, p).fold(T::zero(), |s, (i, k)| s + plane[i] * T::of(k));
    (0..width * height).map(at).collect()
}

/// As PyTorch's `normalize`: a vector shorter than 1e-12 is divided by that.
fn length<T: Real>(v: &Vector3<T>) -> T {
    v.norm().max(T::of(1e-12))
}

/// Unit normals of one frame, `[height][width]`: cross products of the Sobel gradients of the
/// smoothed depth's points.
#[must_use]
pub fn normals<T: Real>(
    width: usize,
    height: usize,
    lens: &Pinhole<T>,
    disparity: &[T],
) -> Vec<Vector3<T>> {
    let normals = surface(width, height, lens, disparity).normals;
    normals.iter().map(|v| v / length(v)).collect()
}

/// `[height][width]`: the weight of the normal term, 0.2 at the edges of a disparity and 1.2
/// elsewhere. An edge is where `exp(-10 g)` is at most 0.2, with g the length of the Sobel gradient
/// (weights 1, 2, 1, not divided).
#[must_use]
pub fn edge_weight<T: Real>(width: usize, height: usize, disparity: &[T]) -> Vec<T> {
    let at = |p| {
        let slope = |along_x| {
            let taps = sobel(width, height, p, along_x);
            taps.into_iter()
                .fold(T::zero(), |s, (i, k)| s + disparity[i] * T::of(8.0 * k))
        };
        let (x, y): (T, T) = (slope(true), slope(false));
        let alpha = (-T::of(10.0) * (x * x + y * y).sqrt()).exp();
        T::of(if alpha > T::of(0.2) { 1.2 } else { 0.2 })
    };
    (0..width * height).map(at).collect()
}

/// `weight (1 - n(disparity) . n(initial))`, mean over all pixels.
#[must_use]
pub fn normal_loss<T: Real>(problem: &Problem<T>, disparity: &[T]) -> Term<T> {
    let (w, h, n) = (
        problem.width,
        problem.height,
        problem.width * problem.height,
    );
    let count = T::of(disparity.len() as f64);
    let mut term = Term::zero(disparity.len());
    for frame in 0..problem.frames() {
        let range = frame * n..(frame + 1) * n;
        let disparity = &disparity[range.clone()];
        let wanted = normals(w, h, &problem.normal_lens, &problem.initial[range]);
        let surface = surface(w, h, &problem.normal_lens, disparity);
        let mut points = vec![Vector3::zeros(); n];
        for p in 0..n {
            let weight = problem.edge_weight[frame * n + p] / count;
            let size = length(&surface.normals[p]);
            let unit = surface.normals[p] / size;
            let cosine = unit.dot(&wanted[p]);
            term.value += weight * (T::one() - cosine);
            // of the unit vector with respect to the vector; a vector that was too short has no
            // length to lose
            let lost = if size > T::of(1e-12) {
                unit * cosine
            } else {
                Vector3::zeros()
            };
            let normal = (lost - wanted[p]) * (weight / size);
            let along = [
                surface.along[1][p].cross(&normal),
                normal.cross(&surface.along[0][p]),
            ];
            for (along, along_x) in along.iter().zip([true, false]) {
                for (i, k) in sobel(w, h, p, along_x) {
                    points[i] += along * T::of(k);
                }
            }
        }
        let mut depth = vec![T::zero(); n];
        for p in 0..n {
            let smooth = surface.rays[p].dot(&points[p]);
            for (i, k) in blur_taps(w, h, p) {
                depth[i] += smooth * T::of(k);
            }
        }
        for p in 0..n {
            let d = disparity[p];
            if within(d, DISPARITY) {
                term.disparity[frame * n + p] = -depth[p] / (d * d);
            }
        }
    }
    term
}
