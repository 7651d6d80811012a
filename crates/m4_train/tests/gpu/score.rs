//! Scores of density control.

use crate::{
    batch::{CASTS, exposed, pulled_back},
    gpu,
    step::{LAMBDA, image, start},
};
use m4_core::{Column, Exposure, Splats};
use m4_kernels::{
    Gradients, Renderer, SimdLevel, View,
    adam::cpu::AdamState,
    loss::cpu::{LossScratch, Target, error_map, loss},
};
use m4_testkit::assert_gradient;
use m4_train::{
    backend::gpu::GpuTrainer,
    config::ErrorRange,
    density::{ScoreSettings, masked_error},
};

fn on_the_cpu(
    splats: &Splats,
    frames: &[Target],
    views: &[(usize, View)],
    exposures: &[Exposure],
    settings: &ScoreSettings,
) -> [Vec<f32>; 2] {
    let mut renderer = Renderer::new(SimdLevel::best());
    let (mut scratch, mut gradient, mut errors) =
        (LossScratch::default(), Default::default(), Vec::new());
    let mut out = [vec![0.0; splats.n()], vec![0.0; splats.n()]];
    for (frame, view) in views {
        let rgb = exposed(exposures.get(*frame), &renderer.render(splats, view).rgb);
        let (level, target) = (SimdLevel::best(), &frames[*frame]);
        let photo = loss(
            level,
            target,
            &rgb,
            settings.lambda_ssim,
            &mut scratch,
            &mut gradient,
        );
        error_map(level, target, &rgb, &mut errors);
        masked_error(&mut errors, settings.threshold, settings.range);
        let mut one = vec![0.0; splats.n()];
        renderer.score(&errors, &mut one);
        for (i, s) in one.iter().enumerate() {
            out[0][i] += s / views.len() as f32;
            out[1][i] += s * photo.total as f32;
        }
    }
    out
}

#[test]
fn scores_are_those_of_the_cpu() {
    let Some(gpu) = gpu("scores") else { return };
    let (splats, view) = start();
    let frames = [image(0), image(2)];
    let late = View { t: 6.5, ..view };
    let views = [(1, view), (0, late), (1, late)];
    let mut trainer =
        GpuTrainer::new(gpu, &splats, &AdamState::new(&splats), &frames, 1 << 14).unwrap();
    for (threshold, range, exposures) in [
        (0.1, ErrorRange::Quantile { high: 0.995 }, &CASTS[..0]),
        (0.5, ErrorRange::Quantile { high: 0.5 }, &CASTS[..]),
        (0.3, ErrorRange::MinMax, &CASTS[..1]),
    ] {
        trainer.set_exposures(exposures);
        let settings = ScoreSettings {
            lambda_ssim: LAMBDA,
            threshold,
            range,
        };
        let want = on_the_cpu(&splats, &frames, &views, exposures, &settings);
        let got = trainer.score(&views, &settings).unwrap();
        for (got, want) in [&got.densify, &got.prune].into_iter().zip(&want) {
            assert!(
                want.iter().filter(|&&v| v > 0.1).count() > 100,
                "too little to compare"
            );
            // a pixel at the cut or a contribution at its threshold counts in one and not in the
            // other
            let off = got
                .iter()
                .zip(want)
                .filter(|(a, b)| (*a - *b).abs() > 1e-4 * (1.0 + b.abs()));
            let off = off.count();
            assert!(
                off * 50 < want.len(),
                "{range:?}: {off} of {} scores differ",
                want.len()
            );
            let (a, b): (f64, f64) = (sum(got), sum(want));
            assert!((a - b).abs() < 1e-3 * b, "{range:?}: {a} for {b}");
        }
        assert_eq!(
            trainer.score(&views, &settings).unwrap(),
            got,
            "the same bits"
        );
    }
    assert_eq!(trainer.stats().unwrap().frames, 0, "scores are no steps");
}

fn sum(values: &[f32]) -> f64 {
    values.iter().map(|&v| f64::from(v)).sum()
}

