//! The version of the product: bound splats to columns of their own, in parallel over rows.

use super::{FADE, LEAST_PRESENCE};
use crate::{Gradients, NodeGradients};
use m4_core::{Binding, Column, Splats, Window, nalgebra::Vector4, quat};
use rayon::prelude::*;

/// Rows of a task.
const ROWS: usize = 1024;
/// Logit of the opacity of a splat that is left out.
const NOWHERE: f32 = -60.0;

/// The motion of a node since it has not moved.
#[derive(Debug, Clone, Copy)]
struct Motion {
    quat: [f32; 4],
    matrix: [[f32; 3]; 3],
    shift: [f32; 3],
}

/// What carries a splat.
#[derive(Debug, Clone, Copy, Default)]
struct Carrier {
    matrix: [[f32; 3]; 3],
    quat: [f32; 4],
    /// Derivative of the carried logit of the opacity with respect to the own one; 0 where the splat is left out.
    fade: f32,
}

/// Bound splats where they are at an instant.
#[derive(Debug, Default)]
pub(crate) struct Posed {
    t: f32,
    /// Static and bound rows; static ones are anything.
    pub(crate) mean: [Vec<f32>; 3],
    pub(crate) quat: [Vec<f32>; 4],
    pub(crate) opacity: Vec<f32>,
    /// `3 * term + channel`; empty without bound splats.
    pub(crate) colour: Vec<Vec<f32>>,
    /// One per bound splat.
    carriers: Vec<Carrier>,
    /// Of the nodes of each window; none of windows that are far in time.
    motions: Vec<Vec<Motion>>,
}

impl Posed {
    /// True where bound splat `i` is drawn.
    pub(super) fn is_drawn(&self, i: usize) -> bool {
        self.carriers[i].fade != 0.0
    }

    /// Carries the bound splats to `t`, frames.
    pub(crate) fn pose(&mut self, splats: &Splats, t: f32) {
        let (bound, windows, layout) = (splats.bound(), splats.windows(), splats.layout());
        self.t = t;
        self.motions.clear();
        self.colour.resize_with(if bound.is_empty() { 0 } else { 3 * layout.colour_terms() }, Vec::new);
        self.carriers.resize(bound.len(), Carrier::default());
        if bound.is_empty() {
            return;
        }
        self.motions.par_extend(windows.par_iter().map(|window| motions(window, t)));
        for (term, column) in self.colour.iter_mut().enumerate().skip(3) {
            column.clone_from_slice_of(&splats.column(Column::Colour, term)[..bound.end]);
        }
        let columns = self.mean.iter_mut().chain(&mut self.quat).chain([&mut self.opacity]).chain(&mut self.colour[..3]);
        let mut columns: Vec<_> = columns
            .map(|column| {
                column.resize(bound.end, 0.0);
                column[bound.start..].chunks_mut(ROWS)
            })
            .collect();
        let mut tasks = Vec::new();
        for (k, carriers) in self.carriers.chunks_mut(ROWS).enumerate() {
            let out: Vec<&mut [f32]> = columns.iter_mut().filter_map(Iterator::next).collect();
            tasks.push((k * ROWS, carriers, out));
        }
        let motions = &self.motions;
        tasks.into_par_iter().for_each(|(first, carriers, mut out)| {
            for (i, carrier) in carriers.iter_mut().enumerate() {
                let binding = &splats.bindings()[first + i];
                let window = binding.window as usize;
                *carrier = Carrier::default();
                let presence = presence(t, binding.life, FADE * windows[window].gap());
                if presence < LEAST_PRESENCE || motions[window].is_empty() {
                    out[7][i] = NOWHERE;
                    continue;
                }
                *carrier = one(splats, binding, first + i, t, presence, &motions[window], |column, v| out[column][i] = v);
            }
        });
    }

