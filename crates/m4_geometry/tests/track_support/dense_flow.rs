//! Correspondences from optical flow that is computed once a pair.

use m4_geometry::dba::Grid;
use m4_geometry::megasam::graph::{EdgeChanges, EdgeId};
use m4_geometry::megasam::tracker::{Correspondence, CorrespondenceError, Revision};
use std::collections::HashMap;

/// Flow from one frame to another. Planes are `[height * width]` on the grid of the tracker.
#[derive(Debug, Clone, PartialEq)]
pub struct DenseFlow {
    /// Motion of each pixel, pixels of the grid; u, then v.
    pub flow_px: [Vec<f32>; 2],
    /// Confidence, 0..=1; for example whether the way there and back returns to its start.
    pub confidence: Vec<f32>,
}

/// Why a flow could not be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the flow from frame {from} to frame {to} has planes of {found} values while the grid has {expected} pixels")]
pub struct FlowSize {
    from: usize,
    to: usize,
    found: usize,
    expected: usize,
}

/// Targets that do not depend on the projection: the pixel plus its flow, asked of `F` when an edge enters and dropped when
/// it leaves. Motion is not judged here: static confidence is 1, and a robust weight of the adjustment takes its
/// place (`TrackerSettings::robust`).
pub struct FlowCorrespondence<F> {
    grid: Grid,
    damping: f32,
    flow: F,
    edges: HashMap<EdgeId, DenseFlow>,
}

impl<F, E> FlowCorrespondence<F>
where
    F: FnMut(usize, usize) -> Result<DenseFlow, E>,
    E: std::error::Error + Send + Sync + 'static,
{
    /// `flow(i, j)` gives the flow from frame `i` to frame `j` of the clip. `damping` is that of all disparities; a
    /// network's is about 0.005.
    pub fn new(grid: Grid, damping: f32, flow: F) -> Self {
        Self {
            grid,
            damping,
            flow,
            edges: HashMap::new(),
        }
    }

    fn ask(&mut self, from: usize, to: usize) -> Result<DenseFlow, CorrespondenceError> {
        let fail = |reason| CorrespondenceError::Edge {
            source_frame: from,
            target_frame: to,
            reason,
        };
        let flow = (self.flow)(from, to).map_err(|e| fail(Box::new(e)))?;
        let expected = self.grid.len();
        let sizes = [flow.flow_px[0].len(), flow.flow_px[1].len(), flow.confidence.len()];
        match sizes.into_iter().find(|&n| n != expected) {
            None => Ok(flow),
            Some(found) => Err(fail(Box::new(FlowSize {
                from,
                to,
                found,
                expected,
            }))),
        }
    }
}

impl<F, E> Correspondence for FlowCorrespondence<F>
where
    F: FnMut(usize, usize) -> Result<DenseFlow, E>,
    E: std::error::Error + Send + Sync + 'static,
{
    fn change(&mut self, changes: &EdgeChanges) -> Result<(), CorrespondenceError> {
        for key in &changes.entered {
            let flow = self.ask(key.source_frame, key.target_frame)?;
            self.edges.insert(key.id, flow);
        }
        for key in &changes.left {
            self.edges.remove(&key.id);
        }
        Ok(())
    }

    fn revise(&mut self, revision: &mut Revision<'_>) -> Result<(), CorrespondenceError> {
        let width = revision.grid.width;
        for edge in &mut revision.edges {
            let Some(flow) = self.edges.get(&edge.key.id) else {
                let known = "the edge was never announced";
                return Err(CorrespondenceError::Source(known.into()));
            };
            for n in 0..revision.grid.len() {
                edge.target_px[0][n] = (n % width) as f32 + flow.flow_px[0][n];
                edge.target_px[1][n] = (n / width) as f32 + flow.flow_px[1][n];
            }
            for plane in edge.weight.iter_mut() {
                plane.copy_from_slice(&flow.confidence);
            }
            edge.static_confidence.fill(1.0);
        }
        for source in &mut revision.sources {
            source.damping.fill(self.damping);
        }
        Ok(())
    }

    fn motion_px(&mut self, from_frame: usize, to_frame: usize) -> Result<f64, CorrespondenceError> {
        let flow = self.ask(from_frame, to_frame)?;
        let [u, v] = &flow.flow_px;
        let (mut sum, mut weight) = (0.0, 0.0);
        for (n, &c) in flow.confidence.iter().enumerate() {
            sum += f64::from(c) * f64::from(u[n].hypot(v[n]));
            weight += f64::from(c);
        }
        // Nothing in common: as far apart as can be.
        Ok(if weight > 0.0 { sum / weight } else { f64::INFINITY })
    }
}
