//! All edges of one source frame: the step of its disparities once that of the poses is known, and what they tell
//! about depth and focal length.

use super::lanes::{BLOCK, EdgeBlock, PAIR, dot, linearise, load};
use super::options::stepped_disparity;
use super::source::{Context, Curvature, Source};
use fearless_simd::Simd;
use m4_core::dispatch;
use m4_core::nalgebra::Vector6;

impl Source<'_> {
    /// The disparities after the step: `poses[frame]` holds the twist of every frame, zero where it is fixed.
    pub(super) fn substitute(&self, context: &Context<'_>, twists: &[Vector6<f64>], focal: f64) -> Vec<f32> {
        let mut out = vec![0.0; context.geometry.grid.len()];
        let changes: Vec<[f32; 6]> = self
            .edges
            .iter()
            .map(|f| {
                let g = context.geometry.relative(f.source, f.target);
                let y = twists[f.target] - g.adjoint() * twists[f.source];
                std::array::from_fn(|a| y[a] as f32)
            })
            .collect();
        dispatch!(context.level, _s => self.substitute_blocks(context, &changes, focal as f32, &mut out));
        out
    }

    #[inline(always)]
    fn substitute_blocks(&self, context: &Context<'_>, changes: &[[f32; 6]], focal: f32, out: &mut [f32]) {
        let constants = self.constants(context);
        let mut block = EdgeBlock::new();
        for (k, chunk) in out.chunks_mut(BLOCK).enumerate() {
            let start = k * BLOCK;
            let disparity = load(&context.geometry.disparity[self.frame], start);
            let mut curvature = Curvature::ZERO;
            for (e, edge) in self.edges.iter().enumerate() {
                linearise(&constants[e], &edge.target_px, &edge.weight, &context.rays, &disparity, start, &mut block);
                let y = changes[e];
                // What the poses take away of the residual.
                for l in 0..PAIR {
                    let mut change = focal * block.jf[l];
                    for a in 0..6 {
                        change += y[a] * block.j[a][l];
                    }
                    block.r[l] -= change;
                }
                curvature.add(&block);
            }
            curvature.invert(context, self.frame, start, &disparity);
            for (l, d) in chunk.iter_mut().enumerate() {
                *d = stepped_disparity(disparity[l], curvature.b[l] * curvature.c[l]);
            }
        }
    }

    /// `sum Jz^2` of every pixel and `sum Jf^2` of all, over valid points and with weights of 1.
    pub(super) fn information(&self, context: &Context<'_>) -> (Vec<f32>, f64) {
        let mut depth = vec![0.0; context.geometry.grid.len()];
        let focal = dispatch!(context.level, s => self.information_blocks(s, context, &mut depth));
        (depth, focal)
    }

    #[inline(always)]
    fn information_blocks<S: Simd>(&self, s: S, context: &Context<'_>, out: &mut [f32]) -> f64 {
        let constants = self.constants(context);
        let ones = [vec![1.0; out.len()], vec![1.0; out.len()]];
        let mut block = EdgeBlock::new();
        let mut focal = 0.0;
        for (k, chunk) in out.chunks_mut(BLOCK).enumerate() {
            let start = k * BLOCK;
            let disparity = load(&context.geometry.disparity[self.frame], start);
            let mut curvature = Curvature::ZERO;
            for (e, edge) in self.edges.iter().enumerate() {
                let constants = constants[e].unscaled();
                linearise(&constants, &edge.target_px, &ones, &context.rays, &disparity, start, &mut block);
                curvature.add(&block);
                for l in 0..PAIR {
                    block.w[l] *= block.jf[l];
                }
                focal += dot(s, &block.w, &block.jf);
            }
            chunk.copy_from_slice(&curvature.c[..chunk.len()]);
        }
        focal
    }
}
