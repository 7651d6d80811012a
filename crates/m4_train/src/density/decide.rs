//! Turns scores into decisions and those into the rows of the next set of splats: pure functions,
//! so that they can be tested on synthetic scores.

use crate::{
    SceneScale,
    config::{DensityConfig, LARGE_EXTENT, LARGE_PX, PruneRule, SplitSize},
    density::{Scores, score::quantile},
};
use m4_core::{Column, Splats};

/// What a decision looks at besides the scores; all `[n]`.
#[derive(Debug, Clone, Copy)]
pub struct SplatView<'a> {
    /// How many rows are static.
    pub n_static: usize,
    /// Bound ones, which follow.
    pub n_bound: usize,
    /// Opacity, 0..1, without time.
    pub opacity: &'a [f32],
    /// True where the splat is large enough to be split rather than cloned.
    pub large: &'a [bool],
    /// True where it is too large to stay.
    pub oversized: &'a [bool],
}

/// Which rounds are due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Decision {
    /// Clone and split.
    pub densify: bool,
    /// Prune by score; the rule of opacity applies in every round.
    pub prune_by_score: bool,
    /// Prune what is too large.
    pub prune_large: bool,
    /// Most splats that the next set may have.
    pub max_splats: usize,
}

impl Decision {
    /// How many of `n` splats may be cloned or split: each makes one splat more.
    pub fn budget(&self, config: &DensityConfig, n: usize) -> usize {
        ((f64::from(config.budget) * n as f64) as usize).min(self.max_splats.saturating_sub(n))
    }
}

/// The splats to clone, split and prune.
///
/// A splat is densified when its score is above the threshold and among the best `budget`; ties go
/// to the lower row. Pruned are splats of low opacity and, when due, those that are too large and
/// those that the score rule names; in the literal rule a splat may be cloned and pruned in one
/// round, then its clone takes its place.
pub fn decide(
    config: &DensityConfig,
    due: Decision,
    splats: SplatView<'_>,
    scores: &Scores,
) -> Plan {
    let n = splats.opacity.len();
    let grows = if due.densify {
        best(config, &scores.densify, n, due.budget(config, n))
    } else {
        vec![false; n]
    };
    let by_score = if due.prune_by_score {
        pruned_by_score(config, splats.opacity, &scores.prune)
    } else {
        vec![false; n]
    };
    let literal = config.prune_rule == PruneRule::Literal;

    let mut plan = Plan::default();
    let n_still = splats.n_static + splats.n_bound;
    for rows in [0..splats.n_static, splats.n_static..n_still, n_still..n] {
        let mut new_splats: Vec<(u32, Origin)> = Vec::new();
        for row in rows {
            let hopeless = splats.opacity[row] < config.min_opacity
                || (due.prune_large && splats.oversized[row]);
            let mut add = |origin| {
                plan.rows.push(row as u32);
                plan.origins.push(origin);
            };
            if hopeless && !(grows[row] && splats.large[row]) {
                plan.pruned += 1;
            } else if grows[row] && splats.large[row] {
                new_splats.extend([
                    (row as u32, Origin::Child(0)),
                    (row as u32, Origin::Child(1)),
                ]);
                plan.split += 1;
            } else if grows[row] {
                new_splats.push((row as u32, Origin::Clone));
                plan.cloned += 1;
                if literal && by_score[row] {
                    plan.pruned += 1;
                } else {
                    add(Origin::Cloned);
                }
            } else if by_score[row] {
                plan.pruned += 1;
            } else {
                add(Origin::Kept);
            }
        }
        for (row, origin) in new_splats {
            plan.rows.push(row);
            plan.origins.push(origin);
        }
    }
    plan
}

/// True for the splats above the threshold that budget and cap allow.
fn best(config: &DensityConfig, scores: &[f32], n: usize, budget: usize) -> Vec<bool> {
    let mut above: Vec<u32> = (0..n as u32)
        .filter(|&i| scores[i as usize] > config.densify_threshold)
        .collect();
    if above.len() > budget {
        above.sort_unstable_by(|&a, &b| {
            scores[b as usize]
                .total_cmp(&scores[a as usize])
                .then(a.cmp(&b))
        });
        above.truncate(budget);
    }
    let mut out = vec![false; n];
    above.iter().for_each(|&i| out[i as usize] = true);
    out
}

