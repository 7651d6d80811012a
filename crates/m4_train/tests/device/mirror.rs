//! A device that is the processor: its own kernels behind the interface.

use m4_core::{Column, Exposure, SplatLayout, Splats};
use m4_kernels::adam::cpu::{AdamState, step as adam_step};
use m4_kernels::loss::cpu::{LossScratch, Target, error_map, loss};
use m4_kernels::{FrameGradient, Gradients, Renderer, SimdLevel, View, Wanted, morton_order};
use m4_train::{
    Device, DeviceError,
    density::{Scores, apply, masked_error},
    device::{
        ColourGradient, DensifyPlan, DensifyStats, DeviceFound, DeviceLook, DeviceRound, DeviceStep, ScoreSettings,
    },
};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What is compared with a frame: `matrix rgb + offset`.
fn exposed(exposure: Option<Exposure>, rgb: &[Vec<f32>; 3]) -> [Vec<f32>; 3] {
    let Some(Exposure { matrix, offset }) = exposure else {
        return rgb.clone();
    };
    std::array::from_fn(|r| {
        let [a, b, c] = matrix[r];
        let pixel = |i: usize| a * rgb[0][i] + b * rgb[1][i] + c * rgb[2][i] + offset[r];
        (0..rgb[0].len()).map(pixel).collect()
    })
}

/// The gradient with respect to matrix rows and offsets.
fn exposure_gradient(rgb: &[Vec<f32>; 3], g: &[Vec<f32>; 3]) -> [f64; 12] {
    let mut d = [0.0; 12];
    for i in 0..rgb[0].len() {
        for r in 0..3 {
            for k in 0..3 {
                d[4 * r + k] += f64::from(g[r][i] * rgb[k][i]);
            }
            d[4 * r + 3] += f64::from(g[r][i]);
        }
    }
    d
}

/// The gradient with respect to the colours before the correction.
fn pull_back(exposure: Option<Exposure>, g: &mut [Vec<f32>; 3]) {
    let Some(Exposure { matrix, .. }) = exposure else {
        return;
    };
    for i in 0..g[0].len() {
        let after = [g[0][i], g[1][i], g[2][i]];
        for k in 0..3 {
            g[k][i] = (0..3).map(|r| matrix[r][k] * after[r]).sum();
        }
    }
}

/// The sum of two gradients; what one of them does not touch holds anything.
fn added(mut sum: Gradients, other: &Gradients) -> Gradients {
    let n = sum.touched.len();
    for (column, more) in sum.columns.iter_mut().zip(&other.columns) {
        let first = n - column.len();
        for (row, (a, b)) in (first..).zip(column.iter_mut().zip(more)) {
            let of = |touched: &[u8], v: f32| if touched[row] == 0 { 0.0 } else { v };
            *a = of(&sum.touched, *a) + of(&other.touched, *b);
        }
    }
    for (a, b) in sum.touched.iter_mut().zip(&other.touched) {
        *a |= b;
    }
    sum
}

/// The processor behind the interface of a device; fails at one of its steps, if asked to.
#[derive(Debug)]
pub struct Mirror {
    splats: Splats,
    adam: AdamState,
    frames: Vec<Target>,
    exposures: Vec<Exposure>,
    renderer: Renderer,
    gradient: FrameGradient,
    gradients: Gradients,
    scratch: LossScratch,
    found: DeviceFound,
    fails_at: usize,
    steps: usize,
    /// A splat is no longer finite after this step.
    pub breaks_at: usize,
    /// Rounds of density control are done by itself, this many of them; `None` leaves them to the trainer.
    rounds: Option<Arc<AtomicUsize>>,
}

impl Mirror {
    pub fn new(fails_at: usize, rounds: Option<&Arc<AtomicUsize>>) -> Self {
        let layout = SplatLayout {
            isotropic: false,
            sh_degree: 0,
            time_degree: 0,
        };
        let nothing = Splats::zeros(layout, 0, 0);
        Self {
            adam: AdamState::new(&nothing),
            splats: nothing,
            frames: Vec::new(),
            exposures: Vec::new(),
            renderer: Renderer::new(SimdLevel::best()),
            gradient: FrameGradient::default(),
            gradients: Gradients::default(),
            scratch: LossScratch::default(),
            found: DeviceFound::default(),
            fails_at,
            steps: 0,
            breaks_at: 0,
            rounds: rounds.cloned(),
        }
    }

