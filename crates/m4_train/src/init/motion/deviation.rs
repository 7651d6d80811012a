//! How far off the motion of a node is, as a standard deviation.

use crate::init::motion::{
    align::{Moved, Pieces, Prior, Sums},
    observed::Observed,
    rigid::Rigid,
};
use m4_core::median;
use rayon::prelude::*;

/// What is not told counts as known by neighbours and by the guess, but less than while motion is looked for: by these factors.
const LOOSE: (f32, f32) = (3.0, 15.0);

/// What the alignment of a node to a frame tells of its error.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Signs {
    /// Formal standard deviation of the place in the image, pixels.
    pub formal_px: f32,
    /// Squared difference of measures and depth at its points over their noise, large ones counting less.
    pub misfit: f32,
    /// Share of its points that the frame shows.
    pub shown: f32,
    /// Median distance from where its neighbours would carry it, pixels.
    pub apart_px: f32,
    /// The step that it would take next, pixels.
    pub step_px: f32,
}

/// The signs of each node that `motion` has brought to `frame`.
pub(crate) fn signs(pieces: &Pieces, frame: &Observed, motion: &[Rigid], prior: Prior) -> Vec<Signs> {
    let one = |i: usize| {
        let now = Moved::new(&pieces.nodes[i], &motion[i]);
        let mut sums = Sums::default();
        let fit = sums.points(pieces, i, &now, frame, prior.depth, (4.0, 1));
        let mut loose = sums;
        sums.neighbours(pieces, i, &now, frame, motion, prior);
        sums.damp(pieces, &now, frame, prior);
        let pixel = now.pixel(frame);
        let step_px = (sums.step(&now, frame).to - now.place).norm() / pixel;
        let wide = Prior { apart_px: LOOSE.0 * prior.apart_px, step_px: LOOSE.1 * prior.step_px, ..prior };
        loose.neighbours(pieces, i, &now, frame, motion, wide);
        loose.damp(pieces, &now, frame, wide);
        let away = |&j: &u32| (motion[j as usize].moved(&now.node.place) - now.place).norm() / pixel;
        let mut apart: Vec<f32> = now.node.near.iter().map(away).collect();
        Signs {
            formal_px: loose.deviation(&now, frame).unwrap_or(wide.step_px),
            misfit: fit.misfit(),
            shown: fit.shown(),
            apart_px: median(&mut apart).unwrap_or(0.0),
            step_px,
        }
    };
    (0..pieces.nodes.len()).into_par_iter().map(one).collect()
}

/// Width of an image in which the model below was fitted, pixels.
const WIDTH: f32 = 480.0;

impl Signs {
    /// Standard deviation of the place beside that on the reference keyframe, pixels of an image of `width`: two of three errors are smaller. A product of powers
    /// of the signs, fitted to the errors of true tracks of six scenes (docs/decisions/0022). From one keyframe to another, variances add.
    pub fn deviation(&self, width: f32) -> f32 {
        let unit = WIDTH / width;
        let power = |value: f32, least: f32, power: f32| power * (value + least).ln();
        let log = 1.81 + power(self.formal_px * unit, 0.05, 0.57) + power(self.misfit, 0.1, 0.57) - 0.54 * self.shown
            + power(self.apart_px * unit, 0.05, 0.49)
            + power(self.step_px * unit, 0.02, 0.3);
        log.exp() / unit
    }
}
