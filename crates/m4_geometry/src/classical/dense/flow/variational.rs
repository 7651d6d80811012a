//! Variational refinement: robust equal brightness and equal gradients, robust smoothness
//! (Brox et al. 2004; normalised as in Zimmer et al. 2011; Kroeger et al. 2016, section 2.3).

use super::super::smooth::couplings;
use super::search::{Level, gradient};
use m4_core::{Flow, bilinear_cell};

/// Linearisations of the energy per level. Kroeger et al.: level + 1; 3 measured as good.
const REFINEMENTS: usize = 3;
/// Relaxation sweeps per linearisation. Kroeger et al.: 3 to 5.
const RELAXATIONS: usize = 5;
/// Weight of smoothness. As in OpenCV's implementation of the paper: 20.
const SMOOTHNESS: f32 = 20.0;
/// Weight of equal brightness. Kroeger et al.: 5.
const BRIGHTNESS: f32 = 5.0;
/// Weight of equal gradients. Kroeger et al.: 10.
const GRADIENT: f32 = 10.0;
/// Added to squared errors under the root: below it, errors count as noise.
const ROBUST: f32 = 1e-3;
/// Added to squared gradients in the normalisation: flat pixels count less.
const NORMALISE: f32 = 0.01;
/// Over-relaxation.
const OMEGA: f32 = 1.6;

/// A pixel of one linearisation, without smoothness: `[a11 a12; a12 a22] (du, dv) = (b1, b2)`.
struct Equations {
    a11: f32,
    a12: f32,
    a22: f32,
    b1: f32,
    b2: f32,
}

struct System {
    pixels: Vec<Equations>,
    /// Smoothness between a pixel and the next in its row.
    right: Vec<f32>,
    /// Smoothness between a pixel and the one below.
    below: Vec<f32>,
}

pub(super) fn refine(a: &Level, b: &Level, flow: &mut Flow) {
    let (w, h) = (a.width, a.height);
    let (mut du, mut dv) = (vec![0.0f32; w * h], vec![0.0f32; w * h]);
    for _ in 0..REFINEMENTS {
        let system = linearise(a, b, flow);
        du.fill(0.0);
        dv.fill(0.0);
        for _ in 0..RELAXATIONS {
            relax(&system, flow, &mut du, &mut dv);
        }
        for i in 0..w * h {
            flow.u[i] += du[i].clamp(-2.0, 2.0);
            flow.v[i] += dv[i].clamp(-2.0, 2.0);
        }
    }
}

