//! Scores of every splat over some frames: their mean (Minute4D Eq. 9), and their sum weighted by the loss of the frame
//! (Minute4D Eq. 10, which [`super::decide()`] normalises).

use super::{Scores, masked_error};
use crate::{
    backend::{FrameStore, ScoreSettings},
    refine::expose,
};
use m4_core::{Exposure, Splats};
use m4_kernels::loss::cpu::{LossScratch, error_map, loss};
use m4_kernels::{Renderer, SimdLevel, View};

/// What scoring needs beside splats and frames.
pub(crate) struct ScoreInput<'a, 'c> {
    pub level: SimdLevel,
    pub settings: &'a ScoreSettings,
    pub frames: &'a mut FrameStore<'c>,
    /// By frame; those beyond are not corrected.
    pub exposures: &'a [Exposure],
    pub renderer: &'a mut Renderer,
    pub scratch: &'a mut LossScratch,
}

/// Draws `splats` in each of `frames`, with the view that goes with it, and adds up what is wrong
/// where they are.
pub(crate) fn score(input: &mut ScoreInput<'_, '_>, splats: &Splats, frames: &[(usize, View)]) -> Scores {
    let n = splats.n();
    let mut scores = Scores { densify: vec![0.0; n], prune: vec![0.0; n] };
    let (mut one, mut errors) = (vec![0.0f32; n], Vec::new());
    let (mut gradient, mut exposed): ([Vec<f32>; 3], [Vec<f32>; 3]) = Default::default();
    let share = 1.0 / frames.len().max(1) as f32;
    for (frame, view) in frames {
        let target = input.frames.target(*frame);
        let drawn = input.renderer.render(splats, view);
        let rgb = match input.exposures.get(*frame) {
            Some(exposure) => {
                expose(exposure, &drawn.rgb, &mut exposed);
                &exposed
            }
            None => &drawn.rgb,
        };
        let terms = loss(input.level, target, rgb, input.settings.lambda_ssim, input.scratch, &mut gradient);
        error_map(input.level, target, rgb, &mut errors);
        masked_error(&mut errors, input.settings.threshold, input.settings.range);
        one.fill(0.0);
        input.renderer.score(&errors, &mut one);
        for i in 0..n {
            scores.densify[i] += one[i] * share;
            scores.prune[i] += one[i] * terms.total as f32;
        }
    }
    scores
}