/// True for the splats whose normalised score is above the threshold (Minute4D Eq. 10), as far as
/// the rule of opacity allows.
fn pruned_by_score(config: &DensityConfig, opacity: &[f32], scores: &[f32]) -> Vec<bool> {
    let (low, high) = match config.prune_rule {
        PruneRule::Literal => scores
            .iter()
            .fold((f32::INFINITY, 0.0f32), |(a, b), &s| (a.min(s), b.max(s))),
        PruneRule::WithOpacity { quantile: q, .. } => {
            let some: Vec<f32> = scores.iter().copied().filter(|s| *s > 0.0).collect();
            let low = some.iter().copied().fold(f32::INFINITY, f32::min);
            (low, quantile(&some, q))
        }
    };
    if high <= low {
        return vec![false; scores.len()];
    }
    scores
        .iter()
        .zip(opacity)
        .map(|(&s, &o)| {
            let s = ((s - low) / (high - low)).clamp(0.0, 1.0);
            match config.prune_rule {
                PruneRule::Literal => s > config.prune_threshold,
                PruneRule::WithOpacity { opacity, .. } => s > config.prune_threshold && o < opacity,
            }
        })
        .collect()
}

/// What a round goes by.
#[derive(Debug, Clone, Copy)]
pub struct Rules<'a> {
    /// Thresholds and budgets.
    pub config: &'a DensityConfig,
    /// What is due.
    pub due: Decision,
    /// Splats of a lower opacity go; instead of that of [`config`](Self::config).
    pub min_opacity: f32,
    /// The lengths that sizes are measured in.
    pub scale: &'a SceneScale,
}

impl Rules<'_> {
    /// What becomes of `splats` with these scores, `[n]` each.
    pub fn plan(&self, splats: &Splats, scores: &Scores) -> Plan {
        let mut config = self.config.clone();
        config.min_opacity = self.min_opacity;
        let n = splats.n();
        let scales = splats.layout().range(Column::LogScale).len();
        let largest: Vec<f32> = (0..n)
            .map(|i| {
                (0..scales)
                    .map(|k| splats.column(Column::LogScale, k)[i])
                    .fold(f32::NEG_INFINITY, f32::max)
                    .exp()
            })
            .collect();
        let mean = |i: usize| [0, 1, 2].map(|k| splats.column(Column::Mean, k)[i]);
        let limit = |i: usize| match config.split_size {
            SplitSize::Extent { share } => share * self.scale.extent,
            SplitSize::Pixels { pixels } => {
                pixels * self.scale.nearest_camera(mean(i)) / self.scale.focal_px
            }
        };
        let large: Vec<bool> = (0..n).map(|i| largest[i] > limit(i)).collect();
        let too_large = |i: usize| {
            let pixel = self.scale.nearest_camera(mean(i)) / self.scale.focal_px;
            largest[i] > LARGE_EXTENT * self.scale.extent || largest[i] > LARGE_PX / 3.0 * pixel
        };
        let oversized: Vec<bool> = (0..n)
            .map(|i| self.due.prune_large && too_large(i))
            .collect();
        let opacity: Vec<f32> = splats
            .column(Column::Opacity, 0)
            .iter()
            .map(|&l| 1.0 / (1.0 + (-l).exp()))
            .collect();
        let view = SplatView {
            n_static: splats.n_static(),
            n_bound: splats.bindings().len(),
            opacity: &opacity,
            large: &large,
            oversized: &oversized,
        };
        decide(&config, self.due, view, scores)
    }
}

/// Where a row of the next set comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// It is the splat it was.
    Kept,
    /// It is the splat it was, and a clone of it exists now.
    Cloned,
    /// A copy of a splat.
    Clone,
    /// One of the two children of a splat that is gone.
    Child(u8),
}

impl Origin {
    /// True for rows whose optimiser state starts from nothing.
    #[must_use]
    pub fn is_new(self) -> bool {
        matches!(self, Self::Clone | Self::Child(_))
    }
}

