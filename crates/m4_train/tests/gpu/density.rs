//! Rounds of density control: the same splats are cloned, split and pruned as on the CPU.

use crate::gpu;
use crate::step::{LAMBDA, LAYOUT, columns, image, settings, start};
use m4_core::{Column, SplatLayout, Splats};
use m4_kernels::View;
use m4_kernels::adam::cpu::AdamState;
use m4_kernels::gpu::Gpu;
use m4_testkit::{SceneSpec, random_splats};
use m4_train::backend::StepView;
use m4_train::backend::gpu::GpuTrainer;
use m4_train::config::{CloneOpacity, ErrorRange, PruneRule, SplitPlacement, SplitSize};
use m4_train::density::{
    Decision, DensityRound, DensityStats, Origin, Rules, ScoreSettings, apply,
};
use m4_train::{DensityConfig, SceneScale};

const SCORES: ScoreSettings = ScoreSettings {
    lambda_ssim: LAMBDA,
    threshold: 0.3,
    range: ErrorRange::Quantile { high: 0.9 },
};

fn step(trainer: &mut GpuTrainer, view: &View) {
    let rates = vec![1e-3; trainer.download_splats().unwrap().layout().columns()];
    let settings = settings(&rates);
    trainer.step(&[StepView::new(0, view)], &settings).unwrap();
}

/// Splats that were moved twice, two frames, and views of them; one splat has no rotation, some are
/// next to opaque.
fn trainer(gpu: Gpu, isotropic: bool) -> (GpuTrainer, [(usize, View); 2]) {
    let (mut splats, view) = start();
    if isotropic {
        let spec = SceneSpec {
            layout: SplatLayout {
                isotropic,
                ..LAYOUT
            },
            n_static: 100,
            n_dynamic: 200,
            ..SceneSpec::default()
        };
        splats = random_splats(12, &view.camera, &spec);
    } else {
        (0..4).for_each(|k| splats.column_mut(Column::Quat, k)[7] = 0.0);
    }
    splats.column_mut(Column::Opacity, 0)[5..9].copy_from_slice(&[90.0, 30.0, 3.0, -95.0]);
    let frames = [image(0), image(2)];
    let mut trainer =
        GpuTrainer::new(gpu, &splats, &AdamState::new(&splats), &frames, usize::MAX).unwrap();
    step(&mut trainer, &view);
    step(&mut trainer, &view);
    let late = View { t: 6.5, ..view };
    (trainer, [(0, view), (1, late)])
}

fn scale(splats: &Splats, row: usize) -> [f32; 3] {
    let isotropic = splats.layout().isotropic;
    [0, 1, 2].map(|k| splats.column(Column::LogScale, if isotropic { 0 } else { k })[row].exp())
}

/// Everything is due, and splats may grow without limit.
pub const DUE: Decision = Decision {
    densify: true,
    prune_by_score: true,
    prune_large: false,
    max_splats: usize::MAX,
};

/// A round by these rules.
pub fn round<'a>(
    views: &'a [(usize, View)],
    config: &'a DensityConfig,
    scale: &'a SceneScale,
    due: Decision,
) -> DensityRound<'a> {
    DensityRound {
        views,
        scores: SCORES,
        rules: Rules {
            config,
            due,
            min_opacity: config.min_opacity,
            scale,
        },
        period: 9.0,
        seed: 11,
        iteration: 700,
    }
}

/// Does a round, compares it with that of the CPU, and returns its statistics.
pub fn check(what: &str, trainer: &mut GpuTrainer, round: &DensityRound<'_>) -> DensityStats {
    let (mut want, mut state) = trainer.download().unwrap();
    let scores = match round.rules.config.loss_guided {
        true => trainer.score(round.views, &round.scores).unwrap(),
        false => trainer.image_gradients().unwrap(),
    };
    let plan = round.rules.plan(&want, &scores);
    apply(
        round.rules.config,
        &plan,
        &mut want,
        &mut state,
        round.seed,
        round.iteration,
    )
    .unwrap();
    let stats = trainer.densify(round).unwrap();
    assert_eq!(
        (
            stats.cloned,
            stats.split,
            stats.pruned,
            stats.n_static,
            stats.n_dynamic
        ),
        (
            plan.cloned,
            plan.split,
            plan.pruned,
            want.n_static(),
            want.n_dynamic()
        ),
        "{what}"
    );
    let (got, after) = trainer.download().unwrap();
    assert!(after == state, "{what}: the optimiser's state");
    // random numbers go through a logarithm and a cosine
    let drawn =
        round.rules.config.split_placement == SplitPlacement::Sample || want.layout().isotropic;
    let tolerance = if drawn { 1e-4 } else { 2e-6 };
    for (i, (a, b)) in columns(&got).into_iter().zip(columns(&want)).enumerate() {
        assert!(
            (a - b).abs() <= tolerance * (1.0 + b.abs()),
            "{what}: number {i} is {a} for {b}"
        );
    }
    let survivors: Vec<u32> = (0..plan.rows.len() as u32)
        .filter(|&i| plan.origins[i as usize] == Origin::Kept)
        .collect();
    assert!(
        got.gather(&survivors).unwrap() == want.gather(&survivors).unwrap(),
        "{what}: those that stay"
    );
    stats
}

/// The middle of some numbers.
fn median(mut values: Vec<f32>) -> f32 {
    values.sort_by(f32::total_cmp);
    values[values.len() / 2]
}

