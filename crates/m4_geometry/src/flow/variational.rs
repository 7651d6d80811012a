//! Variational refinement: robust equal brightness and equal gradients, robust smoothness
//! (Brox et al. 2004; normalised as in Zimmer et al. 2011; Kroeger et al. 2016, section 2.3).

use super::search::{Level, gradient};
use crate::smooth::couplings;
use m4_core::{Flow, bilinear_cell};
use std::iter;

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

/// Numbers that are worked out side by side.
const LANES: usize = 16;

/// Calls a method for every number below `$count`, [`LANES`] at once, then one at a time; the call
/// takes how many as its constant.
macro_rules! in_lanes {
    ($count:expr, $i:ident => $object:ident.$method:ident($($argument:expr),*)) => {{
        let (count, mut $i) = ($count, 0);
        while $i + LANES <= count {
            $object.$method::<LANES>($($argument),*);
            $i += LANES;
        }
        while $i < count {
            $object.$method::<1>($($argument),*);
            $i += 1;
        }
    }};
}

#[inline(always)]
fn load<const N: usize>(plane: &[f32], from: usize) -> [f32; N] {
    *plane[from..]
        .first_chunk()
        .expect("the plane has that many")
}

#[inline(always)]
fn store<const N: usize>(plane: &mut [f32], from: usize, values: [f32; N]) {
    *plane[from..]
        .first_chunk_mut()
        .expect("the plane has that many") = values;
}

/// One linearisation of the energy, as what each pixel goes to given those around it:
/// `goal + response pull`, where `pull` is the sum over its four neighbours of their flow times its
/// coupling to them. All planes are `[height][width]`.
struct System {
    /// Along x and y.
    goal: [Vec<f32>; 2],
    /// `[r11 r12; r12 r22]`.
    response: [Vec<f32>; 3],
    /// Smoothness between a pixel and the one before it in its row, and one more 0 at the end; 0 at
    /// the rim.
    before: Vec<f32>,
    /// Smoothness between a pixel and the one above, and one more row of 0; 0 at the rim.
    above: Vec<f32>,
}

#[inline(always)]
pub(super) fn refine(a: &Level, b: &Level, flow: &mut Flow) {
    let (w, h) = (a.width, a.height);
    // a row more above and below
    let mut relaxed = [vec![0.0f32; w * (h + 2)], vec![0.0f32; w * (h + 2)]];
    for _ in 0..REFINEMENTS {
        let system = linearise(a, b, flow);
        let Flow { u, v, .. } = flow;
        for (relaxed, flow) in relaxed.iter_mut().zip([&*u, &*v]) {
            relaxed[w..w * (h + 1)].copy_from_slice(flow);
        }
        for _ in 0..RELAXATIONS {
            relax(&system, (w, h), &mut relaxed);
        }
        for (relaxed, flow) in relaxed.iter().zip([u, v]) {
            flow.iter_mut()
                .zip(&relaxed[w..])
                .for_each(|(flow, to)| *flow += (to - *flow).clamp(-2.0, 2.0));
        }
    }
}

/// `b` and its gradient as seen from `a` through the flow; `inside` is 0 where they left the image.
#[inline(always)]
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
            let (w00, w10, w01, w11) = (
                (1.0 - fx) * (1.0 - fy),
                fx * (1.0 - fy),
                (1.0 - fx) * fy,
                fx * fy,
            );
            for (out, p) in out.iter_mut().zip([&b.image, &b.dx, &b.dy]) {
                out[i] = w00 * p[c] + w10 * p[c + 1] + w01 * p[c + w] + w11 * p[c + w + 1];
            }
        }
    }
    (out, inside)
}

#[inline(always)]
fn linearise(a: &Level, b: &Level, flow: &Flow) -> System {
    let (w, h) = (a.width, a.height);
    let ([image, dx, dy], inside) = warp(b, flow);
    let mean = |p: &[f32], q: &[f32]| -> Vec<f32> {
        p.iter().zip(q).map(|(p, q)| 0.5 * (p + q)).collect()
    };
    let (ix, iy) = (mean(&dx, &a.dx), mean(&dy, &a.dy));
    let ((ixx, ixy), (_, iyy)) = (gradient(w, h, &ix), gradient(w, h, &iy));
    let (right, below) = smoothness(flow);
    let before: Vec<f32> = iter::once(0.0).chain(right).collect();
    let above: Vec<f32> = iter::repeat_n(0.0, w).chain(below).collect();
    let plane = || vec![0.0f32; w * h];
    let mut system = System {
        goal: [plane(), plane()],
        response: [plane(), plane(), plane()],
        before,
        above,
    };
    let samples = Seen {
        image,
        dx,
        dy,
        ix,
        iy,
        ixx,
        ixy,
        iyy,
        inside,
    };
    in_lanes!(w * h, i => system.set(a, &samples, flow, i));
    system
}

