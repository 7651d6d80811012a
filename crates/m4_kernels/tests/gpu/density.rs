//! Rounds of density control: who is cloned, split and pruned, and what becomes of them.

use crate::gpu;
use crate::step::{LAMBDA, LAYOUT, columns, picture, start};
use m4_core::{
    Column, SplatLayout, Splats,
    nalgebra::{Quaternion, UnitQuaternion, Vector3},
};
use m4_kernels::View;
use m4_kernels::adam::cpu::{AdamConfig, AdamState};
use m4_kernels::gpu::{
    DensifyStats, DensityRound, Gpu, GrowRule, PruneRule, ScoreRange, ScoreSettings, ScoreSums, SplitSize,
    StepSettings, Trainer,
};
use m4_testkit::{SceneSpec, random_splats};

const SCORES: ScoreSettings = ScoreSettings {
    lambda_ssim: LAMBDA,
    threshold: 0.3,
    range: ScoreRange::Quantile { high: 0.9 },
};

/// A row of the next splats and what it is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Row {
    Kept,
    Cloned,
    Clone,
    Half(f32),
}

fn step(trainer: &mut Trainer, view: &View) {
    let rates = vec![1e-3; trainer.download_splats().unwrap().layout().columns()];
    let settings = StepSettings {
        lambda_ssim: LAMBDA,
        rates: &rates,
        adam: AdamConfig::default(),
    };
    trainer.step(0, view, &settings).unwrap();
}

/// Splats that were moved twice, two frames, and looks at them; one splat has no rotation, some are next to opaque.
fn trainer(gpu: Gpu, isotropic: bool) -> (Trainer, [(usize, View); 2]) {
    let (mut splats, view) = start();
    if isotropic {
        let spec = SceneSpec {
            layout: SplatLayout { isotropic, ..LAYOUT },
            n_static: 100,
            n_dynamic: 200,
            ..SceneSpec::default()
        };
        splats = random_splats(12, &view.camera, &spec);
    } else {
        (0..4).for_each(|k| splats.column_mut(Column::Quat, k)[7] = 0.0);
    }
    splats.column_mut(Column::Opacity, 0)[5..9].copy_from_slice(&[90.0, 30.0, 3.0, -95.0]);
    let frames = [picture(0), picture(2)];
    let mut trainer = Trainer::new(gpu, &splats, &AdamState::new(&splats), &frames, usize::MAX).unwrap();
    step(&mut trainer, &view);
    step(&mut trainer, &view);
    let late = View { t: 6.5, ..view };
    (trainer, [(0, view), (1, late)])
}

fn scale(splats: &Splats, row: usize) -> [f32; 3] {
    let isotropic = splats.layout().isotropic;
    [0, 1, 2].map(|k| splats.column(Column::LogScale, if isotropic { 0 } else { k })[row].exp())
}

fn pruned_by_score(rule: PruneRule, opacity: &[f32], scores: &[f32]) -> Vec<bool> {
    let mut some: Vec<f32> = scores.to_vec();
    some.sort_by(f32::total_cmp);
    let (low, high) = match rule {
        PruneRule::Literal { .. } => (some[0], some[some.len() - 1]),
        PruneRule::WithOpacity { quantile, .. } => {
            some.retain(|&s| s > 0.0);
            (some[0], some[((some.len() - 1) as f32 * quantile) as usize])
        }
    };
    let share = |s: f32| ((s - low) / (high - low)).clamp(0.0, 1.0);
    let gone = |(&s, &o): (&f32, &f32)| match rule {
        PruneRule::Literal { threshold } => share(s) > threshold,
        PruneRule::WithOpacity { threshold, opacity, .. } => share(s) > threshold && o < opacity,
    };
    scores.iter().zip(opacity).map(gone).collect()
}