    /// Turns gradients with respect to what is drawn of bound splats into those with respect to the splats and to nodes.
    pub(crate) fn backward(&self, splats: &Splats, out: &mut Gradients) {
        out.nodes.clear();
        if splats.bound().is_empty() {
            return;
        }
        for (window, nodes) in splats.windows().iter().enumerate() {
            if let Some(key) = nodes.key_at(self.t) {
                out.nodes.push(self.nodes(splats, out, window, key));
            }
        }
        let (layout, t) = (splats.layout(), self.t);
        let first = |column| layout.column(column);
        let columns = &mut out.columns;
        for (i, (row, carrier)) in splats.bound().zip(&self.carriers).enumerate() {
            if out.touched[row] == 0 {
                continue;
            }
            let dt = t - splats.column(Column::TimeMean, 0)[i];
            let g: [f32; 3] = std::array::from_fn(|k| columns[first(Column::Mean) + k][row]);
            for c in 0..3 {
                let own = (0..3).map(|r| carrier.matrix[r][c] * g[r]).sum();
                columns[first(Column::Mean) + c][row] = own;
                columns[first(Column::Velocity) + c][i] = own * dt;
                columns[first(Column::Trend) + c][i] = columns[first(Column::Colour) + c][row] * dt;
            }
            if !layout.isotropic {
                let g: [f32; 4] = std::array::from_fn(|k| columns[first(Column::Quat) + k][row]);
                let own = product(&conjugate(&carrier.quat), &g);
                (0..4).for_each(|k| columns[first(Column::Quat) + k][row] = own[k]);
            }
            columns[first(Column::Opacity)][row] *= carrier.fade;
            columns[first(Column::TimeMean)][i] = 0.0;
            columns[first(Column::LogTimeSd)][i] = 0.0;
        }
    }

    /// The gradients of the nodes of a window, from those of what is drawn: added in the order of the rows.
    fn nodes(&self, splats: &Splats, out: &Gradients, window: usize, key: usize) -> NodeGradients {
        let (layout, motions) = (splats.layout(), &self.motions[window]);
        let anchors = splats.windows()[window].anchors();
        let mut sums = vec![[0.0f32; 6]; anchors.len()];
        for (i, (row, binding)) in splats.bound().zip(splats.bindings()).enumerate() {
            if out.touched[row] == 0 || self.carriers[i].fade == 0.0 || binding.window as usize != window {
                continue;
            }
            let get = |column, k: usize| splats.column(column, k);
            let g: [f32; 3] = std::array::from_fn(|k| out.columns[layout.column(Column::Mean) + k][row]);
            let dt = self.t - get(Column::TimeMean, 0)[i];
            let own: [f32; 3] =
                std::array::from_fn(|k| get(Column::Mean, k)[row] + get(Column::Velocity, k)[i] * dt);
            let turn = match layout.isotropic {
                true => [0.0; 4],
                false => {
                    let g: [f32; 4] = std::array::from_fn(|k| out.columns[layout.column(Column::Quat) + k][row]);
                    let own: [f32; 4] = std::array::from_fn(|k| get(Column::Quat, k)[row]);
                    product(&g, &conjugate(&own))
                }
            };
            let first = &motions[usize::from(binding.nodes[0])];
            for (&node, &weight) in binding.nodes.iter().zip(&binding.weights) {
                let node = usize::from(node);
                let motion = &motions[node];
                let from: [f32; 3] = std::array::from_fn(|k| own[k] - anchors[node][k]);
                let arm: [f32; 3] = std::array::from_fn(|r| (0..3).map(|c| motion.matrix[r][c] * from[c]).sum());
                let turn = product(&turn, &conjugate(&motion.quat));
                let half = 0.5 * side(first, motion);
                let sum = &mut sums[node];
                for k in 0..3 {
                    let (a, b) = ((k + 1) % 3, (k + 2) % 3);
                    sum[k] += weight * g[k];
                    sum[3 + k] += weight * (arm[a] * g[b] - arm[b] * g[a] + half * turn[1 + k]);
                }
            }
        }
        NodeGradients { window, key, nodes: sums }
    }
}

/// Copies into memory that is there.
trait CloneFromSlice {
    fn clone_from_slice_of(&mut self, slice: &[f32]);
}