    fn backward(&mut self, camera: bool) {
        let wanted = Wanted {
            camera,
            ..Wanted::default()
        };
        self.renderer
            .backward(&self.splats, &self.gradient, wanted, &mut self.gradients);
    }

    fn sort_state(&mut self, rows: &[u32]) {
        self.adam.m.rearrange(rows).unwrap();
        self.adam.v.rearrange(rows).unwrap();
        self.adam.step = rows.iter().map(|&r| self.adam.step[r as usize]).collect();
    }

    /// Adds the gradient of the first three columns of colours.
    fn add_colours(&self, sums: &mut [Vec<f32>; 3]) {
        let first = self.splats.layout().column(Column::Colour);
        for (sum, column) in sums.iter_mut().zip(&self.gradients.columns[first..]) {
            for ((sum, g), touched) in sum.iter_mut().zip(column).zip(&self.gradients.touched) {
                *sum += if *touched == 0 { 0.0 } else { *g };
            }
        }
    }
}

impl Device for Mirror {
    fn name(&self) -> String {
        "a mirror".to_owned()
    }

    fn set_frames(&mut self, frames: Vec<Target>) -> Result<(), DeviceError> {
        self.frames = frames;
        Ok(())
    }

    fn set_exposures(&mut self, exposures: &[Exposure]) -> Result<(), DeviceError> {
        self.exposures = exposures.to_vec();
        Ok(())
    }

    fn upload(&mut self, splats: &Splats, adam: &AdamState) -> Result<(), DeviceError> {
        (self.splats, self.adam) = (splats.clone(), adam.clone());
        Ok(())
    }

    fn regrow(&mut self, next: &DensifyPlan<'_>) -> Result<(), DeviceError> {
        let (all, values) = (next.rows.len() as u32, next.values);
        self.splats.rearrange(next.rows).unwrap();
        assert_eq!(self.splats.n_static(), next.n_static);
        for (column, new) in self.splats.columns_mut().zip(values.columns()) {
            let (first, skip) = match column.len() == all as usize {
                true => (0, 0),
                false => (next.n_static as u32, values.n_static()),
            };
            for (row, value) in next.changed[skip..].iter().zip(new) {
                column[(row - first) as usize] = *value;
            }
        }
        self.sort_state(next.rows);
        for (row, _) in next.is_new.iter().enumerate().filter(|&(_, &new)| new) {
            self.adam.forget(row);
        }
        Ok(())
    }

    fn reorder(&mut self) -> Result<(), DeviceError> {
        let order = morton_order(&self.splats);
        self.splats.rearrange(&order).unwrap();
        self.sort_state(&order);
        Ok(())
    }

    fn splats(&mut self) -> Result<Splats, DeviceError> {
        Ok(self.splats.clone())
    }

    fn adam(&mut self) -> Result<AdamState, DeviceError> {
        Ok(self.adam.clone())
    }