/// The rows of the next splats, and what was done.
fn planned(splats: &Splats, round: &DensityRound<'_>, scores: &ScoreSums) -> (Vec<(u32, Row)>, DensifyStats) {
    let (n, n_static) = (splats.n(), splats.n_static());
    let logits = splats.column(Column::Opacity, 0);
    let opacity: Vec<f32> = logits.iter().map(|&l| 1.0 / (1.0 + (-l).exp())).collect();
    let mut grows = vec![false; n];
    if let Some(rule) = round.grow {
        let score = |i: usize| scores.densify[i];
        let mut best: Vec<usize> = (0..n).filter(|&i| score(i) > rule.threshold).collect();
        best.sort_by(|&a, &b| score(b).total_cmp(&score(a)).then(a.cmp(&b)));
        best.iter().take(rule.budget).for_each(|&i| grows[i] = true);
    }
    let by_score = match round.prune {
        Some(rule) => pruned_by_score(rule, &opacity, &scores.prune),
        None => vec![false; n],
    };
    let literal = matches!(round.prune, Some(PruneRule::Literal { .. }));
    let (mut out, mut grown) = (Vec::new(), DensifyStats::default());
    for range in [0..n_static, n_static..n] {
        let mut born = Vec::new();
        for i in range {
            let largest = scale(splats, i).into_iter().fold(0.0, f32::max);
            let limit = match round.split_size {
                SplitSize::Everywhere(limit) => limit,
                SplitSize::Pixels {
                    pixels,
                    focal_px,
                    centres,
                } => {
                    let place = [0, 1, 2].map(|k| splats.column(Column::Mean, k)[i]);
                    let square = |c: &[f32; 3]| (0..3).map(|k| (c[k] - place[k]).powi(2)).sum::<f32>();
                    pixels * centres.iter().map(square).fold(f32::MAX, f32::min).sqrt() / focal_px
                }
            };
            let hopeless = opacity[i] < round.min_opacity;
            let row = i as u32;
            if grows[i] && largest > limit {
                born.extend([(row, Row::Half(1.0)), (row, Row::Half(-1.0))]);
                grown.split += 1;
            } else if hopeless || (by_score[i] && !grows[i]) {
                grown.pruned += 1;
            } else if grows[i] {
                born.push((row, Row::Clone));
                grown.cloned += 1;
                match literal && by_score[i] {
                    true => grown.pruned += 1,
                    false => out.push((row, Row::Cloned)),
                }
            } else {
                out.push((row, Row::Kept));
            }
        }
        out.extend(born);
    }
    grown.n_static = out.iter().filter(|(row, _)| (*row as usize) < n_static).count();
    grown.n_dynamic = out.len() - grown.n_static;
    (out, grown)
}

/// What a row becomes.
fn become_new(splats: &mut Splats, row: usize, what: Row, share_opacity: bool) {
    if let Row::Half(sign) = what {
        let (s, isotropic) = (scale(splats, row), splats.layout().isotropic);
        let axis = (1..3).fold(0, |best, k| if s[k] > s[best] { k } else { best });
        let mut shift = Vector3::zeros();
        shift[axis] = sign * 0.6 * s[axis];
        if !isotropic {
            let [w, x, y, z] = [0, 1, 2, 3].map(|k| splats.column(Column::Quat, k)[row]);
            if [w, x, y, z] != [0.0; 4] {
                shift = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)) * shift;
            }
        }
        (0..3).for_each(|k| splats.column_mut(Column::Mean, k)[row] += shift[k]);
        splats.column_mut(Column::LogScale, if isotropic { 0 } else { axis })[row] += 0.8f32.ln();
    }
    if share_opacity && what != Row::Kept {
        let logit = &mut splats.column_mut(Column::Opacity, 0)[row];
        let o = (1.0 - (1.0 / (1.0 + logit.exp())).sqrt()).clamp(1e-6, 1.0 - 1e-6);
        *logit = (o / (1.0 - o)).ln();
    }
}

/// Does a round, compares it with that of the processor, and says what it did.
fn check(what: &str, trainer: &mut Trainer, round: &DensityRound<'_>) -> DensifyStats {
    let (splats, adam) = trainer.download().unwrap();
    let scores = trainer.score(round.looks, &round.scores).unwrap();
    let (rows, grown) = planned(&splats, round, &scores);
    assert_eq!(trainer.densify(round).unwrap(), grown, "{what}");

    let sources: Vec<u32> = rows.iter().map(|row| row.0).collect();
    let mut want = splats.gather(&sources).unwrap();
    let mut state = AdamState {
        m: adam.m.gather(&sources).unwrap(),
        v: adam.v.gather(&sources).unwrap(),
        step: sources.iter().map(|&r| adam.step[r as usize]).collect(),
    };
    for (i, &(_, row)) in rows.iter().enumerate() {
        become_new(&mut want, i, row, round.share_opacity);
        if matches!(row, Row::Clone | Row::Half(_)) {
            state.forget(i);
        }
    }
    let (got, after) = trainer.download().unwrap();
    assert!(after == state, "{what}: the optimiser's state");
    assert_eq!((got.n_static(), got.n_dynamic()), (grown.n_static, grown.n_dynamic));
    for (i, (a, b)) in columns(&got).into_iter().zip(columns(&want)).enumerate() {
        assert!(
            (a - b).abs() <= 2e-6 * (1.0 + b.abs()),
            "{what}: number {i} is {a} for {b}"
        );
    }
    let kept: Vec<u32> = (0..rows.len() as u32)
        .filter(|&i| rows[i as usize].1 == Row::Kept)
        .collect();
    assert!(
        got.gather(&kept).unwrap() == want.gather(&kept).unwrap(),
        "{what}: those that stay"
    );
    grown
}