/// `b` and its gradient as seen from `a` through the flow; `inside` is 0 where they left the image.
fn warp(b: &Level, flow: &Flow) -> ([Vec<f32>; 3], Vec<f32>) {
    let (w, h) = (flow.width, flow.height);
    let mut out = [vec![0.0; w * h], vec![0.0; w * h], vec![0.0; w * h]];
    let mut inside = vec![1.0; w * h];
    for y in 0..h {
        for x in 0..w {
            let i = y * w + x;
            let (qx, qy) = (x as f32 + flow.u[i], y as f32 + flow.v[i]);
            if !(qx >= 0.0 && qy >= 0.0 && qx <= (w - 1) as f32 && qy <= (h - 1) as f32) {
                inside[i] = 0.0;
            }
            let (c, fx, fy) = bilinear_cell(w, h, qx, qy);
            let (w00, w10, w01, w11) = ((1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy);
            for (out, p) in out.iter_mut().zip([&b.image, &b.dx, &b.dy]) {
                out[i] = w00 * p[c] + w10 * p[c + 1] + w01 * p[c + w] + w11 * p[c + w + 1];
            }
        }
    }
    (out, inside)
}

fn linearise(a: &Level, b: &Level, flow: &Flow) -> System {
    let (w, h) = (a.width, a.height);
    let ([image, dx, dy], inside) = warp(b, flow);
    let mean = |p: &[f32], q: &[f32]| -> Vec<f32> { p.iter().zip(q).map(|(p, q)| 0.5 * (p + q)).collect() };
    let (ix, iy) = (mean(&dx, &a.dx), mean(&dy, &a.dy));
    let ((ixx, ixy), (_, iyy)) = (gradient(w, h, &ix), gradient(w, h, &iy));
    let equations = |i: usize| {
        let it = image[i] - a.image[i];
        let (ixt, iyt) = (dx[i] - a.dx[i], dy[i] - a.dy[i]);
        // Each constraint is divided by its gradient, so that it measures a distance.
        let n0 = 1.0 / (ix[i] * ix[i] + iy[i] * iy[i] + NORMALISE);
        let n1 = 1.0 / (ixx[i] * ixx[i] + ixy[i] * ixy[i] + NORMALISE);
        let n2 = 1.0 / (ixy[i] * ixy[i] + iyy[i] * iyy[i] + NORMALISE);
        let brightness = inside[i] * BRIGHTNESS / (n0 * it * it + ROBUST * ROBUST).sqrt();
        let edges = inside[i] * GRADIENT / (n1 * ixt * ixt + n2 * iyt * iyt + ROBUST * ROBUST).sqrt();
        let (k0, k1, k2) = (brightness * n0, edges * n1, edges * n2);
        Equations {
            a11: k0 * ix[i] * ix[i] + k1 * ixx[i] * ixx[i] + k2 * ixy[i] * ixy[i],
            a12: k0 * ix[i] * iy[i] + k1 * ixx[i] * ixy[i] + k2 * ixy[i] * iyy[i],
            a22: k0 * iy[i] * iy[i] + k1 * ixy[i] * ixy[i] + k2 * iyy[i] * iyy[i],
            b1: -(k0 * ix[i] * it + k1 * ixx[i] * ixt + k2 * ixy[i] * iyt),
            b2: -(k0 * iy[i] * it + k1 * ixy[i] * ixt + k2 * iyy[i] * iyt),
        }
    };
    let (right, below) = smoothness(flow);
    System { pixels: (0..w * h).map(equations).collect(), right, below }
}

/// [`SMOOTHNESS`] over `sqrt(|grad u|^2 + |grad v|^2 + e^2)`, averaged onto the edges between pixels; 0 at the rim.
fn smoothness(flow: &Flow) -> (Vec<f32>, Vec<f32>) {
    let (w, h) = (flow.width, flow.height);
    let ((ux, uy), (vx, vy)) = (gradient(w, h, &flow.u), gradient(w, h, &flow.v));
    let psi: Vec<f32> = (0..w * h)
        .map(|i| {
            0.5 * SMOOTHNESS / (ux[i] * ux[i] + uy[i] * uy[i] + vx[i] * vx[i] + vy[i] * vy[i] + ROBUST * ROBUST).sqrt()
        })
        .collect();
    couplings(w, h, |i, j| psi[i] + psi[j])
}

/// One red-black sweep of successive over-relaxation.
fn relax(s: &System, flow: &Flow, du: &mut [f32], dv: &mut [f32]) {
    let (w, h) = (flow.width, flow.height);
    for colour in 0..2 {
        for y in 0..h {
            for x in ((y + colour) % 2..w).step_by(2) {
                let i = y * w + x;
                let (mut sum, mut pull_u, mut pull_v) = (0.0f32, 0.0f32, 0.0f32);
                let mut add = |weight: f32, j: usize| {
                    sum += weight;
                    pull_u += weight * (flow.u[j] + du[j]);
                    pull_v += weight * (flow.v[j] + dv[j]);
                };
                if x > 0 {
                    add(s.right[i - 1], i - 1);
                }
                if x + 1 < w {
                    add(s.right[i], i + 1);
                }
                if y > 0 {
                    add(s.below[i - w], i - w);
                }
                if y + 1 < h {
                    add(s.below[i], i + w);
                }
                let e = &s.pixels[i];
                let b1 = e.b1 + pull_u - sum * flow.u[i];
                let b2 = e.b2 + pull_v - sum * flow.v[i];
                // The 2x2 block is solved at once.
                let (a11, a12, a22) = (e.a11 + sum, e.a12, e.a22 + sum);
                let inverse = 1.0 / (a11 * a22 - a12 * a12).max(1e-12);
                let (nu, nv) = ((a22 * b1 - a12 * b2) * inverse, (a11 * b2 - a12 * b1) * inverse);
                du[i] += OMEGA * (nu - du[i]);
                dv[i] += OMEGA * (nv - dv[i]);
            }
        }
    }
}
