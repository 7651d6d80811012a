//! Density control by gradients in the image, as in 3DGS: the statistic of every splat, and rounds
//! that go by it.

use crate::batch::{CASTS, exposed, pulled_back};
use crate::common::video;
use crate::density::{check, round};
use crate::gpu;
use crate::step::{LAMBDA, LAYOUT, columns, image, settings, start};
use m4_core::{Column, Exposure, Splats};
use m4_kernels::adam::{FIXED, cpu::AdamState};
use m4_kernels::loss::cpu::{LossScratch, Target, loss};
use m4_kernels::{Gradients, Renderer, SimdLevel, View, morton_order};
use m4_train::backend::gpu::{GpuBackend, GpuTrainer};
use m4_train::backend::{Backend, CpuBackend, StepView};
use m4_train::config::SplitSize;
use m4_train::density::Decision;
use m4_train::{DensityConfig, SceneScale, TrainConfig};
use std::slice::from_ref;

const FIXED_ROWS: std::ops::Range<usize> = 0..20;
/// Nothing grows or is pruned, but for its opacity.
const NOTHING: Decision = Decision {
    densify: false,
    prune_by_score: false,
    prune_large: false,
    max_splats: 0,
};

/// Frames, and the views of steps: the first step has two of them.
fn clip() -> ([Target; 2], [(usize, View); 3]) {
    let (_, view) = start();
    (
        [image(0), image(2)],
        [(0, view), (1, View { t: 6.5, ..view }), (1, view)],
    )
}

/// Mean lengths of the gradients in the image over the views that touched a splat, by the kernels
/// of the CPU.
fn on_the_cpu(
    splats: &Splats,
    frames: &[Target],
    views: &[(usize, View)],
    exposures: &[Exposure],
) -> Vec<f32> {
    let (mut renderer, mut scratch) = (Renderer::new(SimdLevel::best()), LossScratch::default());
    let mut sums = vec![(0.0f32, 0u8); splats.n()];
    for (frame, view) in views {
        let (exposure, mut g) = (exposures.get(*frame), Default::default());
        let shown = exposed(exposure, &renderer.render(splats, view).rgb);
        loss(
            SimdLevel::best(),
            &frames[*frame],
            &shown,
            LAMBDA,
            &mut scratch,
            &mut g,
        );
        let mut out = Gradients {
            image: Some(Vec::new()),
            ..Gradients::default()
        };
        renderer.backward(splats, &pulled_back(exposure, &g), false, &mut out);
        let lengths = out.image.unwrap();
        for (row, sum) in sums
            .iter_mut()
            .enumerate()
            .filter(|&(row, _)| out.touched[row] == 1)
        {
            *sum = (sum.0 + lengths[row], sum.1 + 1);
        }
    }
    sums.iter()
        .map(|&(sum, frames)| sum / f32::from(frames.max(1)))
        .collect()
}

/// One within digits of the other, but for splats that a frame touched by a pixel at the cut-off of
/// the opacity.
fn assert_means(what: &str, got: &[f32], want: &[f32]) {
    let sum = |values: &[f32]| values.iter().map(|&v| f64::from(v)).sum::<f64>();
    let (all, usual) = (sum(want), sum(want) as f32 / want.len() as f32);
    assert!(
        want.iter().filter(|&&v| v > 0.1 * usual).count() > want.len() / 2,
        "{what}: too little to compare"
    );
    let off = got
        .iter()
        .zip(want)
        .filter(|(a, b)| (*a - *b).abs() > 5e-3 * (usual + b.abs()))
        .count();
    assert!(
        got.len() == want.len() && off * 100 < want.len(),
        "{what}: {off} of {} means differ",
        want.len()
    );
    assert!(
        (sum(got) - all).abs() < 2e-3 * all,
        "{what}: {} for {all}",
        sum(got)
    );
}

#[test]
fn gradients_in_the_image_are_those_of_the_cpu() {
    let Some(gpu) = gpu("gradients in the image") else {
        return;
    };
    let (splats, _) = start();
    let (frames, views) = clip();
    let mut adam = AdamState::new(&splats);
    adam.step[FIXED_ROWS].fill(FIXED);
    let rates = vec![0.0; LAYOUT.columns()];
    let settings = settings(&rates);
    let [a, b, c] = [0, 1, 2].map(|k| StepView::new(views[k].0, &views[k].1));
    for exposures in [&CASTS[..0], &CASTS[..1]] {
        let mut trainer =
            GpuTrainer::new(gpu.clone(), &splats, &adam, &frames, usize::MAX).unwrap();
        trainer.set_exposures(exposures);
        trainer.step(&[a, c], &settings).unwrap();
        assert!(
            trainer
                .image_gradients()
                .unwrap()
                .densify
                .iter()
                .all(|&v| v == 0.0),
            "nothing is collected yet"
        );
        trainer.collect_image_gradients();
        trainer.step(&[a, b], &settings).unwrap();
        let before = trainer.image_gradients().unwrap();
        let order = morton_order(&splats);
        trainer.reorder();
        let ordered = trainer.download_splats().unwrap();
        assert!(ordered == splats.gather(&order).unwrap() && ordered != splats);
        let moved: Vec<f32> = order
            .iter()
            .map(|&row| before.densify[row as usize])
            .collect();
        assert_eq!(
            trainer.image_gradients().unwrap().densify,
            moved,
            "sums follow their splats"
        );
        // what is drawn for another purpose is not seen
        trainer.colour_sums(&views, true, &|| false).unwrap();
        trainer.step(from_ref(&c), &settings).unwrap();
        let got = trainer.image_gradients().unwrap();
        let mut want = on_the_cpu(&ordered, &frames, &views, exposures);
        for (row, _) in order
            .iter()
            .enumerate()
            .filter(|(_, row)| FIXED_ROWS.contains(&(**row as usize)))
        {
            assert_eq!(got.densify[row], 0.0, "a fixed splat");
            want[row] = 0.0;
        }
        assert_means("two steps", &got.densify, &want);
        assert!(got.prune.iter().all(|&v| v == 0.0));

        // a round starts the sums anew, and so do other splats
        let config = DensityConfig {
            min_opacity: 0.0,
            ..DensityConfig::by_gradient()
        };
        let lengths = lengths(1.0);
        assert!(
            trainer
                .densify(&round(&[], &config, &lengths, NOTHING))
                .unwrap()
                .changes_nothing()
        );
        assert!(
            trainer
                .image_gradients()
                .unwrap()
                .densify
                .iter()
                .all(|&v| v == 0.0)
        );
        trainer.step(from_ref(&a), &settings).unwrap();
        let fewer = ordered.gather(&(0..400).collect::<Vec<u32>>()).unwrap();
        trainer.replace(&fewer, &AdamState::new(&fewer)).unwrap();
        assert_eq!(trainer.image_gradients().unwrap().densify, [0.0; 400]);
        trainer.step(from_ref(&b), &settings).unwrap();
        let want = on_the_cpu(&fewer, &frames, &views[1..2], exposures);
        assert_means(
            "fewer splats",
            &trainer.image_gradients().unwrap().densify,
            &want,
        );
    }
}