impl CloneFromSlice for Vec<f32> {
    fn clone_from_slice_of(&mut self, slice: &[f32]) {
        self.clear();
        self.extend_from_slice(slice);
    }
}

/// When splats of a window are drawn, frames: a life ends half a gap beyond the last key, and a fade after it.
pub(super) fn drawn(window: &Window) -> [f32; 2] {
    let (keys, reach) = (window.keys(), (0.5 + FADE) * 2.0 * window.gap());
    if keys.len() > 1 { [keys[0] - reach, keys[keys.len() - 1] + reach] } else { [f32::NEG_INFINITY, f32::INFINITY] }
}

/// None where no splat of the window is drawn.
fn motions(window: &Window, t: f32) -> Vec<Motion> {
    let [begin, end] = drawn(window);
    if t < begin || t > end {
        return Vec::new();
    }
    let one = |node: usize| {
        let (pose, anchor) = (window.pose(node, t), window.anchors()[node]);
        let rotation = quat::rotation(&Vector4::from(pose.rotation));
        let matrix: [[f32; 3]; 3] = std::array::from_fn(|r| std::array::from_fn(|c| rotation[(r, c)]));
        let shift = std::array::from_fn(|r| {
            pose.position[r] - (matrix[r][0] * anchor[0] + matrix[r][1] * anchor[1] + matrix[r][2] * anchor[2])
        });
        Motion { quat: pose.rotation, matrix, shift }
    };
    (0..window.anchors().len()).map(one).collect()
}

/// Carries bound splat `i`; hands over means, quaternions, logit and colours as columns 0 to 10.
#[inline(always)]
fn one(
    splats: &Splats,
    binding: &Binding,
    i: usize,
    t: f32,
    presence: f32,
    motions: &[Motion],
    mut out: impl FnMut(usize, f32),
) -> Carrier {
    let row = splats.n_static() + i;
    let (mut matrix, mut shift, mut quat) = ([[0.0f32; 3]; 3], [0.0f32; 3], [0.0f32; 4]);
    let first = &motions[usize::from(binding.nodes[0])];
    for (&node, &weight) in binding.nodes.iter().zip(&binding.weights) {
        let motion = &motions[usize::from(node)];
        for r in 0..3 {
            (0..3).for_each(|c| matrix[r][c] += weight * motion.matrix[r][c]);
            shift[r] += weight * motion.shift[r];
        }
        let weight = weight * side(first, motion);
        (0..4).for_each(|k| quat[k] += weight * motion.quat[k]);
    }
    let dt = t - splats.column(Column::TimeMean, 0)[i];
    let own: [f32; 3] = std::array::from_fn(|k| {
        splats.column(Column::Mean, k)[row] + splats.column(Column::Velocity, k)[i] * dt
    });
    for r in 0..3 {
        out(r, matrix[r][0] * own[0] + matrix[r][1] * own[1] + matrix[r][2] * own[2] + shift[r]);
    }
    if !splats.layout().isotropic {
        let own: [f32; 4] = std::array::from_fn(|k| splats.column(Column::Quat, k)[row]);
        let carried = product(&quat, &own);
        (0..4).for_each(|k| out(3 + k, carried[k]));
    }
    let (logit, fade) = faded(splats.column(Column::Opacity, 0)[row], presence);
    out(7, logit);
    for k in 0..3 {
        out(8 + k, splats.column(Column::Colour, k)[row] + splats.column(Column::Trend, k)[i] * dt);
    }
    Carrier { matrix, quat, fade }
}

fn presence(t: f32, [begin, end]: [f32; 2], half: f32) -> f32 {
    let step = |x: f32| {
        let s = (0.5 + 0.5 * x).clamp(0.0, 1.0);
        s * s * (3.0 - 2.0 * s)
    };
    step((t - begin) / half) * step((end - t) / half)
}

