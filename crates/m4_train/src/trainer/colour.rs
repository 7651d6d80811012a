//! The colour fit after the last step.

use super::Trainer;
use crate::{TrainError, colour_fit::correct};
use m4_kernels::View;

impl Trainer<'_> {
    /// Solves for the colours; weights are measured once.
    pub(super) fn fit_colours(&mut self) -> Result<(), TrainError> {
        let views: Vec<(usize, View)> = (0..self.times.len()).map(|frame| (frame, self.view(frame))).collect();
        self.prepare()?;
        self.download()?;
        let mut weight = Default::default();
        for round in 0..self.config.colour_fit_rounds {
            let sums = self.ask(|backend| backend.colour_sums(&views, round == 0))?;
            if round == 0 {
                weight = sums.weight;
            }
            let mut splats = self.splats.clone();
            correct(&mut splats, &sums.residual, &weight);
            self.ask(|backend| backend.set_splats(&splats))?;
            // as they are there; not yet checked, as `download` does
            self.splats = splats;
        }
        self.is_current = false;
        self.download()
    }
}