/// What a linearisation is made of: the warped image with its gradient, the mean gradient of both
/// images with its own, and 0 outside.
struct Seen {
    image: Vec<f32>,
    dx: Vec<f32>,
    dy: Vec<f32>,
    ix: Vec<f32>,
    iy: Vec<f32>,
    ixx: Vec<f32>,
    ixy: Vec<f32>,
    iyy: Vec<f32>,
    inside: Vec<f32>,
}

impl System {
    /// Sets `N` pixels from `i` on.
    #[inline(always)]
    fn set<const N: usize>(&mut self, a: &Level, samples: &Seen, flow: &Flow, i: usize) {
        let at = |plane: &[f32]| load::<N>(plane, i);
        let [image, dx, dy, inside] =
            [&samples.image, &samples.dx, &samples.dy, &samples.inside].map(|plane| at(plane));
        let [ix, iy, ixx, ixy, iyy] = [
            &samples.ix,
            &samples.iy,
            &samples.ixx,
            &samples.ixy,
            &samples.iyy,
        ]
        .map(|plane| at(plane));
        let [a_image, a_dx, a_dy, u, v] =
            [&a.image, &a.dx, &a.dy, &flow.u, &flow.v].map(|plane| at(plane));
        let [left, right] = [i, i + 1].map(|i| load::<N>(&self.before, i));
        let [above, below] = [i, i + flow.width].map(|i| load::<N>(&self.above, i));
        let mut out = [[0.0f32; N]; 5];
        for k in 0..N {
            let it = image[k] - a_image[k];
            let (ixt, iyt) = (dx[k] - a_dx[k], dy[k] - a_dy[k]);
            // Each constraint is divided by its gradient, so that it measures a distance.
            let n0 = 1.0 / (ix[k] * ix[k] + iy[k] * iy[k] + NORMALISE);
            let n1 = 1.0 / (ixx[k] * ixx[k] + ixy[k] * ixy[k] + NORMALISE);
            let n2 = 1.0 / (ixy[k] * ixy[k] + iyy[k] * iyy[k] + NORMALISE);
            let brightness = inside[k] * BRIGHTNESS / (n0 * it * it + ROBUST * ROBUST).sqrt();
            let edges =
                inside[k] * GRADIENT / (n1 * ixt * ixt + n2 * iyt * iyt + ROBUST * ROBUST).sqrt();
            let (k0, k1, k2) = (brightness * n0, edges * n1, edges * n2);
            // [a11 a12; a12 a22] (du, dv) = (b1, b2), with the smoothness on the left
            let coupled = left[k] + right[k] + above[k] + below[k];
            let a11 = k0 * ix[k] * ix[k] + k1 * ixx[k] * ixx[k] + k2 * ixy[k] * ixy[k] + coupled;
            let a12 = k0 * ix[k] * iy[k] + k1 * ixx[k] * ixy[k] + k2 * ixy[k] * iyy[k];
            let a22 = k0 * iy[k] * iy[k] + k1 * ixy[k] * ixy[k] + k2 * iyy[k] * iyy[k] + coupled;
            let b1 = -(k0 * ix[k] * it + k1 * ixx[k] * ixt + k2 * ixy[k] * iyt) - coupled * u[k];
            let b2 = -(k0 * iy[k] * it + k1 * ixy[k] * ixt + k2 * iyy[k] * iyt) - coupled * v[k];
            let determinant = a11 * a22 - a12 * a12;
            let inverse = 1.0
                / if determinant > 1e-12 {
                    determinant
                } else {
                    1e-12
                };
            let [r11, r12, r22] = [a22 * inverse, -a12 * inverse, a11 * inverse];
            out[0][k] = r11;
            out[1][k] = r12;
            out[2][k] = r22;
            out[3][k] = u[k] + r11 * b1 + r12 * b2;
            out[4][k] = v[k] + r12 * b1 + r22 * b2;
        }
        for (plane, out) in self.response.iter_mut().chain(&mut self.goal).zip(out) {
            store(plane, i, out);
        }
    }

