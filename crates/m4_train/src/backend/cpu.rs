//! Training steps on the CPU.

use crate::{
    backend::{Backend, BackendError, ColourSums, StepSettings, StepView, pixels},
    colour_degree::move_phases,
    colour_fit::add_seen,
    density::{
        DensityRound, DensityStats, GradientSums, ScoreInput, ScoreSettings, Scores, apply,
        rearrange, score,
    },
    frames::FrameStore,
    metrics::psnr,
    refine::{expose, exposure_gradient, pull_back},
};
use m4_core::{Capture, Column, Exposure, ShapeError, SplatLayout, Splats};
use m4_kernels::{
    Gradients, Renderer, SimdLevel, StepStats, View,
    adam::{
        FIXED,
        cpu::{AdamState, step as adam_step},
        nodes::step as node_step,
    },
    cover,
    loss::cpu::{LossScratch, Target, loss},
    morton_order,
};
use rayon::prelude::*;

/// Splats, frames and scratch memory in host memory.
#[derive(Debug)]
pub struct CpuBackend<'a> {
    level: SimdLevel,
    frames: FrameStore<'a>,
    exposures: Vec<Exposure>,
    splats: Splats,
    adam: AdamState,
    renderer: Renderer,
    frame_gradient: [Vec<f32>; 3],
    gradients: Gradients,
    /// Sum over the frames of a step; empty while a step has one frame.
    sum: Gradients,
    scratch: LossScratch,
    exposed: [Vec<f32>; 3],
    image_gradients: Option<GradientSums>,
    /// Sums, not yet means.
    stats: StepStats,
}

impl<'a> CpuBackend<'a> {
    /// Without splats. Of the frames of `capture` at most `cache_mb` megabytes are kept in the form
    /// that the loss needs.
    pub fn new(capture: &'a Capture, cache_mb: usize, level: SimdLevel) -> Self {
        let nothing = nothing();
        Self {
            level,
            frames: FrameStore::new(capture, cache_mb),
            exposures: Vec::new(),
            adam: AdamState::new(&nothing),
            splats: nothing,
            renderer: Renderer::new(level),
            frame_gradient: Default::default(),
            gradients: Gradients::default(),
            sum: Gradients::default(),
            scratch: LossScratch::default(),
            exposed: Default::default(),
            image_gradients: None,
            stats: StepStats::default(),
        }
    }

    /// Renders a frame, compares it, and leaves the gradients of the splats.
    fn frame(&mut self, step: &StepView<'_>, settings: &StepSettings<'_>) {
        let target = self.frames.target(step.frame);
        let drawn = &self.renderer.render(&self.splats, step.view).rgb;
        let exposure = self.exposures.get(step.frame);
        let rgb = exposed(exposure, drawn, &mut self.exposed);
        let out = &mut self.frame_gradient;
        let terms = loss(
            self.level,
            target,
            rgb,
            settings.lambda_ssim,
            &mut self.scratch,
            out,
        );
        let stats = &mut self.stats;
        stats.frames += 1;
        stats.l1 += terms.l1;
        stats.ssim += terms.ssim;
        stats.psnr = match settings.psnr {
            true => psnr(rgb, &target.rgb()),
            false => f64::NAN,
        };
        if let Some(exposure) = exposure {
            if step.exposure {
                stats
                    .exposures
                    .push((step.frame, exposure_gradient(drawn, out)));
            }
            pull_back(exposure, out);
        }
        if self.image_gradients.is_some() {
            self.gradients.image.get_or_insert_default();
        }
        self.backward(step.camera);
        if let (Some(sums), Some(lengths)) = (&mut self.image_gradients, &self.gradients.image) {
            sums.add(lengths, &self.gradients.touched);
        }
        if step.camera {
            self.stats.cameras.push((step.frame, self.gradients.camera));
        }
    }