#[test]
fn an_image_that_is_wrong_everywhere_alike_scores_nothing() {
    let Some(gpu) = gpu("flat errors") else {
        return;
    };
    let (splats, view) = start();
    // nothing is drawn but the background, and the frame is black
    let away = View {
        near: 1e9,
        background: [0.5; 3],
        ..view
    };
    let k = &view.camera.intrinsics;
    let black = Target::from_bytes(
        k.width,
        k.height,
        [0, 1, 2].map(|_| vec![0; k.width * k.height]),
    )
    .unwrap();
    let mut trainer =
        GpuTrainer::new(gpu, &splats, &AdamState::new(&splats), [black], usize::MAX).unwrap();
    let settings = ScoreSettings {
        lambda_ssim: LAMBDA,
        threshold: 0.1,
        range: ErrorRange::MinMax,
    };
    let got = trainer.score(&[(0, away), (0, view)], &settings).unwrap();
    let alone = trainer.score(&[(0, view)], &settings).unwrap();
    assert_eq!(got.prune, alone.prune);
    assert!(
        trainer
            .score(&[], &settings)
            .unwrap()
            .prune
            .iter()
            .all(|&v| v == 0.0)
    );
}

/// Residual, weight.
fn sums_on_the_cpu(
    splats: &Splats,
    frames: &[Target],
    views: &[(usize, View)],
    exposures: &[Exposure],
) -> [[Vec<f64>; 3]; 2] {
    let mut renderer = Renderer::new(SimdLevel::best());
    let zero = || [0, 1, 2].map(|_| vec![0.0; splats.n()]);
    let (mut residual, mut weight) = (zero(), zero());
    let first = splats.layout().column(Column::Colour);
    let add = |renderer: &mut Renderer, g: &[Vec<f32>; 3], to: &mut [Vec<f64>; 3]| {
        let mut out = Gradients::default();
        renderer.backward(splats, g, false, &mut out);
        for (k, to) in to.iter_mut().enumerate() {
            for (i, to) in to
                .iter_mut()
                .enumerate()
                .filter(|&(i, _)| out.touched[i] == 1)
            {
                *to += f64::from(out.columns[first + k][i]);
            }
        }
    };
    for (frame, view) in views {
        let drawn = exposed(exposures.get(*frame), &renderer.render(splats, view).rgb);
        let target = frames[*frame].rgb();
        let rgb = [0, 1, 2].map(|k| -> Vec<f32> {
            drawn[k]
                .iter()
                .zip(&target[k])
                .map(|(a, b)| a - b)
                .collect()
        });
        let mut g = pulled_back(exposures.get(*frame), &rgb);
        add(&mut renderer, &g, &mut residual);
        g.iter_mut().for_each(|plane| plane.fill(1.0));
        add(&mut renderer, &g, &mut weight);
    }
    [residual, weight]
}

#[test]
fn sums_are_those_of_the_cpu() {
    let Some(gpu) = gpu("sums of colours") else {
        return;
    };
    let (splats, view) = start();
    let frames = [image(0), image(2)];
    let views = [(0, view), (1, View { t: 6.5, ..view })];
    let mut trainer =
        GpuTrainer::new(gpu, &splats, &AdamState::new(&splats), &frames, usize::MAX).unwrap();
    for exposures in [&CASTS[..0], &CASTS[..1]] {
        trainer.set_exposures(exposures);
        let [residual, weight] = sums_on_the_cpu(&splats, &frames, &views, exposures);
        let got = trainer.colour_sums(&views, true, &|| false).unwrap();
        let wide = |plane: &[f32]| -> Vec<f64> { plane.iter().map(|&v| f64::from(v)).collect() };
        for k in 0..3 {
            assert_gradient("residuals", &wide(&got.residual[k]), &residual[k], 5e-3);
            assert_gradient("weights", &wide(&got.weight[k]), &weight[k], 5e-3);
        }
        let again = trainer.colour_sums(&views, false, &|| false).unwrap();
        assert_eq!(again.residual, got.residual, "the same bits");
        assert!(again.weight.iter().all(Vec::is_empty));
    }
    assert_eq!(trainer.download_splats().unwrap(), splats, "nothing moves");
}