/// See the reference.
fn faded(logit: f32, f: f32) -> (f32, f32) {
    if f >= 1.0 {
        return (logit, 1.0);
    }
    let depth = f * if logit > 0.0 { logit + (-logit).exp().ln_1p() } else { logit.exp().ln_1p() };
    let opacity = (-(-depth).exp_m1()).max(f32::MIN_POSITIVE);
    (opacity.ln() + depth, f / (1.0 + (-logit).exp()) / opacity)
}

fn side(a: &Motion, b: &Motion) -> f32 {
    let dot: f32 = (0..4).map(|k| a.quat[k] * b.quat[k]).sum();
    if dot < 0.0 { -1.0 } else { 1.0 }
}

fn conjugate([w, x, y, z]: &[f32; 4]) -> [f32; 4] {
    [*w, -x, -y, -z]
}

/// The product of two quaternions `(w, x, y, z)`.
fn product([a, b, c, d]: &[f32; 4], [w, x, y, z]: &[f32; 4]) -> [f32; 4] {
    [
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    ]
}

#[cfg(test)]
mod tests {
    use super::{FADE, Posed};
    use crate::{
        Gradients,
        pose::reference::{self, Carried, Node, Splat},
    };
    use m4_core::{
        Binding, Column, CounterRng, Pose, SplatLayout, Splats, Window,
        nalgebra::{Vector3, Vector4},
    };
    use std::sync::Arc;

    const BOUND: usize = 60;
    const NODES: usize = 7;

    /// Two static splats, bound ones in two windows, and a dynamic one.
    fn scene(rng: &mut CounterRng) -> Splats {
        let mut window = |start: f32| {
            let keys: Vec<f32> = (0..5).map(|k| start + k as f32).collect();
            let mut numbers = |n: usize| -> Vec<f32> { (0..n).map(|_| rng.normal() as f32).collect() };
            let anchors = (0..NODES).map(|_| numbers(3).try_into().unwrap()).collect();
            let poses = (0..5 * NODES).map(|_| {
                let q = Vector4::from_vec(numbers(4)).normalize();
                Pose { position: numbers(3).try_into().unwrap(), rotation: q.into() }
            });
            Window::new(keys, anchors, poses.collect()).unwrap()
        };
        let windows = vec![window(0.0), window(5.0)];
        let layout = SplatLayout { isotropic: false, sh_degree: 1, time_degree: 0 };
        let mut splats = Splats::zeros(layout, 2, BOUND + 1);
        splats.columns_mut().for_each(|column| column.fill_with(|| rng.normal() as f32));
        splats.column_mut(Column::TimeMean, 0).fill_with(|| (10.0 * rng.uniform()) as f32);
        let bindings = (0..BOUND).map(|i| {
            let begin = (8.0 * rng.uniform()) as f32;
            Binding {
                window: (i % 2) as u32,
                nodes: [0, 1, 2, 3].map(|k| ((i + 2 * k) % NODES) as u16),
                weights: [0.4, 0.3, 0.2, 0.1],
                life: [begin, begin + 3.0],
            }
        });
        splats.bind(Arc::new(windows), bindings.collect()).unwrap();
        splats
    }

    fn of_reference(splats: &Splats, i: usize, t: f32) -> (Vec<Node<f64>>, Splat<f64>, f64, f64) {
        let binding = &splats.bindings()[i];
        let window = &splats.windows()[binding.window as usize];
        let wide = |v: [f32; 3]| Vector3::from(v.map(f64::from));
        let nodes = binding.nodes.iter().zip(binding.weights).map(|(&node, weight)| {
            let pose = window.pose(usize::from(node), t);
            Node {
                anchor: wide(window.anchors()[usize::from(node)]),
                position: wide(pose.position),
                rotation: Vector4::from(pose.rotation.map(f64::from)),
                weight: f64::from(weight),
            }
        });
        let row = splats.n_static() + i;
        let get = |column, k, at: usize| f64::from(splats.column(column, k)[at]);
        let three = |column, at: usize| Vector3::from_fn(|k, _| get(column, k, at));
        let splat = Splat {
            mean: three(Column::Mean, row),
            velocity: three(Column::Velocity, i),
            quat: Vector4::from_fn(|k, _| get(Column::Quat, k, row)),
            logit: get(Column::Opacity, 0, row),
            rgb: three(Column::Colour, row),
            trend: three(Column::Trend, i),
        };
        let presence = reference::presence(
            f64::from(t),
            binding.life.map(f64::from),
            f64::from(FADE) * f64::from(window.gap()),
        );
        (nodes.collect(), splat, f64::from(t) - get(Column::TimeMean, 0, i), presence)
    }