    /// Both scores of every splat over some frames; 0 of fixed ones.
    fn score(&mut self, views: &[(usize, View)], settings: &ScoreSettings) -> Scores {
        let mut input = ScoreInput {
            level: self.level,
            settings,
            frames: &mut self.frames,
            exposures: &self.exposures,
            renderer: &mut self.renderer,
            scratch: &mut self.scratch,
        };
        let mut scores = score(&mut input, &self.splats, views);
        for row in self.fixed() {
            (scores.densify[row], scores.prune[row]) = (0.0, 0.0);
        }
        scores
    }

    /// Rows that are never stepped, all of them static.
    fn fixed(&self) -> Vec<usize> {
        (0..self.splats.n_static())
            .filter(|&row| self.adam.step[row] == FIXED)
            .collect()
    }

    fn backward(&mut self, camera: bool) {
        self.renderer.backward(
            &self.splats,
            &self.frame_gradient,
            camera,
            &mut self.gradients,
        );
        for row in self.fixed() {
            self.gradients.touched[row] = 0;
        }
    }

    /// Leaves image minus target as the gradient.
    fn residual(&mut self, frame: usize, view: &View) {
        let target = self.frames.target(frame).rgb();
        let drawn = &self.renderer.render(&self.splats, view).rgb;
        let exposure = self.exposures.get(frame);
        let rgb = exposed(exposure, drawn, &mut self.exposed);
        let out = &mut self.frame_gradient;
        for ((out, rgb), target) in out.iter_mut().zip(rgb).zip(&target) {
            out.clear();
            out.extend(rgb.iter().zip(target).map(|(a, b)| a - b));
        }
        if let Some(exposure) = exposure {
            pull_back(exposure, out);
        }
    }

    /// Adds the gradients of the constant coefficients of the colours.
    fn add_colours(&mut self, sums: &mut [Vec<f32>; 3]) {
        self.backward(false);
        let first = self.splats.layout().column(Column::Colour);
        let columns = &self.gradients.columns[first..first + 3];
        add_seen(sums, columns, &self.gradients.touched);
    }
}

fn nothing() -> Splats {
    let layout = SplatLayout {
        isotropic: false,
        sh_degree: 0,
        time_degree: 0,
    };
    Splats::zeros(layout, 0, 0)
}

/// What is compared with a frame.
fn exposed<'a>(
    exposure: Option<&Exposure>,
    drawn: &'a [Vec<f32>; 3],
    out: &'a mut [Vec<f32>; 3],
) -> &'a [Vec<f32>; 3] {
    match exposure {
        Some(exposure) => {
            expose(exposure, drawn, out);
            out
        }
        None => drawn,
    }
}

fn failed(error: ShapeError) -> BackendError {
    BackendError(error.to_string())
}

