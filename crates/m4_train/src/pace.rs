//! Estimates how many iterations fit into a time budget on this machine.

use crate::{
    ColourDegree, TrainError,
    backend::{BackendError, BackendMaker},
    colour_fit::frames_drawn,
    config::{DensityConfig, RefineConfig, TrainConfig},
    scale::SceneScale,
    trainer::Trainer,
};
use m4_core::{Capture, Column, Splats, median};
use m4_kernels::SimdLevel;
use rayon::prelude::*;
use std::time::Instant;

/// Trial steps; the first of them prepare memory and are not counted.
const STEPS: usize = 16;
const WARM_UP: usize = 4;
/// Share of the time that is planned with; the rest is for density control, checks, checkpoints and
/// saving the scene, and for what other programs take away.
const PLANNED: f64 = 0.92;
/// Trial steps have at most this multiple of the first splats, whatever the settings allow.
const MOST_GROWTH: f64 = 4.0;
/// Fewer iterations than this are no training.
const LEAST: usize = 50;
/// The paper's number. Held-out views gain tenths of a decibel from 200 to as many; a GPU would
/// take tens of thousands in a minute.
const MOST: usize = 5000;

/// The number of iterations that take `seconds()`, asked after the trial steps, on rayon's current
/// pool, or on a `backend`: trial steps on a copy of `splats` with what density control may add,
/// and on one with all colour coefficients. A multiple of 10, at least 50 and at most 5,000. Unlike
/// everything else in this crate it depends on the machine: with the number that it returns,
/// training is a function of its inputs again. Once `stopped()` no more steps are taken, and the
/// number means nothing. Fails as [`Trainer::new`] and [`Trainer::run`].
pub fn affordable_iterations(
    capture: &Capture,
    splats: &Splats,
    config: &TrainConfig,
    level: SimdLevel,
    backend: Option<BackendMaker<'_>>,
    seconds: impl Fn() -> f64,
    stopped: &dyn Fn() -> bool,
) -> Result<usize, TrainError> {
    if capture.frames.is_empty() {
        return Err(TrainError::NoFrames);
    }
    let mut trial_splats = grown(splats, &apparent_sizes(capture, splats), config)?;
    let mut step_s = trial(capture, &trial_splats, config, level, backend, stopped)?;
    let layout = trial_splats.layout();
    let raised = config.colour_degree.raise(layout);
    if raised != layout && !stopped() {
        trial_splats.raise_degrees(raised.sh_degree, raised.time_degree);
        // what later parts of the run have in addition
        let more_s = trial(capture, &trial_splats, config, level, backend, stopped)? - step_s;
        step_s += config.colour_degree.mean_share(layout) * more_s.max(0.0);
    }
    let fits = frames_drawn(config.colour_fit_rounds, capture.frames.len()) / config.batch as f64;
    Ok(count(seconds(), step_s, fits))
}

/// Iterations of `step_s` that take `seconds` with as many steps besides as `fits`.
fn count(seconds: f64, step_s: f64, fits: f64) -> usize {
    let all = (PLANNED * seconds / step_s.max(1e-6) - fits).max(0.0) as usize;
    (all / 10 * 10).clamp(LEAST, MOST)
}

/// The splats that density control may make of these: most of a run has as many. What is wrong is
/// mostly in what is static, and added up over the pixels, so the static rows that look largest
/// (`size`, one per row) are there twice; where each of them twice is not enough, all rows are
/// repeated, as often as it takes.
fn grown(splats: &Splats, size: &[f32], config: &TrainConfig) -> Result<Splats, TrainError> {
    let (n, n_static) = (splats.n(), splats.n_static());
    let growth = match config.density.enabled {
        true => f64::from(config.density.max_growth).clamp(1.0, MOST_GROWTH),
        false => 1.0,
    };
    let wanted = (growth * n as f64) as usize;
    let mut rows: Vec<u32> = (0..n_static as u32).collect();
    if wanted - n <= n_static {
        rows.sort_by(|&a, &b| size[b as usize].total_cmp(&size[a as usize]));
        rows.extend_from_within(..wanted - n);
        rows.extend(n_static as u32..n as u32);
    } else {
        let evenly = |first: usize, of: usize, count: usize| {
            (0..count).map(move |i| (first + i * of / count) as u32)
        };
        let statics = (n_static as f64 * growth) as usize;
        rows = evenly(0, n_static, statics)
            .chain(evenly(n_static, n - n_static, wanted - statics))
            .collect();
    }
    Ok(splats.gather(&rows)?)
}

