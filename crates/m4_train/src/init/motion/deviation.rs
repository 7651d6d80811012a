//! Estimates how far off the motion of a node is, as a standard deviation.

use crate::init::motion::{
    align::{Moved, NARROW, Pieces, Prior, Sums},
    observed::Observed,
    rigid::Rigid,
};
use m4_core::median;
use rayon::prelude::*;

/// Neighbours and damping bind less than in an alignment, by these factors.
const LOOSE: (f32, f32) = (3.0, 15.0);

/// What the alignment of a node to a frame tells of its error.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Signs {
    /// Formal standard deviation of the place in the image, pixels.
    pub formal_px: f32,
    /// Squared difference of measures and depth at its points over their noise, large ones counting
    /// less.
    pub misfit: f32,
    /// Share of its points that the frame shows.
    pub visible: f32,
    /// Median distance from where its neighbours would carry it, pixels.
    pub apart_px: f32,
    /// The step that it would take next, pixels.
    pub step_px: f32,
}

/// Collects the signs of each node that `motion` has brought to `frame`.
pub(crate) fn signs(
    pieces: &Pieces,
    frame: &Observed,
    motion: &[Rigid],
    prior: Prior,
) -> Vec<Signs> {
    let one = |i: usize| {
        let now = Moved::new(&pieces.nodes[i], &motion[i]);
        let mut sums = Sums::default();
        let fit = sums.points(pieces, i, &now, frame, prior.depth, NARROW);
        let mut loose = sums;
        sums.neighbours(pieces, i, &now, frame, motion, prior);
        sums.damp(pieces, &now, frame, prior);
        let pixel = now.pixel(frame);
        let step_px = (sums.step(&now, frame).to - now.place).norm() / pixel;
        let wide = Prior {
            apart_px: LOOSE.0 * prior.apart_px,
            step_px: LOOSE.1 * prior.step_px,
            ..prior
        };
        loose.neighbours(pieces, i, &now, frame, motion, wide);
        loose.damp(pieces, &now, frame, wide);
        let away =
            |&j: &u32| (motion[j as usize].moved(&now.node.place) - now.place).norm() / pixel;
        let mut apart: Vec<f32> = now.node.near.iter().map(away).collect();
        Signs {
            formal_px: loose.deviation(&now, frame).unwrap_or(wide.step_px),
            misfit: fit.misfit(),
            visible: fit.visible(),
            apart_px: median(&mut apart).unwrap_or(0.0),
            step_px,
        }
    };
    (0..pieces.nodes.len()).into_par_iter().map(one).collect()
}

/// Deviations and errors of motion are in pixels of an image of this width.
pub(crate) const UNIT_WIDTH: f32 = 480.0;

impl Signs {
    /// Returns the standard deviation of the place beside that on the reference keyframe, pixels of
    /// an image [`UNIT_WIDTH`] wide; that of the frame is `width`. A product of powers of the
    /// signs, fitted so that two of three errors on six scenes are smaller; on others it is too
    /// small (docs/decisions/0022, docs/results.md). From one keyframe to another, variances add.
    pub fn deviation(&self, width: f32) -> f32 {
        let unit = UNIT_WIDTH / width;
        let power = |value: f32, least: f32, power: f32| power * (value + least).ln();
        let log = 1.81 + power(self.formal_px * unit, 0.05, 0.57) + power(self.misfit, 0.1, 0.57)
            - 0.54 * self.visible
            + power(self.apart_px * unit, 0.05, 0.49)
            + power(self.step_px * unit, 0.02, 0.3);
        log.exp()
    }
}