impl Backend for CpuBackend<'_> {
    fn name(&self) -> String {
        "cpu".to_owned()
    }

    fn is_synchronous(&self) -> bool {
        true
    }

    fn set_frames(&mut self, frames: Vec<Target>) -> Result<(), BackendError> {
        self.frames = FrameStore::of_targets(frames);
        Ok(())
    }

    fn set_exposures(&mut self, exposures: &[Exposure]) -> Result<(), BackendError> {
        self.exposures.clear();
        self.exposures.extend_from_slice(exposures);
        Ok(())
    }

    fn upload(&mut self, splats: &Splats, adam: AdamState) -> Result<(), BackendError> {
        // so that steps cost what they cost after the first epoch
        self.frames.prepare();
        self.splats.clone_from(splats);
        self.adam = adam;
        Ok(())
    }

    fn take(&mut self) -> Result<(Splats, AdamState), BackendError> {
        let nothing = nothing();
        let adam = std::mem::replace(&mut self.adam, AdamState::new(&nothing));
        Ok((std::mem::replace(&mut self.splats, nothing), adam))
    }

    fn splats(&mut self) -> Result<Splats, BackendError> {
        Ok(self.splats.clone())
    }

    fn set_splats(&mut self, splats: &Splats) -> Result<(), BackendError> {
        self.splats.clone_from(splats);
        Ok(())
    }

    fn reorder(&mut self) -> Result<(), BackendError> {
        let order = morton_order(&self.splats);
        self.splats.rearrange(&order).map_err(failed)?;
        if let Some(sums) = &mut self.image_gradients {
            sums.rearrange(&order);
        }
        rearrange(&mut self.adam, &order).map_err(failed)
    }

    fn step(
        &mut self,
        views: &[StepView<'_>],
        settings: &StepSettings<'_>,
    ) -> Result<(), BackendError> {
        for (k, view) in views.iter().enumerate() {
            if k == 1 {
                // the first frame starts the sum; what comes back is written over
                std::mem::swap(&mut self.gradients, &mut self.sum);
            }
            self.frame(view, settings);
            if k > 0 {
                add_touched(&mut self.sum, &self.gradients, self.splats.n_static());
            }
        }
        let gradients = match views.len() {
            0 => return Ok(()),
            1 => &mut self.gradients,
            _ => &mut self.sum,
        };
        if settings.cover > 0.0 {
            cover::cpu::add(
                &self.splats,
                gradients,
                settings.cover / pixels(views[0].view),
            );
        }
        adam_step(
            self.level,
            &mut self.splats,
            gradients,
            &mut self.adam,
            &settings.adam,
            settings.rates,
        );
        if !gradients.nodes.is_empty() {
            let windows = self.splats.windows_mut();
            node_step(
                windows,
                &gradients.nodes,
                &mut self.adam.nodes,
                &settings.adam,
                settings.nodes,
            );
        }
        self.stats.steps += 1;
        self.stats.touched += gradients.touched.iter().filter(|&&v| v != 0).count() as f64;
        Ok(())
    }

    fn stats(&mut self) -> Result<StepStats, BackendError> {
        let mut stats = std::mem::take(&mut self.stats);
        let (frames, steps) = (stats.frames.max(1) as f64, stats.steps.max(1) as f64);
        stats.l1 /= frames;
        stats.ssim /= frames;
        stats.touched /= steps;
        // the trainer checks them when it copies them
        stats.splats_are_finite = true;
        Ok(stats)
    }

    fn collect_image_gradients(&mut self) {
        self.image_gradients.get_or_insert_default();
    }

    fn densify(&mut self, round: &DensityRound<'_>) -> Result<DensityStats, BackendError> {
        let scores = match &mut self.image_gradients {
            Some(sums) => sums.take(self.splats.n()),
            None => self.score(round.views, &round.scores),
        };
        let plan = round.rules.plan(&self.splats, &scores);
        let mut stats = DensityStats::default();
        if !plan.rows.is_empty() && !plan.changes_nothing() {
            let (config, splats, adam) = (round.rules.config, &mut self.splats, &mut self.adam);
            let (n_static, middles) = (
                splats.n_static(),
                splats.column(Column::TimeMean, 0).to_vec(),
            );
            apply(config, &plan, splats, adam, round.seed, round.iteration).map_err(failed)?;
            move_phases(splats, &middles, n_static, &plan.rows, round.period);
            (stats.cloned, stats.split, stats.pruned) = (plan.cloned, plan.split, plan.pruned);
        }
        (stats.n_static, stats.n_dynamic) = (self.splats.n_static(), self.splats.n_dynamic());
        Ok(stats)
    }

    fn colour_sums(
        &mut self,
        views: &[(usize, View)],
        with_weight: bool,
        stop: &dyn Fn() -> bool,
    ) -> Result<ColourSums, BackendError> {
        let n = self.splats.n();
        let mut sums = ColourSums {
            residual: std::array::from_fn(|_| vec![0.0; n]),
            weight: std::array::from_fn(|_| vec![0.0; if with_weight { n } else { 0 }]),
        };
        for (frame, view) in views {
            if stop() {
                break;
            }
            self.residual(*frame, view);
            self.add_colours(&mut sums.residual);
            if with_weight {
                self.frame_gradient
                    .iter_mut()
                    .for_each(|plane| plane.fill(1.0));
                self.add_colours(&mut sums.weight);
            }
        }
        Ok(sums)
    }
}

