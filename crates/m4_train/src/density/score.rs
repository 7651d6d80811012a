//! The pixels whose error is large enough to count (Minute4D Eq. 7, Minute4D Eq. 8), and from them
//! the scores of every splat over some frames: their mean (Minute4D Eq. 9), and their sum weighted
//! by the loss of the frame (Minute4D Eq. 10, which [`super::decide()`] normalises).

use super::{ScoreSettings, Scores};
use crate::{config::ErrorRange, frames::FrameStore, refine::expose};
use m4_core::{Exposure, Splats};
use m4_kernels::{
    Renderer, SimdLevel, View,
    loss::cpu::{LossScratch, error_map, loss},
};

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
pub(crate) fn score(
    input: &mut ScoreInput<'_, '_>,
    splats: &Splats,
    frames: &[(usize, View)],
) -> Scores {
    let n = splats.n();
    let mut scores = Scores {
        densify: vec![0.0; n],
        prune: vec![0.0; n],
    };
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
        let terms = loss(
            input.level,
            target,
            rgb,
            input.settings.lambda_ssim,
            input.scratch,
            &mut gradient,
        );
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

/// Sets every error of a frame whose normalised value is not above `threshold` to 0; the others
/// keep their raw value.
///
/// `errors` is one plane, `[height][width]`, of channel-mean absolute errors. Values that are not
/// finite count as 0. A frame without any difference between its errors has no pixel that counts.
pub fn masked_error(errors: &mut [f32], threshold: f32, range: ErrorRange) {
    for e in errors.iter_mut().filter(|e| !e.is_finite()) {
        *e = 0.0;
    }
    let (low, high) = match range {
        ErrorRange::MinMax => errors
            .iter()
            .fold((f32::INFINITY, 0.0f32), |(a, b), &e| (a.min(e), b.max(e))),
        ErrorRange::Quantile { high } => (0.0, quantile(errors, high)),
    };
    let cut = low + threshold * (high - low);
    for e in errors.iter_mut() {
        if high <= low || *e <= cut {
            *e = 0.0;
        }
    }
}

/// The value below which a share `q` of `values` lies; 0 for none.
pub(crate) fn quantile(values: &[f32], q: f32) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let mut sorted = values.to_vec();
    let k = ((values.len() - 1) as f32 * q.clamp(0.0, 1.0)) as usize;
    *sorted
        .select_nth_unstable_by(k.min(values.len() - 1), f32::total_cmp)
        .1
}

#[cfg(test)]
mod tests {
    use super::{masked_error, quantile};
    use crate::config::ErrorRange;

    #[test]
    fn small_errors_do_not_count() {
        let mut errors = vec![0.1, 0.12, 0.3, 0.2, 1.1];
        masked_error(&mut errors, 0.1, ErrorRange::MinMax);
        // cut at 0.1 + 0.1 * 1.0
        assert_eq!(errors, [0.0, 0.0, 0.3, 0.0, 1.1]);
        let mut flat = vec![0.2; 9];
        masked_error(&mut flat, 0.1, ErrorRange::MinMax);
        assert!(flat.iter().all(|&e| e == 0.0));
    }

    #[test]
    fn one_hot_pixel_does_not_hide_the_others() {
        let base: Vec<f32> = (0..1000)
            .map(|i| if i == 7 { 50.0 } else { (i % 10) as f32 * 0.01 })
            .collect();
        let nonzero_count = |range| {
            let mut e = base.clone();
            masked_error(&mut e, 0.1, range);
            e.iter().filter(|e| **e > 0.0).count()
        };
        assert_eq!(nonzero_count(ErrorRange::MinMax), 1);
        assert!(nonzero_count(ErrorRange::Quantile { high: 0.995 }) > 700);
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 0.5), 2.0);
        assert_eq!(quantile(&[], 0.5), 0.0);
    }
}
