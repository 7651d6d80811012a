//! Splats that are never stepped.

use crate::{
    gpu,
    step::{LAMBDA, LAYOUT, columns, image, settings, start},
};
use m4_core::Splats;
use m4_kernels::adam::{
    FIXED,
    cpu::{AdamConfig, AdamState},
};
use m4_train::{
    backend::{StepSettings, StepView, gpu::GpuTrainer},
    config::ErrorRange,
    density::ScoreSettings,
};

const FIXED_ROWS: std::ops::Range<usize> = 0..120;

fn rows(splats: &Splats, rows: std::ops::Range<usize>) -> Vec<f64> {
    columns(
        &splats
            .gather(&rows.map(|row| row as u32).collect::<Vec<u32>>())
            .unwrap(),
    )
}

#[test]
fn fixed_splats_are_neither_stepped_nor_scored_nor_recoloured() {
    let Some(gpu) = gpu("fixed splats") else {
        return;
    };
    let (splats, view) = start();
    let mut adam = AdamState::new(&splats);
    adam.step[FIXED_ROWS].fill(FIXED);
    let free = FIXED_ROWS.end..splats.n();
    let frames = [image(0), image(2)];
    let rates = vec![1e-3; LAYOUT.columns()];
    for sparse in [true, false] {
        let mut trainer =
            GpuTrainer::new(gpu.clone(), &splats, &adam, &frames, usize::MAX).unwrap();
        let mut settings: StepSettings<'_> = settings(&rates);
        settings.adam = AdamConfig {
            sparse,
            ..AdamConfig::default()
        };
        for frame in [0, 1, 0] {
            trainer
                .step(&[StepView::new(frame, &view)], &settings)
                .unwrap();
        }
        let (got, after) = trainer.download().unwrap();
        assert_eq!(rows(&got, FIXED_ROWS), rows(&splats, FIXED_ROWS));
        assert!(after.step[FIXED_ROWS].iter().all(|&step| step == FIXED));
        assert!(rows(&after.m, FIXED_ROWS).iter().all(|&m| m == 0.0));
        assert!(after.step[free.clone()].contains(&3));
        assert!(rows(&got, free.clone()) != rows(&splats, free.clone()));

        let views = [(0, view), (1, view)];
        let score = ScoreSettings {
            lambda_ssim: LAMBDA,
            threshold: 0.1,
            range: ErrorRange::MinMax,
        };
        let scores = trainer.score(&views, &score).unwrap();
        let sums = trainer.colour_sums(&views, true, &|| false).unwrap();
        let values = [&scores.densify, &scores.prune]
            .into_iter()
            .chain(&sums.residual)
            .chain(&sums.weight);
        for values in values {
            assert!(values[FIXED_ROWS].iter().all(|&v| v == 0.0));
            assert!(values[free.clone()].iter().any(|&v| v != 0.0));
        }
    }
}
