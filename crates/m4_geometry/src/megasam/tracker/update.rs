//! One update: project, let the correspondences be revised, adjust.

use super::correspondence::{Correspondence, EdgeRevision, Revision, SourceRevision};
use super::error::TrackerError;
use super::keyframes::Keyframes;
use crate::dba::{DbaOptions, DbaReport, Factor, Problem, adjust};
use crate::megasam::graph::{FactorGraph, GraphEdge, projected_planes};
use rayon::prelude::*;
use std::ops::Range;

/// Added to every damping, as published.
const LEAST_DAMPING: f32 = 1e-7;

/// What takes part in an update.
pub(super) struct Update {
    pub options: DbaOptions,
    /// Frames whose poses move.
    pub window: Range<usize>,
    /// Inactive edges count when both ends are at least this; `None` leaves them out.
    pub inactive_from: Option<usize>,
    /// Source frames revised at once; `None` for all.
    pub batch: Option<usize>,
}

impl Update {
    /// Runs one update on `graph`.
    pub(super) fn run(
        &self,
        keyframes: &mut Keyframes,
        graph: &mut FactorGraph,
        source: &mut dyn Correspondence,
    ) -> Result<DbaReport, TrackerError> {
        let changes = graph.take_changes();
        if !(changes.entered.is_empty() && changes.left.is_empty()) {
            source.change(&changes)?;
        }
        revise(keyframes, graph, source, self.batch)?;
        let inactive = graph.inactive.iter().filter(|e| {
            self.inactive_from
                .is_some_and(|from| e.factor.source >= from && e.factor.target >= from)
        });
        let edges: Vec<&Factor<f32>> = inactive.chain(&graph.active).map(|e| &e.factor).collect();
        let eta: Vec<Vec<f32>> = keyframes
            .damping
            .iter()
            .map(|plane| plane.iter().map(|&x| x + LEAST_DAMPING).collect())
            .collect();
        let problem = Problem {
            edges: &edges,
            eta: &eta,
        };
        let report = adjust(&mut keyframes.geometry, &problem, self.window.clone(), &self.options)?;
        graph.grow_older();
        let finite = |x: &[f64]| x.iter().all(|x| x.is_finite());
        let poses = keyframes.geometry.poses[self.window.clone()].iter();
        let sound = poses
            .into_iter()
            .all(|p| finite(p.rotation.as_slice()) && finite(p.translation.as_slice()));
        if !sound || !keyframes.geometry.lens.fx.is_finite() {
            return Err(TrackerError::Diverged {
                keyframes: keyframes.len(),
            });
        }
        Ok(report)
    }
}

/// Lets all active edges be revised, those of `batch` source frames at a time.
fn revise(
    keyframes: &mut Keyframes,
    graph: &mut FactorGraph,
    source: &mut dyn Correspondence,
    batch: Option<usize>,
) -> Result<(), TrackerError> {
    let mut sources: Vec<usize> = graph.active.iter().map(|e| e.factor.source).collect();
    sources.sort_unstable();
    sources.dedup();
    let mut groups: Vec<Vec<&mut GraphEdge>> = sources.iter().map(|_| Vec::new()).collect();
    for edge in &mut graph.active {
        if let Ok(k) = sources.binary_search(&edge.factor.source) {
            groups[k].push(edge);
        }
    }
    let geometry = &keyframes.geometry;
    let mut damping: Vec<Option<&mut Vec<f32>>> = keyframes.damping.iter_mut().map(Some).collect();
    let mut groups: Vec<_> = sources.into_iter().zip(groups).collect();
    let size = batch.unwrap_or(groups.len()).max(1);
    for part in groups.chunks_mut(size) {
        let ends: Vec<(usize, usize)> = part
            .iter()
            .flat_map(|(_, edges)| edges.iter().map(|e| e.ends()))
            .collect();
        let planes: Vec<[Vec<f32>; 2]> = ends
            .par_iter()
            .map(|&(i, j)| projected_planes(geometry, i, j))
            .collect();
        let mut planes = planes.into_iter();
        let mut revision = Revision {
            grid: geometry.grid,
            edges: Vec::new(),
            sources: Vec::new(),
        };
        for (frame, edges) in part.iter_mut() {
            let begin = revision.edges.len();
            for (edge, projected_px) in edges.iter_mut().zip(&mut planes) {
                let edge: &mut GraphEdge = edge;
                revision.edges.push(EdgeRevision {
                    key: edge.key,
                    projected_px,
                    target_px: &mut edge.factor.target_px,
                    weight: &mut edge.factor.weight,
                    static_confidence: &mut edge.static_confidence,
                });
            }
            if let Some(damping) = damping[*frame].take() {
                revision.sources.push(SourceRevision {
                    frame: keyframes.frame[*frame],
                    edges: begin..revision.edges.len(),
                    damping,
                });
            }
        }
        source.revise(&mut revision)?;
        for edge in &mut revision.edges {
            for plane in edge.weight.iter_mut() {
                for (w, &m) in plane.iter_mut().zip(edge.static_confidence.iter()) {
                    *w *= m;
                }
            }
        }
    }
    Ok(())
}
