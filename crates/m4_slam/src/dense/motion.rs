//! What moves: flow that the camera and the depth do not explain.

use super::config::MotionConfig;
use super::flow::Flow;
use super::pair::Pair;

/// Flow that leads from a frame to another, with the other's flow back.
pub(super) struct Link<'a> {
    pub there: &'a Flow,
    /// `[height][width]`: distance after going there and back, pixels.
    pub round_trip: &'a [f32],
    pub pair: Pair,
}

/// Evidence of one frame: `[height][width]`, below 0 for static, above for moving, and its weight.
pub(super) struct Evidence {
    pub value: Vec<f32>,
    pub weight: Vec<f32>,
}

/// Compares the flow to other frames with what depth and cameras predict.
pub(super) fn evidence(width: usize, height: usize, disparity: &[f32], links: &[Link<'_>], config: &MotionConfig) -> Evidence {
    let n = width * height;
    let (mut value, mut weight) = (vec![0.0f32; n], vec![0.0f32; n]);
    for link in links {
        for y in 0..height {
            for x in 0..width {
                let i = y * width + x;
                let seen = link.pair.project(x as f32, y as f32, disparity[i]);
                if !(seen.disparity > 0.0) || !link.round_trip[i].is_finite() {
                    continue;
                }
                let (u, v) = (link.there.u[i], link.there.v[i]);
                let residual = (x as f32 + u - seen.x).hypot(y as f32 + v - seen.y);
                let noise = config.flow_noise_px + 0.05 * u.hypot(v) + 0.5 * link.round_trip[i];
                let e = (0.5 * (residual / noise - 2.5)).clamp(-1.0, 1.0);
                let w = 1.0 / (1.0 + link.round_trip[i] * link.round_trip[i]);
                value[i] += w * e;
                weight[i] += w;
            }
        }
    }
    for (v, w) in value.iter_mut().zip(&weight) {
        *v /= w.max(1e-6);
    }
    Evidence { value, weight }
}
