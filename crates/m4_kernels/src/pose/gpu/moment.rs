//! What kernels are told of the windows at an instant.

use crate::{
    gpu::{
        Gpu,
        buffer::{Buffer, NOTHING},
    },
    pose::FADE,
};
use m4_core::Window;

/// Numbers of a window, floats as their bits:
pub(super) const WINDOW: usize = 16;
/// its first node among all,
pub(super) const FIRST: usize = 0;
/// how many it has,
pub(super) const NODES: usize = 1;
/// 1 where splats of it may be present,
pub(super) const ON: usize = 2;
/// where the poses at four keys start,
pub(super) const POSES: usize = 3;
/// their weights in the position; the second and third are those of the rotation,
pub(super) const WEIGHTS: usize = 7;
/// the share of the turn between them,
pub(super) const SHARE: usize = 11;
/// half a fade, frames,
pub(super) const HALF: usize = 12;
/// where the poses at the key at this instant start, or [`NOTHING`],
pub(super) const KEY: usize = 13;
/// and 1 where their gradients are added to those that are already known.
pub(super) const ADD: usize = 14;

/// The windows at an instant.
#[derive(Debug)]
pub(crate) struct Moment {
    /// [`WINDOW`] numbers for each window, then the indices of those that splats may be present of.
    pub table: Buffer,
    /// Windows that splats may be present of.
    pub active: usize,
    /// Nodes of the largest of them.
    pub most: usize,
    /// Window and key, where such a window has a key at the instant.
    pub keys: Vec<(usize, usize)>,
}

impl Moment {
    /// The numbers of the table of `windows`, where there are some.
    pub fn length(windows: &[Window]) -> usize {
        WINDOW * windows.len() + windows.len()
    }

    /// The windows at `t`, frames; `starts` are the first node and the first pose of each.
    /// Gradients of the nodes at `existing_keys` are added to.
    pub fn new(
        gpu: &Gpu,
        windows: &[Window],
        starts: &[[usize; 2]],
        t: f32,
        existing_keys: &[(usize, usize)],
    ) -> Self {
        let (mut table, mut active, mut most, mut keys) = (Vec::new(), Vec::new(), 0, Vec::new());
        for (index, (window, &[first, poses])) in windows.iter().zip(starts).enumerate() {
            let nodes = window.anchors().len();
            let near = is_near(window, t);
            if near {
                active.push(index as u32);
                most = most.max(nodes);
            }
            let (at, weights, share) = between(window, t);
            let [a, b, c, d] = at.map(|key| (poses + key * nodes) as u32);
            let [p, q, r, s] = weights.map(f32::to_bits);
            let mut key_at = NOTHING;
            let mut add = 0;
            if let Some(key) = window.key_at(t).filter(|_| near) {
                key_at = (poses + key * nodes) as u32;
                add = u32::from(existing_keys.contains(&(index, key)));
                keys.push((index, key));
            }
            let half = (FADE * window.gap()).to_bits();
            let (share, near, nodes) = (share.to_bits(), u32::from(near), nodes as u32);
            table.extend([
                first as u32,
                nodes,
                near,
                a,
                b,
                c,
                d,
                p,
                q,
                r,
                s,
                share,
                half,
                key_at,
                add,
                0,
            ]);
        }
        let count = active.len();
        table.extend(active);
        Self {
            table: gpu.input(&table),
            active: count,
            most,
            keys,
        }
    }
}

/// Whether a splat of the window may be present at `t`: as on the CPU.
fn is_near(window: &Window, t: f32) -> bool {
    let (keys, reach) = (window.keys(), (0.5 + FADE) * 2.0 * window.gap());
    keys.len() < 2 || (t >= keys[0] - reach && t <= keys[keys.len() - 1] + reach)
}

/// What [`Window::pose`] makes of the poses at four keys: the keys, their weights in the position,
/// and the share of the turn from the second to the third.
fn between(window: &Window, t: f32) -> ([usize; 4], [f32; 4], f32) {
    let keys = window.keys();
    let last = keys.len() - 1;
    let before = keys.partition_point(|&key| key <= t).saturating_sub(1);
    if last == 0 || t == keys[before] {
        return ([before; 4], [0.0, 1.0, 0.0, 0.0], 0.0);
    }
    let a = before.min(last - 1);
    let at = [a.saturating_sub(1), a, a + 1, (a + 2).min(last)];
    let key = |k: usize| f64::from(keys[at[k]]);
    let gap = key(2) - key(1);
    let share = (f64::from(t) - key(1)) / gap;
    let mut weights = [0.0, 1.0 - share, share, 0.0];
    if (0.0..=1.0).contains(&share) {
        let (s, s2, s3) = (share, share * share, share * share * share);
        weights = [0.0, 2.0 * s3 - 3.0 * s2 + 1.0, 3.0 * s2 - 2.0 * s3, 0.0];
        // the slope at the second and at the third: of a parabola through three keys, or of a line
        // at the ends
        for (middle, factor) in [(1, (s3 - 2.0 * s2 + s) * gap), (2, (s3 - s2) * gap)] {
            let mut slope = |from: usize, to: usize, share: f64| {
                let part = factor * share / (key(to) - key(from));
                weights[to] += part;
                weights[from] -= part;
            };
            match at[middle] {
                k if k == 0 || k == last => slope(1, 2, 1.0),
                _ => {
                    let (h, g) = (key(middle) - key(middle - 1), key(middle + 1) - key(middle));
                    slope(middle - 1, middle, g / (h + g));
                    slope(middle, middle + 1, h / (h + g));
                }
            }
        }
    }
    (at, weights.map(|w| w as f32), share as f32)
}

#[cfg(test)]
mod tests {
    use super::between;
    use m4_core::{Pose, Window};

    #[test]
    fn weights_are_those_of_the_window() {
        let keys = [0.0f32, 1.0, 3.0, 4.0, 6.5];
        let places = [0.3f32, -1.0, 2.0, 0.7, 5.0];
        let pose = |&x: &f32| Pose {
            position: [x, 1.0, -2.0 * x],
            rotation: [1.0, 0.0, 0.0, 0.0],
        };
        for count in 1..=keys.len() {
            let poses = places[..count].iter().map(pose).collect();
            let window = Window::new(keys[..count].to_vec(), vec![[0.0; 3]], poses).unwrap();
            for t in [-2.0f32, -0.1, 0.0, 0.4, 1.0, 1.9, 3.0, 3.25, 5.0, 6.5, 8.0] {
                let (at, weights, _) = between(&window, t);
                let sum = |of: fn(&Pose) -> f32| -> f32 {
                    at.iter()
                        .zip(weights)
                        .map(|(&key, w)| w * of(&window.poses(key)[0]))
                        .sum()
                };
                let want = window.pose(0, t).position;
                let got = [
                    sum(|p| p.position[0]),
                    sum(|p| p.position[1]),
                    sum(|p| p.position[2]),
                ];
                for k in 0..3 {
                    assert!(
                        (got[k] - want[k]).abs() < 2e-5,
                        "{count} keys at {t}: {got:?} for {want:?}"
                    );
                }
            }
        }
    }
}
