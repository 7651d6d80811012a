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
    /// Derivative of the carried logit of the opacity with respect to the own one; 0 where the
    /// splat is left out.
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
        self.colour.resize_with(
            if bound.is_empty() {
                0
            } else {
                3 * layout.colour_terms()
            },
            Vec::new,
        );
        self.carriers.resize(bound.len(), Carrier::default());
        if bound.is_empty() {
            return;
        }
        self.motions
            .par_extend(windows.par_iter().map(|window| motions(window, t)));
        for (term, column) in self.colour.iter_mut().enumerate().skip(3) {
            column.clone_from_slice_of(&splats.column(Column::Colour, term)[..bound.end]);
        }
        let columns = self
            .mean
            .iter_mut()
            .chain(&mut self.quat)
            .chain([&mut self.opacity])
            .chain(&mut self.colour[..3]);
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
        tasks
            .into_par_iter()
            .for_each(|(first, carriers, mut out)| {
                for (i, carrier) in carriers.iter_mut().enumerate() {
                    let binding = &splats.bindings()[first + i];
                    let window = binding.window as usize;
                    *carrier = Carrier::default();
                    let presence = presence(t, binding.life, FADE * windows[window].gap());
                    if presence < LEAST_PRESENCE || motions[window].is_empty() {
                        out[7][i] = NOWHERE;
                        continue;
                    }
                    *carrier = one(
                        splats,
                        binding,
                        first + i,
                        t,
                        presence,
                        &motions[window],
                        |column, v| out[column][i] = v,
                    );
                }
            });
    }

    /// Turns gradients with respect to what is drawn of bound splats into those with respect to the
    /// splats and to nodes.
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

    /// The gradients of the nodes of a window, from those of what is drawn: added in the order of
    /// the rows.
    fn nodes(&self, splats: &Splats, out: &Gradients, window: usize, key: usize) -> NodeGradients {
        let (layout, motions) = (splats.layout(), &self.motions[window]);
        let anchors = splats.windows()[window].anchors();
        let mut sums = vec![[0.0f32; 6]; anchors.len()];
        for (i, (row, binding)) in splats.bound().zip(splats.bindings()).enumerate() {
            if out.touched[row] == 0
                || self.carriers[i].fade == 0.0
                || binding.window as usize != window
            {
                continue;
            }
            let get = |column, k: usize| splats.column(column, k);
            let g: [f32; 3] =
                std::array::from_fn(|k| out.columns[layout.column(Column::Mean) + k][row]);
            let dt = self.t - get(Column::TimeMean, 0)[i];
            let own: [f32; 3] = std::array::from_fn(|k| {
                get(Column::Mean, k)[row] + get(Column::Velocity, k)[i] * dt
            });
            let turn = match layout.isotropic {
                true => [0.0; 4],
                false => {
                    let g: [f32; 4] =
                        std::array::from_fn(|k| out.columns[layout.column(Column::Quat) + k][row]);
                    let own: [f32; 4] = std::array::from_fn(|k| get(Column::Quat, k)[row]);
                    product(&g, &conjugate(&own))
                }
            };
            let first = &motions[usize::from(binding.nodes[0])];
            for (&node, &weight) in binding.nodes.iter().zip(&binding.weights) {
                let node = usize::from(node);
                let motion = &motions[node];
                let from: [f32; 3] = std::array::from_fn(|k| own[k] - anchors[node][k]);
                let arm: [f32; 3] =
                    std::array::from_fn(|r| (0..3).map(|c| motion.matrix[r][c] * from[c]).sum());
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
        NodeGradients {
            window,
            key,
            nodes: sums,
        }
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

/// When splats of a window are drawn, frames: a life ends half a gap beyond the last key, and a
/// fade after it.
pub(super) fn drawn(window: &Window) -> [f32; 2] {
    let (keys, reach) = (window.keys(), (0.5 + FADE) * 2.0 * window.gap());
    if keys.len() > 1 {
        [keys[0] - reach, keys[keys.len() - 1] + reach]
    } else {
        [f32::NEG_INFINITY, f32::INFINITY]
    }
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
        let matrix: [[f32; 3]; 3] =
            std::array::from_fn(|r| std::array::from_fn(|c| rotation[(r, c)]));
        let shift = std::array::from_fn(|r| {
            pose.position[r]
                - (matrix[r][0] * anchor[0] + matrix[r][1] * anchor[1] + matrix[r][2] * anchor[2])
        });
        Motion {
            quat: pose.rotation,
            matrix,
            shift,
        }
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
        out(
            r,
            matrix[r][0] * own[0] + matrix[r][1] * own[1] + matrix[r][2] * own[2] + shift[r],
        );
    }
    if !splats.layout().isotropic {
        let own: [f32; 4] = std::array::from_fn(|k| splats.column(Column::Quat, k)[row]);
        let carried = product(&quat, &own);
        (0..4).for_each(|k| out(3 + k, carried[k]));
    }
    let (logit, fade) = faded(splats.column(Column::Opacity, 0)[row], presence);
    out(7, logit);
    for k in 0..3 {
        out(
            8 + k,
            splats.column(Column::Colour, k)[row] + splats.column(Column::Trend, k)[i] * dt,
        );
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
    let depth = f * if logit > 0.0 {
        logit + (-logit).exp().ln_1p()
    } else {
        logit.exp().ln_1p()
    };
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
mod tests;
