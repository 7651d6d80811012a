//! Schedules the split of rotating splats into segments of arcs.

use super::Trainer;
use crate::{TrainError, arcs};

/// Share of the run after which rotating splats are split: velocities are trained by then, and the segments are trained from then on.
/// Earlier gains no more and makes more steps slower (docs/decisions/0007).
pub(crate) const ARCS_AT: f64 = 0.5;

impl Trainer<'_> {
    /// Splits rotating splats if this iteration is the one for it; on the CPU whatever the backend, since it happens once in a run.
    pub(super) fn arc_round(&mut self) -> Result<(), TrainError> {
        if !self.config.arcs || self.iteration != (ARCS_AT * self.config.iterations as f64) as usize {
            return Ok(());
        }
        self.download()?;
        let rotating = arcs::rotating(&self.splats);
        if rotating.is_empty() {
            return Ok(());
        }
        self.synchronize()?;
        let before = self.splats.n();
        arcs::split(&mut self.splats, &mut self.adam, &rotating)?;
        // density control may add as many as before
        self.first_splats += self.splats.n() - before;
        self.prepare()?;
        self.reorder()
    }
}