/// The next set of splats: static rows first.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Plan {
    /// The row of the old set that each row is taken from.
    pub rows: Vec<u32>,
    /// What becomes of it.
    pub origins: Vec<Origin>,
    /// Splats that were cloned.
    pub cloned: usize,
    /// Splats that were split.
    pub split: usize,
    /// Splats that were pruned.
    pub pruned: usize,
}

impl Plan {
    /// True where the row is new splat, `[rows]`.
    pub fn is_new(&self) -> Vec<bool> {
        self.origins.iter().map(|o| o.is_new()).collect()
    }

    /// True when the next set is the old one.
    pub fn changes_nothing(&self) -> bool {
        self.cloned + self.split + self.pruned == 0
    }
}

#[cfg(test)]
mod tests {
    use super::{Decision, SplatView, decide};
    use crate::{
        config::{DensityConfig, PruneRule},
        density::{Origin, Scores},
    };

    const DUE: Decision = Decision {
        densify: true,
        prune_by_score: true,
        prune_large: true,
        max_splats: 1000,
    };

    const NONE: [bool; 100] = [false; 100];

    fn scores(densify: &[f32], prune: &[f32]) -> Scores {
        Scores {
            densify: densify.to_vec(),
            prune: prune.to_vec(),
        }
    }

    #[test]
    fn small_splats_are_cloned_and_large_ones_split() {
        let config = DensityConfig {
            budget: 1.0,
            ..DensityConfig::fast()
        };
        let view = SplatView {
            n_static: 2,
            n_bound: 0,
            opacity: &[0.5; 4],
            large: &[false, true, false, true],
            oversized: &NONE,
        };
        let due = Decision {
            prune_by_score: false,
            ..DUE
        };
        let plan = decide(
            &config,
            due,
            view,
            &scores(&[1.0, 0.0, 0.0005, 2.0], &[0.0; 4]),
        );
        assert_eq!(plan.rows, [0, 1, 0, 2, 3, 3]);
        use Origin::{Child, Clone, Cloned, Kept};
        assert_eq!(
            plan.origins,
            [Cloned, Kept, Clone, Kept, Child(0), Child(1)]
        );
        assert_eq!((plan.cloned, plan.split, plan.pruned), (1, 1, 0));
        assert_eq!(plan.is_new(), [false, false, true, false, true, true]);
    }

    #[test]
    fn the_budget_takes_the_worst_and_the_cap_holds() {
        let config = DensityConfig {
            budget: 0.5,
            ..DensityConfig::fast()
        };
        let n = 10;
        let densify: Vec<f32> = (0..n).map(|i| 1.0 + ((i * 7) % n) as f32).collect();
        let view = SplatView {
            n_static: n,
            n_bound: 0,
            opacity: &vec![0.5; n],
            large: &vec![false; n],
            oversized: &NONE,
        };
        let count = |max_splats| {
            let plan = decide(
                &config,
                Decision { max_splats, ..DUE },
                view,
                &scores(&densify, &vec![0.0; n]),
            );
            let worst = plan
                .origins
                .iter()
                .zip(&plan.rows)
                .filter(|(o, _)| **o == Origin::Clone);
            assert!(worst.map(|(_, &r)| densify[r as usize]).all(|s| s > 5.0));
            plan.rows.len()
        };
        assert_eq!(count(1000), 15);
        assert_eq!(count(12), 12);
        assert_eq!(
            count(3),
            10,
            "a cap below the count adds none and removes none"
        );
    }

    #[test]
    fn pruning_spares_parents_of_clones_and_opaque_splats() {
        let config = DensityConfig {
            budget: 1.0,
            prune_rule: PruneRule::WithOpacity {
                opacity: 0.1,
                quantile: 0.999,
            },
            ..DensityConfig::fast()
        };
        // 100 splats whose scores rise; the last is transparent as dust
        let mut opacity = vec![0.5; 100];
        opacity[10] = 0.05; // low score
        opacity[60] = 0.05; // above the threshold and dim: goes
        opacity[99] = 0.001; // goes by opacity
        let prune: Vec<f32> = (0..100)
            .map(|i| if i == 10 { 0.0 } else { i as f32 * 0.1 })
            .collect();
        let mut densify = vec![0.0; 100];
        densify[98] = 1.0; // among the highest prune scores, but a parent
        let view = SplatView {
            n_static: 40,
            n_bound: 0,
            opacity: &opacity,
            large: &[false; 100],
            oversized: &NONE,
        };
        let plan = decide(&config, DUE, view, &scores(&densify, &prune));
        let gone: Vec<u32> = (0..100).filter(|r| !plan.rows.contains(r)).collect();
        assert_eq!(gone, [60, 99]);
        assert_eq!(plan.rows.iter().filter(|&&r| r == 98).count(), 2);
        assert_eq!(plan.rows.len() + plan.pruned - plan.cloned, 100);
    }