#[test]
fn densify_and_prune_match_the_cpu() {
    let Some(gpu) = gpu("density control") else {
        return;
    };
    for isotropic in [false, true] {
        let (mut trainer, views) = trainer(gpu.clone(), isotropic);
        let splats = trainer.download_splats().unwrap();
        let eye = views[0].1.camera.centre();
        let usual = median(
            (0..splats.n())
                .map(|i| scale(&splats, i).into_iter().fold(0.0, f32::max))
                .collect(),
        );
        let lengths = SceneScale {
            one_centre: false,
            extent: usual,
            median_depth: 1.0,
            focal_px: 60.0,
            centres: vec![[eye.x as f32, eye.y as f32, eye.z as f32], [3.0, 0.0, 1.0]],
        };
        let careful = DensityConfig {
            densify_threshold: 0.01,
            budget: 1.0,
            prune_threshold: 0.1,
            prune_rule: PruneRule::WithOpacity {
                opacity: 0.4,
                quantile: 0.9,
            },
            min_opacity: 0.05,
            split_size: SplitSize::Pixels { pixels: 2.0 },
            clone_opacity: CloneOpacity::Share,
            ..DensityConfig::fast()
        };
        let few = Decision {
            max_splats: splats.n() + 60,
            ..DUE
        };
        let grown = check(
            "careful",
            &mut trainer,
            &round(&views, &careful, &lengths, few),
        );
        assert!(
            grown.cloned + grown.split == 60 && grown.pruned > 10,
            "{grown:?}"
        );
        let literal = DensityConfig {
            densify_threshold: 0.5,
            prune_threshold: 0.3,
            prune_rule: PruneRule::Literal,
            split_size: SplitSize::Extent { share: 1.0 },
            clone_opacity: CloneOpacity::Keep,
            ..careful.clone()
        };
        let grown = check(
            "literal",
            &mut trainer,
            &round(&views, &literal, &lengths, DUE),
        );
        assert!(
            grown.cloned > 10 && grown.split > 10 && grown.pruned > 5,
            "{grown:?}"
        );
        let drawn = DensityConfig {
            split_placement: SplitPlacement::Sample,
            ..careful.clone()
        };
        let grown = check("drawn", &mut trainer, &round(&views, &drawn, &lengths, DUE));
        assert!(grown.cloned > 10 && grown.split > 10, "{grown:?}");
        let wide = SceneScale {
            extent: 8.0 * usual,
            ..lengths.clone()
        };
        let large = Decision {
            densify: false,
            prune_by_score: false,
            prune_large: true,
            ..DUE
        };
        let grown = check(
            "large",
            &mut trainer,
            &round(&views, &careful, &wide, large),
        );
        assert!(grown.pruned > 10 && grown.n_dynamic > 10, "{grown:?}");
        // many scores are 0: the first of them grow
        let ties = DensityConfig {
            densify_threshold: -1.0,
            ..careful.clone()
        };
        let most = Decision {
            prune_by_score: false,
            max_splats: 2 * trainer.n() - 20,
            ..DUE
        };
        let grown = check("ties", &mut trainer, &round(&views, &ties, &lengths, most));
        assert!(grown.cloned > 10 && grown.split > 10, "{grown:?}");
        let last = DensityConfig {
            min_opacity: 0.3,
            ..careful
        };
        let nothing = Decision {
            densify: false,
            prune_by_score: false,
            prune_large: false,
            max_splats: 0,
        };
        let grown = check(
            "only opacity",
            &mut trainer,
            &round(&[], &last, &lengths, nothing),
        );
        assert!(
            grown.cloned + grown.split == 0 && grown.pruned > 10,
            "{grown:?}"
        );
        // and steps continue from there
        trainer.stats().unwrap();
        let before = trainer.download_splats().unwrap();
        step(&mut trainer, &views[0].1);
        assert!(
            trainer.download_splats().unwrap() != before
                && trainer.stats().unwrap().splats_are_finite
        );
    }
}

#[test]
fn a_set_of_splats_is_never_emptied_and_no_rule_changes_nothing() {
    let Some(gpu) = gpu("density control of nothing") else {
        return;
    };
    let (mut trainer, views) = trainer(gpu, false);
    let before = trainer.download().unwrap();
    let lengths = SceneScale {
        one_centre: false,
        extent: 1.0,
        median_depth: 1.0,
        focal_px: 60.0,
        centres: vec![[0.0; 3]],
    };
    let with = |min_opacity: f32| DensityConfig {
        densify_threshold: 0.0,
        min_opacity,
        split_size: SplitSize::Extent { share: 0.0 },
        ..DensityConfig::fast()
    };
    let nothing = Decision {
        densify: false,
        prune_by_score: false,
        prune_large: false,
        max_splats: 0,
    };
    let full = Decision {
        densify: true,
        ..nothing
    };
    for (min_opacity, due) in [(0.0, nothing), (2.0, nothing), (0.0, full)] {
        let config = with(min_opacity);
        let grown = trainer
            .densify(&round(&views, &config, &lengths, due))
            .unwrap();
        assert_eq!(
            (grown.cloned, grown.split, grown.pruned),
            (0, 0, 0),
            "{due:?}"
        );
        assert_eq!(
            (grown.n_static, grown.n_dynamic),
            (before.0.n_static(), before.0.n_dynamic())
        );
        assert!(trainer.download().unwrap() == before);
    }
    // none of the static ones is left
    let mut splats = before.0.clone();
    let n_static = splats.n_static();
    splats.column_mut(Column::Opacity, 0)[..n_static].fill(-20.0);
    splats.column_mut(Column::Opacity, 0)[n_static..].fill(2.0);
    trainer.replace(&splats, &AdamState::new(&splats)).unwrap();
    let config = with(0.1);
    let grown = trainer
        .densify(&round(&views, &config, &lengths, nothing))
        .unwrap();
    assert_eq!((grown.n_static, grown.n_dynamic), (0, before.0.n_dynamic()));
    assert_eq!(trainer.download_splats().unwrap().n(), before.0.n_dynamic());
}
