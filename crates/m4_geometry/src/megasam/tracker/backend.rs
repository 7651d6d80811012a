//! The back end: all keyframes at once, and static pixels by how well they follow the motion of the
//! camera.

use super::correspondence::{Correspondence, TrackerError};
use super::keyframes::{Keyframes, Update};
use super::{BETA, TrackerSettings};
use crate::dba::{DbaOptions, DbaReport, Factor, Observability, Problem, observability};
use crate::megasam::graph::{FactorGraph, ProximitySettings};
use m4_core::Progress;

/// Greatest distance of an edge, pixels of the grid: 16.
const GREATEST_DISTANCE_PX: f64 = 16.0;
/// Frames this close in time are always joined: 2.
const RADIUS: usize = 2;
/// Suppression around an edge, steps of frames: 3.
const SUPPRESSION: usize = 3;
/// Source frames whose edges are revised at once: 8.
const BATCH: usize = 8;

/// A graph over all keyframes and what is adjusted with it.
#[derive(Debug)]
pub struct Backend {
    settings: TrackerSettings,
    /// The edges, chosen once.
    pub graph: FactorGraph,
}

impl Backend {
    /// Chooses the edges from the present geometry.
    #[must_use]
    pub fn new(keyframes: &Keyframes, settings: TrackerSettings) -> Self {
        let count = keyframes.len();
        let max_factors = settings.backend_factors * count;
        let mut graph = FactorGraph::new(max_factors);
        let proximity = ProximitySettings {
            first_source: 0,
            first_target: 0,
            radius: RADIUS,
            suppression: SUPPRESSION,
            threshold_px: GREATEST_DISTANCE_PX,
            beta: BETA,
            max_factors,
        };
        graph.add_proximity(&proximity, &keyframes.geometry, &keyframes.frame, false);
        Self { settings, graph }
    }

    /// `updates` updates of all poses but the first, all disparities and, with `free_focal`, the
    /// focal length. `alpha` is the weight of the depth prior, `None` without one. Returns the
    /// report of the last.
    ///
    /// # Errors
    ///
    /// [`TrackerError`] when correspondences fail, the state becomes useless or the user stops.
    pub fn run(
        &mut self,
        keyframes: &mut Keyframes,
        source: &mut dyn Correspondence,
        updates: usize,
        free_focal: bool,
        alpha: Option<f64>,
        progress: &dyn Progress,
    ) -> Result<DbaReport, TrackerError> {
        let s = &self.settings;
        let update = Update {
            options: DbaOptions {
                min_depth: s.min_depth,
                #[cfg(test)]
                python_twin: s.python_twin,
                ..DbaOptions::backend(free_focal, alpha)
            },
            window: 1.min(keyframes.len())..keyframes.len(),
            inactive_from: None,
            batch: Some(BATCH),
        };
        let mut report = DbaReport::default();
        for k in 0..updates {
            if progress.cancelled() {
                return Err(TrackerError::Cancelled);
            }
            report = update.run(keyframes, &mut self.graph, source)?;
            let note = format!("residual {:.3} px of the grid", report.rms_px);
            progress.update("adjusting all frames", k + 1, updates, &note);
        }
        Ok(report)
    }

    /// What the present geometry can tell about depth and focal length.
    ///
    /// # Errors
    ///
    /// [`TrackerError::Dba`] where sizes do not fit.
    pub fn observability(&self, keyframes: &Keyframes) -> Result<Observability, TrackerError> {
        let edges: Vec<&Factor<f32>> = self.graph.active.iter().map(|e| &e.factor).collect();
        let problem = Problem {
            edges: &edges,
            eta: &keyframes.damping,
        };
        Ok(observability(
            &keyframes.geometry,
            &problem,
            &self.settings.adjustment(),
        )?)
    }

    /// Probability that each pixel of each keyframe is static, `[keyframes][height * width]`: the
    /// mean over the edges that start there, at the last update; 1 for a frame without edges.
    #[must_use]
    pub fn static_confidence(&self, keyframes: &Keyframes) -> Vec<Vec<f32>> {
        let len = keyframes.geometry.grid.len();
        let mut sums = vec![(vec![0.0_f32; len], 0_u32); keyframes.len()];
        for edge in &self.graph.active {
            let (sum, count) = &mut sums[edge.factor.source];
            for (s, m) in sum.iter_mut().zip(&edge.static_confidence) {
                *s += m;
            }
            *count += 1;
        }
        let mean = |(mut sum, count): (Vec<f32>, u32)| {
            for s in &mut sum {
                *s = if count == 0 { 1.0 } else { *s / count as f32 };
            }
            sum
        };
        sums.into_iter().map(mean).collect()
    }

    /// Tells the source of correspondences that the edges are not needed any more.
    ///
    /// # Errors
    ///
    /// [`TrackerError::Correspondence`] when it fails at that.
    pub fn finish(mut self, source: &mut dyn Correspondence) -> Result<(), TrackerError> {
        self.graph.clear();
        Ok(source.change(&self.graph.take_changes())?)
    }
}