fn lengths(extent: f32) -> SceneScale {
    SceneScale {
        one_centre: false,
        extent,
        median_depth: 1.0,
        focal_px: 60.0,
        centres: vec![[0.0; 3]],
    }
}

/// A threshold that no mean is next to, with a third to two thirds of them above it, and how many
/// are.
fn threshold(means: &[f32]) -> (f32, usize) {
    let mut sorted = means.to_vec();
    sorted.sort_by(|a, b| b.total_cmp(a));
    let gap = |k: &usize| sorted[k - 1] / sorted[*k];
    let some = sorted.len() / 3..2 * sorted.len() / 3;
    let widest = some.max_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap();
    ((sorted[widest - 1] * sorted[widest]).sqrt(), widest)
}

#[test]
fn a_round_by_gradients_makes_the_splats_that_the_cpu_makes() {
    let Some(gpu) = gpu("density control by gradients") else {
        return;
    };
    let (splats, _) = start();
    let (frames, views) = clip();
    let (_, capture) = video();
    let rates = vec![0.0; LAYOUT.columns()];
    let settings = settings(&rates);
    let [a, b, c] = [0, 1, 2].map(|k| StepView::new(views[k].0, &views[k].1));
    let (middle, above) = threshold(&on_the_cpu(&splats, &frames, &views, &[]));
    let share = SplitSize::Extent { share: 1.0 };
    let of = |densify_threshold| DensityConfig {
        densify_threshold,
        split_size: share,
        min_opacity: 0.2,
        ..DensityConfig::by_gradient()
    };
    let free = Decision {
        densify: true,
        prune_by_score: false,
        prune_large: false,
        max_splats: usize::MAX,
    };
    let capped = Decision {
        max_splats: splats.n() + above,
        ..free
    };
    let batches = TrainConfig {
        batch: 2,
        ..TrainConfig::fast()
    };
    for (config, due) in [(of(middle), free), (of(0.0), capped)] {
        let scale = lengths(usual_size(&splats));
        let round = round(&[], &config, &scale, due);
        let run = |mut backend: Box<dyn Backend + '_>| {
            backend.collect_image_gradients();
            backend.set_frames(frames.to_vec()).unwrap();
            backend.upload(&splats, AdamState::new(&splats)).unwrap();
            backend.step(&[a, b], &settings).unwrap();
            backend.reorder().unwrap();
            backend.step(from_ref(&c), &settings).unwrap();
            let stats = backend.densify(&round).unwrap();
            (stats, backend.take().unwrap().0)
        };
        let (stats, want) = run(Box::new(CpuBackend::new(&capture, 0, SimdLevel::best())));
        let (same, got) = run(Box::new(GpuBackend::new(gpu.clone(), None, &batches)));
        assert_eq!(stats, same);
        assert!(
            stats.cloned > 20 && stats.split > 20 && stats.pruned > 20,
            "{stats:?}"
        );
        assert!(stats.cloned + stats.split <= above, "{stats:?}");
        for (i, (a, b)) in columns(&got).into_iter().zip(columns(&want)).enumerate() {
            assert!(
                (a - b).abs() <= 1e-4 * (1.0 + b.abs()),
                "number {i} is {a} for {b}"
            );
        }
        // to the digit, where the CPU decides by the device's own means
        let mut trainer = GpuTrainer::new(
            gpu.clone(),
            &splats,
            &AdamState::new(&splats),
            &frames,
            usize::MAX,
        )
        .unwrap();
        trainer.collect_image_gradients();
        trainer.step(&[a, b, c], &settings).unwrap();
        assert_eq!(
            check("by gradients", &mut trainer, &round).split,
            stats.split
        );
    }
}

/// What half of the splats exceed in their largest standard deviation, next to none of them.
fn usual_size(splats: &Splats) -> f32 {
    let scales = splats.layout().range(Column::LogScale).len();
    let largest = |row: usize| {
        (0..scales)
            .map(|k| splats.column(Column::LogScale, k)[row])
            .fold(f32::NEG_INFINITY, f32::max)
    };
    let mut sizes: Vec<f32> = (0..splats.n()).map(largest).collect();
    sizes.sort_by(f32::total_cmp);
    let half = sizes.len() / 2;
    (0.5 * (sizes[half - 1] + sizes[half])).exp()
}