    #[test]
    fn the_fast_version_agrees_with_the_reference() {
        let mut rng = CounterRng::new(8, 0, 0);
        let splats = scene(&mut rng);
        let layout = splats.layout();
        let close = |got: f32, want: f64, what: &str| {
            assert!((f64::from(got) - want).abs() < 2e-4 * (1.0 + want.abs()), "{what}: {got} for {want}");
        };
        let mut alive = 0;
        for t in [3.0f32, 4.5, 6.0] {
            let mut posed = Posed::default();
            posed.pose(&splats, t);
            let mut gradients = Gradients::default();
            gradients.reset(&splats);
            gradients.columns.iter_mut().for_each(|column| column.fill_with(|| rng.normal() as f32));
            gradients.touched[splats.bound()].fill(1);
            let given = gradients.clone();
            posed.backward(&splats, &mut gradients);
            let mut nodes = vec![vec![[0.0f64; 6]; NODES]; 2];
            for i in 0..BOUND {
                let row = splats.n_static() + i;
                let (carriers, splat, dt, presence) = of_reference(&splats, i, t);
                if presence < 2e-3 {
                    assert!(posed.opacity[row] < -20.0 || presence > 5e-4);
                    continue;
                }
                alive += 1;
                let want = reference::carry(&carriers, &splat, dt, presence);
                let get = |column, k: usize, at: usize| f64::from(given.columns[layout.column(column) + k][at]);
                let g = Carried {
                    mean: Vector3::from_fn(|k, _| get(Column::Mean, k, row)),
                    quat: Vector4::from_fn(|k, _| get(Column::Quat, k, row)),
                    logit: get(Column::Opacity, 0, row),
                    rgb: Vector3::from_fn(|k, _| get(Column::Colour, k, row)),
                };
                let back = reference::backward(&carriers, &splat, dt, presence, &g);
                let got = |column, k: usize, at: usize| gradients.columns[layout.column(column) + k][at];
                for k in 0..3 {
                    close(posed.mean[k][row], want.mean[k], "mean");
                    close(posed.colour[k][row], want.rgb[k], "colour");
                    close(got(Column::Mean, k, row), back.splat.mean[k], "gradient of the mean");
                    close(got(Column::Velocity, k, i), back.splat.velocity[k], "gradient of the velocity");
                    close(got(Column::Trend, k, i), back.splat.trend[k], "gradient of the trend");
                    close(got(Column::Colour, k, row), back.splat.rgb[k], "gradient of the colour");
                }
                for k in 0..4 {
                    close(posed.quat[k][row], want.quat[k], "quaternion");
                    close(got(Column::Quat, k, row), back.splat.quat[k], "gradient of the quaternion");
                }
                close(posed.opacity[row], want.logit, "opacity");
                close(got(Column::Opacity, 0, row), back.splat.logit, "gradient of the opacity");
                let binding = &splats.bindings()[i];
                for (&node, [place, turn]) in binding.nodes.iter().zip(&back.nodes) {
                    let sum = &mut nodes[binding.window as usize][usize::from(node)];
                    (0..3).for_each(|k| sum[k] += place[k]);
                    (0..3).for_each(|k| sum[3 + k] += turn[k]);
                }
            }
            for found in &gradients.nodes {
                for (got, want) in found.nodes.iter().flatten().zip(nodes[found.window].iter().flatten()) {
                    close(*got, *want, "gradient of a node");
                }
            }
            assert_eq!(gradients.nodes.len(), usize::from(t.fract() == 0.0));
        }
        assert!(alive > BOUND / 2, "{alive}");
    }
}