    fn step(&mut self, looks: &[DeviceLook<'_>], settings: &DeviceStep<'_>) -> Result<(), DeviceError> {
        self.steps += 1;
        if self.steps == self.fails_at {
            return Err(DeviceError("the mirror broke".to_owned()));
        }
        let level = SimdLevel::best();
        let mut sum: Option<Gradients> = None;
        for look in looks {
            let exposure = self.exposures.get(look.frame).copied();
            let drawn = self.renderer.render(&self.splats, look.view).rgb.clone();
            let shown = exposed(exposure, &drawn);
            let photo = loss(
                level,
                &self.frames[look.frame],
                &shown,
                settings.lambda_ssim,
                &mut self.scratch,
                &mut self.gradient.rgb,
            );
            if look.exposure {
                let gradient = exposure_gradient(&drawn, &self.gradient.rgb);
                self.found.exposures.push((look.frame, gradient));
            }
            // identities are pulled back too: to the same bits
            pull_back(exposure, &mut self.gradient.rgb);
            self.backward(look.camera);
            if look.camera {
                self.found.cameras.push((look.frame, self.gradients.camera));
            }
            sum = Some(match sum {
                Some(sum) => added(sum, &self.gradients),
                None => self.gradients.clone(),
            });
            self.found.looks += 1;
            self.found.l1 += photo.l1;
            self.found.ssim += photo.ssim;
        }
        adam_step(
            level,
            &mut self.splats,
            &sum.unwrap(),
            &mut self.adam,
            &settings.adam,
            settings.rates,
        );
        if self.steps == self.breaks_at {
            self.splats.column_mut(Column::Opacity, 0)[0] = f32::NAN;
        }
        self.found.steps += 1;
        Ok(())
    }

    fn found(&mut self) -> Result<DeviceFound, DeviceError> {
        let mut found = std::mem::take(&mut self.found);
        found.l1 /= found.looks as f64;
        found.ssim /= found.looks as f64;
        found.splats_are_finite = self.splats.is_finite();
        Ok(found)
    }

    fn score(&mut self, looks: &[(usize, View)], settings: &ScoreSettings) -> Result<Scores, DeviceError> {
        let (level, n) = (SimdLevel::best(), self.splats.n());
        let mut out = Scores {
            densify: vec![0.0; n],
            prune: vec![0.0; n],
        };
        let mut errors = Vec::new();
        for (frame, view) in looks {
            let target = &self.frames[*frame];
            let rgb = &exposed(
                self.exposures.get(*frame).copied(),
                &self.renderer.render(&self.splats, view).rgb,
            );
            let photo = loss(
                level,
                target,
                rgb,
                settings.lambda_ssim,
                &mut self.scratch,
                &mut self.gradient.rgb,
            );
            error_map(level, target, rgb, &mut errors);
            masked_error(&mut errors, settings.threshold, settings.range);
            let mut one = vec![0.0; n];
            self.renderer.score(&errors, &mut one);
            for i in 0..n {
                out.densify[i] += one[i] * (1.0 / looks.len() as f32);
                out.prune[i] += one[i] * photo.total as f32;
            }
        }
        Ok(out)
    }

    fn densify(&mut self, round: &DeviceRound<'_>) -> Result<Option<DensifyStats>, DeviceError> {
        let Some(rounds) = &self.rounds else { return Ok(None) };
        rounds.fetch_add(1, Ordering::Relaxed);
        let scores = self.score(round.looks, &round.scores)?;
        let plan = round.rules.plan(&self.splats, &scores);
        let mut grown = DensifyStats::default();
        if !plan.rows.is_empty() && !plan.changes_nothing() {
            // nothing is drawn at random
            apply(round.rules.config, &plan, &mut self.splats, &mut self.adam, 0, 0).unwrap();
            (grown.cloned, grown.split, grown.pruned) = (plan.cloned, plan.split, plan.pruned);
        }
        (grown.n_static, grown.n_dynamic) = (self.splats.n_static(), self.splats.n_dynamic());
        Ok(Some(grown))
    }

    fn colour_gradient(&mut self, looks: &[(usize, View)], with_weight: bool) -> Result<ColourGradient, DeviceError> {
        let n = self.splats.n();
        let zero = || std::array::from_fn(|_| vec![0.0; n]);
        let mut out = ColourGradient {
            residual: zero(),
            weight: if with_weight { zero() } else { Default::default() },
            squares: 0.0,
        };
        for (frame, view) in looks {
            let target = self.frames[*frame].rgb();
            let exposure = self.exposures.get(*frame).copied();
            let shown = exposed(exposure, &self.renderer.render(&self.splats, view).rgb);
            for ((out, rgb), target) in self.gradient.rgb.iter_mut().zip(&shown).zip(&target) {
                *out = rgb.iter().zip(target).map(|(a, b)| a - b).collect();
            }
            pull_back(exposure, &mut self.gradient.rgb);
            self.backward(false);
            self.add_colours(&mut out.residual);
            if with_weight {
                self.gradient.rgb.iter_mut().for_each(|plane| plane.fill(1.0));
                self.backward(false);
                self.add_colours(&mut out.weight);
            }
        }
        Ok(out)
    }
}