/// How large each splat looks from the camera next to it: standard deviation along its longest axis
/// over distance.
fn apparent_sizes(capture: &Capture, splats: &Splats) -> Vec<f32> {
    let scale = SceneScale::of(capture);
    let mean = [0, 1, 2].map(|k| splats.column(Column::Mean, k));
    let scales: Vec<&[f32]> = (0..splats.layout().range(Column::LogScale).len())
        .map(|k| splats.column(Column::LogScale, k))
        .collect();
    let one = |i: usize| {
        let largest = scales
            .iter()
            .map(|c| c[i])
            .fold(f32::NEG_INFINITY, f32::max);
        largest.exp() / scale.nearest_camera(mean.map(|c| c[i]))
    };
    (0..splats.n_static()).into_par_iter().map(one).collect()
}

/// Median seconds of a step; where steps return before they are done, the mean. 0 once `stopped()`.
fn trial(
    capture: &Capture,
    splats: &Splats,
    config: &TrainConfig,
    level: SimdLevel,
    backend: Option<BackendMaker<'_>>,
    stopped: &dyn Fn() -> bool,
) -> Result<f64, TrainError> {
    let config = TrainConfig {
        // never the last: that one does more
        iterations: STEPS + 1,
        density: DensityConfig {
            enabled: false,
            ..config.density.clone()
        },
        // those of the splats
        colour_degree: ColourDegree::default(),
        colour_fit_rounds: 0,
        refine: RefineConfig {
            from: 0,
            ..config.refine.clone()
        },
        ..config.clone()
    };
    if stopped() {
        return Ok(0.0);
    }
    let mut trainer = Trainer::new(capture, splats.clone(), config, level)?;
    if let Some(make) = backend {
        let backend = make().map_err(|BackendError(why)| TrainError::Device {
            why,
            iteration: 0,
            good_iteration: 0,
        })?;
        trainer.use_backend(backend)?;
    }
    let counted = STEPS - WARM_UP;
    // steps that return before they are done are timed together
    let parts = match trainer.is_synchronous() {
        true => vec![1; counted],
        false => vec![counted],
    };
    let mut steps = |count: usize| -> Result<f64, TrainError> {
        let start = Instant::now();
        for _ in 0..count {
            if stopped() {
                break;
            }
            trainer.step()?;
        }
        trainer.report()?;
        Ok(start.elapsed().as_secs_f64() / count as f64)
    };
    steps(WARM_UP)?;
    let mut times = parts
        .into_iter()
        .map(&mut steps)
        .collect::<Result<Vec<f64>, _>>()?;
    Ok(median(&mut times).unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use super::{count, grown};
    use crate::TrainConfig;
    use m4_core::{Column, SplatLayout, Splats};

    #[test]
    fn a_budget_ends_at_the_papers_number() {
        assert_eq!(
            [
                count(10.0, 0.01, 12.0),
                count(60.0, 4e-4, 64.0),
                count(1.0, 0.5, 0.0)
            ],
            [900, 5000, 50]
        );
    }

    #[test]
    fn trial_steps_have_as_many_splats_as_the_run_will() {
        let layout = SplatLayout {
            isotropic: false,
            sh_degree: 0,
            time_degree: 0,
        };
        let mut splats = Splats::zeros(layout, 100, 400);
        let size: Vec<f32> = (0..100).map(|i| (i % 10) as f32).collect();
        splats.column_mut(Column::Mean, 0)[..100].copy_from_slice(&size);
        let grown = |splats: &Splats, config: &TrainConfig| grown(splats, &size, config).unwrap();
        let mut config = TrainConfig::fast();
        (config.density.enabled, config.density.max_growth) = (true, 1.1);
        let more = grown(&splats, &config);
        assert_eq!((more.n_static(), more.n_dynamic()), (150, 400));
        let sum: f32 = more.column(Column::Mean, 0)[..150].iter().sum();
        assert_eq!(
            sum,
            450.0 + 10.0 * (9.0 + 8.0 + 7.0 + 6.0 + 5.0),
            "the largest are there twice"
        );
        config.density.max_growth = 3.0;
        let more = grown(&splats, &config);
        assert_eq!(
            (more.n_static(), more.n_dynamic()),
            (300, 1200),
            "every row thrice"
        );
        config.density.max_growth = 1e9;
        assert_eq!(grown(&splats, &config).n(), 2000);
        config.density.enabled = false;
        assert_eq!(grown(&splats, &config).n(), 500);
        (config.density.enabled, config.density.max_growth) = (true, 2.0);
        let more = grown(&Splats::zeros(layout, 0, 7), &config);
        assert_eq!((more.n_static(), more.n_dynamic()), (0, 14));
    }
}