/// The middle of some numbers.
fn median(mut values: Vec<f32>) -> f32 {
    values.sort_by(f32::total_cmp);
    values[values.len() / 2]
}

#[test]
fn densify_and_prune_match_the_cpu() {
    let Some(gpu) = gpu("density control") else { return };
    for isotropic in [false, true] {
        let (mut trainer, looks) = trainer(gpu.clone(), isotropic);
        let splats = trainer.download_splats().unwrap();
        let eye = looks[0].1.camera.centre();
        let centres = [[eye.x as f32, eye.y as f32, eye.z as f32], [3.0, 0.0, 1.0]];
        let usual = median(
            (0..splats.n())
                .map(|i| scale(&splats, i).into_iter().fold(0.0, f32::max))
                .collect(),
        );
        let careful = DensityRound {
            looks: &looks,
            scores: SCORES,
            grow: Some(GrowRule {
                threshold: 0.01,
                budget: 60,
            }),
            prune: Some(PruneRule::WithOpacity {
                threshold: 0.1,
                opacity: 0.4,
                quantile: 0.9,
            }),
            min_opacity: 0.05,
            split_size: SplitSize::Pixels {
                pixels: 2.0,
                focal_px: 60.0,
                centres: &centres,
            },
            share_opacity: true,
        };
        let grown = check("careful", &mut trainer, &careful);
        assert!(grown.cloned + grown.split == 60 && grown.pruned > 10, "{grown:?}");
        let literal = DensityRound {
            grow: Some(GrowRule {
                threshold: 0.5,
                budget: usize::MAX,
            }),
            prune: Some(PruneRule::Literal { threshold: 0.3 }),
            split_size: SplitSize::Everywhere(usual),
            share_opacity: false,
            ..careful
        };
        let grown = check("literal", &mut trainer, &literal);
        assert!(grown.cloned > 10 && grown.split > 10 && grown.pruned > 5, "{grown:?}");
        // many scores are 0: the first of them grow
        let ties = DensityRound {
            grow: Some(GrowRule {
                threshold: -1.0,
                budget: trainer.download_splats().unwrap().n() - 20,
            }),
            prune: None,
            ..careful
        };
        let grown = check("ties", &mut trainer, &ties);
        assert!(grown.cloned > 10 && grown.split > 10, "{grown:?}");
        let last = DensityRound {
            looks: &[],
            grow: None,
            prune: None,
            min_opacity: 0.3,
            ..careful
        };
        let grown = check("only opacity", &mut trainer, &last);
        assert!(grown.cloned + grown.split == 0 && grown.pruned > 10, "{grown:?}");
        // and steps continue from there
        trainer.found().unwrap();
        let before = trainer.download_splats().unwrap();
        step(&mut trainer, &looks[0].1);
        assert!(trainer.download_splats().unwrap() != before && trainer.found().unwrap().splats_are_finite);
    }
}

#[test]
fn a_set_of_splats_is_never_emptied_and_no_rule_changes_nothing() {
    let Some(gpu) = gpu("density control of nothing") else {
        return;
    };
    let (mut trainer, looks) = trainer(gpu, false);
    let before = trainer.download().unwrap();
    let nothing = DensityRound {
        looks: &looks,
        scores: SCORES,
        grow: None,
        prune: None,
        min_opacity: 0.0,
        split_size: SplitSize::Everywhere(0.0),
        share_opacity: true,
    };
    let everybody = DensityRound {
        min_opacity: 2.0,
        ..nothing
    };
    let full = DensityRound {
        grow: Some(GrowRule {
            threshold: 0.0,
            budget: 0,
        }),
        ..nothing
    };
    for round in [nothing, everybody, full] {
        let grown = trainer.densify(&round).unwrap();
        assert_eq!((grown.cloned, grown.split, grown.pruned), (0, 0, 0), "{round:?}");
        assert_eq!(
            (grown.n_static, grown.n_dynamic),
            (before.0.n_static(), before.0.n_dynamic())
        );
        assert!(trainer.download().unwrap() == before);
    }
    // none of the static ones is left
    let no_static = |round: &DensityRound<'_>, trainer: &mut Trainer| {
        let mut splats = before.0.clone();
        let n_static = splats.n_static();
        splats.column_mut(Column::Opacity, 0)[..n_static].fill(-20.0);
        splats.column_mut(Column::Opacity, 0)[n_static..].fill(2.0);
        trainer.replace(&splats, &AdamState::new(&splats)).unwrap();
        trainer.densify(round).unwrap()
    };
    let grown = no_static(
        &DensityRound {
            min_opacity: 0.1,
            ..nothing
        },
        &mut trainer,
    );
    assert_eq!((grown.n_static, grown.n_dynamic), (0, before.0.n_dynamic()));
    assert_eq!(trainer.download_splats().unwrap().n(), before.0.n_dynamic());
}
