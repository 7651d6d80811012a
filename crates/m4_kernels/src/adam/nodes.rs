//! One step of the nodes that carry splats: their positions and turns at the key that a frame
//! shows.
//!
//! A node has six parameters at each key, three of its position and a turn (rotation vector, world
//! axes, applied last). The moments of a turn are kept in world axes, although the node turns a
//! little with every step.

use super::{AdamParams, cpu::AdamConfig, reference::update};
use crate::{NODE_PARAMETERS, NodeGradients};
use m4_core::{
    Window,
    nalgebra::{Quaternion, UnitQuaternion, Vector3},
};

/// The moments of the nodes of a window.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeMoments {
    /// `[keys]` steps taken.
    pub step: Vec<u32>,
    /// First moments, `[keys][nodes][6]`.
    pub m: Vec<f32>,
    /// Second moments, likewise.
    pub v: Vec<f32>,
}

impl NodeMoments {
    /// Nothing seen yet.
    pub fn new(window: &Window) -> Self {
        let zeros = vec![0.0; NODE_PARAMETERS * window.keys().len() * window.anchors().len()];
        Self {
            step: vec![0; window.keys().len()],
            v: zeros.clone(),
            m: zeros,
        }
    }
}

/// Steps of the positions, world units, and of the turns, radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NodeRates {
    /// World units.
    pub position: f32,
    /// Radians.
    pub turn: f32,
}

/// One step of the nodes that `gradients` touch; `moments` are those of each window.
/// Panics if `gradients` or `moments` do not fit `windows`.
pub fn step(
    windows: &mut [Window],
    gradients: &[NodeGradients],
    moments: &mut [NodeMoments],
    config: &AdamConfig,
    rates: NodeRates,
) {
    let params = AdamParams {
        beta1: config.beta1,
        beta2: config.beta2_dynamic,
        epsilon: config.eps,
    };
    for gradient in gradients {
        if gradient.nodes.iter().flatten().all(|&g| g == 0.0) {
            continue;
        }
        let (window, moments) = (&mut windows[gradient.window], &mut moments[gradient.window]);
        let size = NODE_PARAMETERS * window.anchors().len();
        moments.step[gradient.key] += 1;
        let count = moments.step[gradient.key];
        let part = gradient.key * size..(gradient.key + 1) * size;
        let (m, v) = (&mut moments.m[part.clone()], &mut moments.v[part]);
        let moments = m
            .chunks_exact_mut(NODE_PARAMETERS)
            .zip(v.chunks_exact_mut(NODE_PARAMETERS));
        for ((pose, g), (m, v)) in window
            .poses_mut(gradient.key)
            .iter_mut()
            .zip(&gradient.nodes)
            .zip(moments)
        {
            if g.iter().all(|&g| g == 0.0) {
                continue;
            }
            let mut turn = [0.0f32; 3];
            for k in 0..NODE_PARAMETERS {
                let (x, rate) = match k {
                    0..3 => (&mut pose.position[k], rates.position),
                    _ => (&mut turn[k - 3], rates.turn),
                };
                (*x, m[k], v[k]) = update(*x, g[k], m[k], v[k], count, rate, &params);
            }
            let [w, x, y, z] = pose.rotation;
            let turn = UnitQuaternion::from_scaled_axis(Vector3::from(turn)).into_inner();
            let rotation = UnitQuaternion::new_normalize(turn * Quaternion::new(w, x, y, z));
            pose.rotation = [rotation.w, rotation.i, rotation.j, rotation.k];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{AdamConfig, NodeGradients, NodeMoments, NodeRates, step};
    use m4_core::{Pose, Window};

    fn window() -> Window {
        let pose = Pose {
            position: [1.0, 2.0, 3.0],
            rotation: [1.0, 0.0, 0.0, 0.0],
        };
        Window::new(vec![0.0, 1.0], vec![[0.0; 3]; 2], vec![pose; 4]).unwrap()
    }

    /// The loss is the distance of a node from a place and of its turn from another; Adam goes
    /// there.
    #[test]
    fn a_node_goes_where_its_gradient_leads_and_others_stay() {
        let mut windows = [window()];
        let mut moments = [NodeMoments::new(&windows[0])];
        let rates = NodeRates {
            position: 0.01,
            turn: 0.01,
        };
        let (place, angle) = ([1.2f32, 1.9, 3.0], 0.3f32);
        for _ in 0..400 {
            let pose = windows[0].poses(1)[0];
            let turned = 2.0 * pose.rotation[3].atan2(pose.rotation[0]);
            let [x, y, z] = [0, 1, 2].map(|k| pose.position[k] - place[k]);
            let gradient = [x, y, z, 0.0, 0.0, turned - angle];
            let gradients = [NodeGradients {
                window: 0,
                key: 1,
                nodes: vec![gradient, [0.0; 6]],
            }];
            step(
                &mut windows,
                &gradients,
                &mut moments,
                &AdamConfig::default(),
                rates,
            );
        }
        let [moved, other] = [0, 1].map(|node| windows[0].poses(1)[node]);
        assert!(
            (0..3).all(|k| (moved.position[k] - place[k]).abs() < 0.01),
            "{moved:?}"
        );
        assert!(
            (2.0 * moved.rotation[3].atan2(moved.rotation[0]) - angle).abs() < 0.01,
            "{moved:?}"
        );
        assert_eq!(
            (other, windows[0].poses(0)),
            (window().poses(1)[1], window().poses(0))
        );
        assert_eq!(moments[0].step, [0, 400]);
        let before = (windows.clone(), moments.clone());
        let nothing = [NodeGradients {
            window: 0,
            key: 0,
            nodes: vec![[0.0; 6]; 2],
        }];
        step(
            &mut windows,
            &nothing,
            &mut moments,
            &AdamConfig::default(),
            rates,
        );
        assert_eq!(
            (windows, moments),
            before,
            "a key that no splat shows is not stepped"
        );
    }
}