/// Rows a task.
const CHUNK_ROWS: usize = 8192;

/// Adds the rows that `other` touches to `sum`: gradients of the same splats, of two frames. What
/// was touched by either is touched then, nodes of either have gradients; sums of camera and
/// background stay those of `sum`. `n_static` rows lack the columns of time.
///
/// Each value is one addition, so the order of the calls alone decides the bits.
pub(crate) fn add_touched(sum: &mut Gradients, other: &Gradients, n_static: usize) {
    let n = sum.touched.len();
    let (old, new) = (&sum.touched, &other.touched);
    for (column, g) in sum.columns.iter_mut().zip(&other.columns) {
        let first = if column.len() == n { 0 } else { n_static };
        let flags = old[first..]
            .par_chunks(CHUNK_ROWS)
            .zip(new[first..].par_chunks(CHUNK_ROWS));
        let values = column
            .par_chunks_mut(CHUNK_ROWS)
            .zip(g.par_chunks(CHUNK_ROWS));
        values.zip(flags).for_each(|((column, g), (old, new))| {
            // of a long video most chunks lie in other frames
            if new.iter().all(|&t| t == 0) {
                return;
            }
            for (((a, &g), &old), &new) in column.iter_mut().zip(g).zip(old).zip(new) {
                // rows that are not touched hold anything, NaN included
                let before = if old == 0 { 0.0 } else { *a };
                let more = if new == 0 { 0.0 } else { g };
                *a = before + more;
            }
        });
    }
    for (a, &b) in sum.touched.iter_mut().zip(&other.touched) {
        *a |= b;
    }
    for more in &other.nodes {
        match sum
            .nodes
            .iter_mut()
            .find(|of| (of.window, of.key) == (more.window, more.key))
        {
            Some(sum) => {
                let numbers = sum
                    .nodes
                    .as_flattened_mut()
                    .iter_mut()
                    .zip(more.nodes.as_flattened());
                numbers.for_each(|(a, b)| *a += b);
            }
            None => sum.nodes.push(more.clone()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::add_touched;
    use m4_kernels::{Gradients, NodeGradients};

    #[test]
    fn batch_gradients_sum_over_touched_rows_only() {
        let gradients = |shared: [f32; 4], late: [f32; 2], touched: [u8; 4]| Gradients {
            columns: vec![shared.to_vec(), late.to_vec()],
            touched: touched.to_vec(),
            ..Gradients::default()
        };
        let nan = f32::NAN;
        let mut sum = gradients([1.0, nan, 3.0, nan], [3.5, nan], [1, 0, 1, 0]);
        let other = gradients([10.0, 20.0, nan, nan], [nan, nan], [1, 1, 0, 0]);
        add_touched(&mut sum, &other, 2);
        assert_eq!(sum.touched, [1, 1, 1, 0]);
        assert_eq!(sum.columns[0][..3], [11.0, 20.0, 3.0]);
        assert_eq!(sum.columns[1][0], 3.5);
        let again = gradients([0.0; 4], [0.25, 8.0], [0, 0, 1, 1]);
        add_touched(&mut sum, &again, 2);
        assert_eq!(sum.columns[1], [3.75, 8.0]);
        assert_eq!(sum.touched, [1; 4]);
        let of = |window: usize, key: usize, g: f32| NodeGradients {
            window,
            key,
            nodes: vec![[g; 6]; 2],
        };
        sum.nodes = vec![of(0, 3, 1.0)];
        let more = Gradients {
            nodes: vec![of(0, 3, 0.5), of(1, 0, 2.0)],
            ..again
        };
        add_touched(&mut sum, &more, 2);
        assert_eq!(sum.nodes, [of(0, 3, 1.5), of(1, 0, 2.0)]);
    }
}