    #[test]
    fn the_literal_rule_cuts_the_tail() {
        let config = DensityConfig::literal();
        let view = SplatView {
            n_static: 0,
            n_bound: 0,
            opacity: &[0.5; 4],
            large: &[false; 4],
            oversized: &NONE,
        };
        let plan = decide(
            &config,
            DUE,
            view,
            &scores(&[0.0, 0.0, 0.5, 0.0], &[0.0, 0.5, 100.0, 50.0]),
        );
        // row 1: 0.5 / 100 stays; row 2: pruned, its clone takes its place; row 3: pruned
        assert_eq!(plan.rows, [0, 1, 2]);
        assert_eq!(plan.origins, [Origin::Kept, Origin::Kept, Origin::Clone]);
        assert_eq!(plan.pruned, 2);
    }

    /// Both scores lie between the two thresholds of the paper, 0.001 and 0.009: high enough to
    /// clone, too low to prune.
    #[test]
    fn each_score_has_its_own_threshold() {
        for config in [DensityConfig::fast(), DensityConfig::faithful()] {
            let config = DensityConfig {
                budget: 1.0,
                min_opacity: 0.0,
                ..config
            };
            // as low as score pruning of `fast` wants it
            let view = SplatView {
                n_static: 5,
                n_bound: 0,
                opacity: &[0.004; 5],
                large: &[false; 5],
                oversized: &NONE,
            };
            let plan = decide(
                &config,
                DUE,
                view,
                &scores(&[0.005, 0.0005, 0.0, 0.0, 0.0], &[0.0; 5]),
            );
            assert_eq!(
                (plan.cloned, plan.pruned, &plan.rows[..]),
                (1, 0, &[0, 1, 2, 3, 4, 0][..]),
                "{config:?}"
            );
            // normalised by the largest, which two have for the quantile of `fast`: 0.005, 0.02 and
            // 1
            let plan = decide(
                &config,
                DUE,
                view,
                &scores(&[0.0; 5], &[1e-6, 0.5, 2.0, 100.0, 100.0]),
            );
            assert_eq!(
                (plan.cloned, plan.pruned, &plan.rows[..]),
                (0, 3, &[0, 1][..]),
                "{config:?}"
            );
        }
    }

    #[test]
    fn what_is_too_large_goes_unless_it_is_split() {
        let view = SplatView {
            n_static: 4,
            n_bound: 0,
            opacity: &[0.5; 4],
            large: &[false, true, true, false],
            oversized: &[false, true, true, false],
        };
        let config = DensityConfig {
            budget: 1.0,
            ..DensityConfig::by_gradient()
        };
        let due = Decision {
            prune_by_score: false,
            ..DUE
        };
        let plan = decide(
            &config,
            due,
            view,
            &scores(&[0.0, 0.0, 1.0, 0.0], &[0.0; 4]),
        );
        assert_eq!(
            (&plan.rows[..], plan.split, plan.pruned),
            (&[0, 3, 2, 2][..], 1, 1)
        );
        let due = Decision {
            prune_large: false,
            ..due
        };
        assert_eq!(
            decide(&config, due, view, &scores(&[0.0; 4], &[0.0; 4])).pruned,
            0
        );
    }

    #[test]
    fn zero_scores_keep_every_splat() {
        let view = SplatView {
            n_static: 1,
            n_bound: 0,
            opacity: &[0.5; 3],
            large: &[true; 3],
            oversized: &NONE,
        };
        let plan = decide(
            &DensityConfig::fast(),
            DUE,
            view,
            &scores(&[0.0; 3], &[0.0; 3]),
        );
        assert!(plan.changes_nothing());
        assert_eq!(plan.rows, [0, 1, 2]);
    }
}
