//! The term that keeps surfaces facing the way they did.

use super::{DISPARITY, Problem, Term, clamp, within};
use crate::dba::Pinhole;
use m4_core::{Real, nalgebra::Vector3};

/// Of the Gaussian that smooths depth, pixels. MegaSaM: a 5x5 kernel of standard deviation 2.
const BLUR_SD_PX: f64 = 2.0;

/// The weights of the Gaussian.
pub(in crate::megasam::cvd) fn blur_weights() -> [f64; 5] {
    let raw = [-2.0f64, -1.0, 0.0, 1.0, 2.0].map(|x| (-x * x / (2.0 * BLUR_SD_PX * BLUR_SD_PX)).exp());
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
            let (dx, dy) = if along_x { (along, across) } else { (across, along) };
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
    let depth: Vec<T> = disparity.iter().map(|&d| T::one() / clamp(d, DISPARITY)).collect();
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
            taps.into_iter().fold(Vector3::zeros(), |s: Vector3<T>, (i, k)| s + points[i] * T::of(k))
        };
        (0..n).map(at).collect::<Vec<_>>()
    });
    let normals = (0..n).map(|p| along[0][p].cross(&along[1][p])).collect();
    Surface { rays, along, normals }
}

/// The taps of the Gaussian at a pixel.
fn blur_taps(width: usize, height: usize, p: usize) -> impl Iterator<Item = (usize, f64)> {
    let (x, y, weights) = ((p % width) as isize, (p / width) as isize, blur_weights());
    (0..25).map(move |k| {
        let (dx, dy) = (k % 5, k / 5);
        let index = reflect(y + dy as isize - 2, height) * width + reflect(x + dx as isize - 2, width);
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

/// Unit normals of one frame, `[height][width]`: cross products of the Sobel gradients of the smoothed depth's points.
#[must_use]
pub fn normals<T: Real>(width: usize, height: usize, lens: &Pinhole<T>, disparity: &[T]) -> Vec<Vector3<T>> {
    let normals = surface(width, height, lens, disparity).normals;
    normals.iter().map(|v| v / length(v)).collect()
}

/// `[height][width]`: the weight of the normal term, 0.2 at the edges of a disparity and 1.2 elsewhere. An edge is where
/// `exp(-10 g)` is at most 0.2, with g the length of the Sobel gradient (weights 1, 2, 1, not divided).
#[must_use]
pub fn edge_weight<T: Real>(width: usize, height: usize, disparity: &[T]) -> Vec<T> {
    let at = |p| {
        let slope = |along_x| {
            let taps = sobel(width, height, p, along_x);
            taps.into_iter().fold(T::zero(), |s, (i, k)| s + disparity[i] * T::of(8.0 * k))
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
    let (w, h, n) = (problem.width, problem.height, problem.width * problem.height);
    let count = T::of(disparity.len() as f64);
    let mut term = Term::zero(disparity.len());
    for frame in 0..problem.frames() {
        let range = frame * n..(frame + 1) * n;
        let disparity = &disparity[range.clone()];
        let wanted = normals(w, h, &problem.normal_lens, &problem.initial[range]);
        let found = surface(w, h, &problem.normal_lens, disparity);
        let mut points = vec![Vector3::zeros(); n];
        for p in 0..n {
            let weight = problem.edge_weight[frame * n + p] / count;
            let size = length(&found.normals[p]);
            let unit = found.normals[p] / size;
            let cosine = unit.dot(&wanted[p]);
            term.value += weight * (T::one() - cosine);
            // of the unit vector with respect to the vector; a vector that was too short has no length to lose
            let lost = if size > T::of(1e-12) { unit * cosine } else { Vector3::zeros() };
            let normal = (lost - wanted[p]) * (weight / size);
            let along = [found.along[1][p].cross(&normal), normal.cross(&found.along[0][p])];
            for (along, along_x) in along.iter().zip([true, false]) {
                for (i, k) in sobel(w, h, p, along_x) {
                    points[i] += along * T::of(k);
                }
            }
        }
        let mut depth = vec![T::zero(); n];
        for p in 0..n {
            let smooth = found.rays[p].dot(&points[p]);
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