    /// Relaxes those of `N` pixels from `i` on whose turn it is: the first, or not `even`, the
    /// second, and every second from there. `flow` has a row more above and below.
    ///
    /// All are worked out and half of them kept: pixels of one colour do not see each other, and
    /// what has no branches and no strides runs on vector instructions.
    #[inline(always)]
    fn relax<const N: usize>(&self, width: usize, flow: &mut [Vec<f32>; 2], i: usize, even: bool) {
        let here = i + width;
        let coupling: [[f32; N]; 4] = [
            load(&self.before, i),
            load(&self.before, i + 1),
            load(&self.above, i),
            load(&self.above, here),
        ];
        let pull = |flow: &[f32]| -> [f32; N] {
            let [left, right, above, below]: [[f32; N]; 4] =
                [here - 1, here + 1, i, here + width].map(|from| load(flow, from));
            let mut sum = [0.0; N];
            for k in 0..N {
                let (beside, over) = (
                    coupling[0][k] * left[k] + coupling[1][k] * right[k],
                    coupling[2][k] * above[k] + coupling[3][k] * below[k],
                );
                sum[k] = beside + over;
            }
            sum
        };
        let (pull_u, pull_v) = (pull(&flow[0]), pull(&flow[1]));
        let [r11, r12, r22]: [[f32; N]; 3] = self.response.each_ref().map(|plane| load(plane, i));
        let [goal_u, goal_v]: [[f32; N]; 2] = self.goal.each_ref().map(|plane| load(plane, i));
        let [mut u, mut v]: [[f32; N]; 2] = flow.each_ref().map(|plane| load(plane, here));
        for k in 0..N {
            let relaxed = |from: f32, to: f32| {
                if (k % 2 == 0) == even {
                    from + OMEGA * (to - from)
                } else {
                    from
                }
            };
            u[k] = relaxed(u[k], goal_u[k] + r11[k] * pull_u[k] + r12[k] * pull_v[k]);
            v[k] = relaxed(v[k], goal_v[k] + r12[k] * pull_u[k] + r22[k] * pull_v[k]);
        }
        store(&mut flow[0], here, u);
        store(&mut flow[1], here, v);
    }
}

/// [`SMOOTHNESS`] over `sqrt(|grad u|^2 + |grad v|^2 + e^2)`, averaged onto the edges between
/// pixels; 0 at the rim.
#[inline(always)]
fn smoothness(flow: &Flow) -> (Vec<f32>, Vec<f32>) {
    let (w, h) = (flow.width, flow.height);
    let ((ux, uy), (vx, vy)) = (gradient(w, h, &flow.u), gradient(w, h, &flow.v));
    let psi: Vec<f32> = (0..w * h)
        .map(|i| {
            0.5 * SMOOTHNESS
                / (ux[i] * ux[i] + uy[i] * uy[i] + vx[i] * vx[i] + vy[i] * vy[i] + ROBUST * ROBUST)
                    .sqrt()
        })
        .collect();
    couplings(w, h, |i, j| psi[i] + psi[j])
}

/// One red-black sweep of successive over-relaxation of `flow`, which has a row more above and
/// below.
#[inline(always)]
fn relax(system: &System, (w, h): (usize, usize), flow: &mut [Vec<f32>; 2]) {
    for colour in 0..2 {
        for y in 0..h {
            let even = |x: usize| (x + y + colour).is_multiple_of(2);
            in_lanes!(w, x => system.relax(w, flow, y * w + x, even(x)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::search::pyramid;
    use super::{LANES, System, linearise, relax};
    use m4_core::Flow;

    /// A row is two blocks of lanes and five pixels.
    const W: usize = 2 * LANES + 5;
    const H: usize = 30;

    #[test]
    fn pixels_side_by_side_relax_as_one_at_a_time() {
        let image = |shift: f32| -> Vec<f32> {
            let at = |i: usize| ((i % W) as f32 - shift, (i / W) as f32);
            (0..W * H)
                .map(at)
                .map(|(x, y)| {
                    128.0 + 50.0 * (0.5 * x + 0.2 * y).sin() + 30.0 * (0.3 * y - 0.1 * x).cos()
                })
                .collect()
        };
        let (a, b) = (pyramid(W, H, &image(0.0)), pyramid(W, H, &image(0.7)));
        let system = linearise(&a[0], &b[0], &Flow::zero(W, H));
        let start = || [vec![0.0f32; W * (H + 2)], vec![0.0f32; W * (H + 2)]];
        let (mut lanes, mut single) = (start(), start());
        let one = |system: &System, flow: &mut [Vec<f32>; 2], colour: usize| {
            for i in 0..W * H {
                system.relax::<1>(W, flow, i, (i % W + i / W + colour).is_multiple_of(2));
            }
        };
        for _ in 0..4 {
            relax(&system, (W, H), &mut lanes);
            (0..2).for_each(|colour| one(&system, &mut single, colour));
        }
        assert!(lanes == single, "the order of lanes matters");
        assert!(lanes[0].iter().any(|u| u.abs() > 1e-3), "nothing moved");
    }
}
