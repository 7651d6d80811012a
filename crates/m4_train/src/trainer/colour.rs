//! The colour fit after the last step.

use super::Trainer;
use crate::{
    colour_fit::{ColourSums, Sum},
    refine::{expose, pull_back},
};
use m4_core::Column;
use m4_kernels::Wanted;

impl Trainer<'_> {
    /// Whether a fit belongs after the step just taken: the last.
    pub(super) fn colours_are_due(&self) -> bool {
        self.config.colour_fit_rounds > 0 && self.iteration == self.config.iterations
    }

    /// Solves for the colours, and returns the mean squared error of the frames before each round.
    pub(super) fn fit_colours(&mut self) -> Vec<f64> {
        let rounds = self.config.colour_fit_rounds;
        let mut sums = ColourSums::new(self.splats.n());
        let mut errors = Vec::with_capacity(rounds);
        for round in 0..rounds {
            let (mut squares, mut values) = (0.0f64, 0usize);
            sums.next_round();
            for frame in 0..self.times.len() {
                squares += self.residual(frame);
                values += self.frame_gradient.rgb.iter().map(Vec::len).sum::<usize>();
                self.add_colours(&mut sums, Sum::Residual);
                if round == 0 {
                    self.frame_gradient.rgb.iter_mut().for_each(|plane| plane.fill(1.0));
                    self.add_colours(&mut sums, Sum::Weight);
                }
            }
            sums.apply(&mut self.splats);
            errors.push(squares / values.max(1) as f64);
        }
        errors
    }

    /// Draws a frame, leaves what it has too much as the gradient, and returns its sum of squares.
    fn residual(&mut self, frame: usize) -> f64 {
        let view = self.view(frame);
        let target = self.store.target(frame).rgb();
        let drawn = self.renderer.render(&self.splats, &view);
        let exposure = self.config.refine.exposure.then(|| &self.fit.frames[frame].exposure);
        let rgb = match exposure {
            Some(exposure) => {
                expose(exposure, &drawn.rgb, &mut self.exposed);
                &self.exposed
            }
            None => &drawn.rgb,
        };
        let out = &mut self.frame_gradient;
        let mut squares = 0.0f64;
        for ((out, rgb), target) in out.rgb.iter_mut().zip(rgb).zip(&target) {
            out.clear();
            out.extend(rgb.iter().zip(target).map(|(a, b)| a - b));
            squares += out.iter().map(|&d| f64::from(d) * f64::from(d)).sum::<f64>();
        }
        if let Some(exposure) = exposure {
            pull_back(exposure, &mut out.rgb);
        }
        squares
    }

    fn add_colours(&mut self, sums: &mut ColourSums, which: Sum) {
        self.renderer.backward(
            &self.splats,
            &self.frame_gradient,
            Wanted::default(),
            &mut self.gradients,
        );
        let first = self.splats.layout().column(Column::Colour);
        let columns = &self.gradients.columns[first..first + 3];
        sums.add(which, columns, &self.gradients.touched);
    }
}
