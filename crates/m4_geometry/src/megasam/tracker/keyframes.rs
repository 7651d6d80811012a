//! The frames whose geometry is adjusted, and one update of it: project, let the correspondences be
//! revised, adjust.

use super::correspondence::{Correspondence, EdgeRevision, Revision, SourceRevision, TrackerError};
use crate::dba::{DbaOptions, DbaReport, Factor, Geometry, Grid, Pinhole, Problem, adjust};
use crate::megasam::graph::{FactorGraph, GraphEdge, projected_planes};
use m4_core::Se3;
use rayon::prelude::*;
use std::ops::Range;

/// Disparity of a pixel of unknown depth in a frame where some are known: far away.
const UNKNOWN_DISPARITY: f32 = 1e-3;

/// Damping before the first revision.
const INITIAL_DAMPING: f32 = 1e-6;

/// One frame as it is submitted.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameInput {
    /// Number in the clip.
    pub frame: usize,
    /// Instant, seconds.
    pub time_s: f64,
    /// Disparity of a sensor or network, `[height * width]`; 0 where unknown.
    pub sensor: Vec<f32>,
}

/// Geometry with the identity of every frame. All lists are `[keyframes]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyframes {
    /// Poses, disparities and lens.
    pub geometry: Geometry<f32>,
    /// Number in the clip.
    pub frame: Vec<usize>,
    /// Instant, seconds.
    pub time_s: Vec<f64>,
    /// Damping of disparities, `[height * width]` each.
    pub damping: Vec<Vec<f32>>,
}

impl Keyframes {
    /// Without frames.
    #[must_use]
    pub fn new(grid: Grid, lens: Pinhole<f64>) -> Self {
        Self {
            geometry: Geometry {
                grid,
                lens,
                poses: Vec::new(),
                disparity: Vec::new(),
                sensor: Vec::new(),
            },
            frame: Vec::new(),
            time_s: Vec::new(),
            damping: Vec::new(),
        }
    }

    /// Number of keyframes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.frame.len()
    }

    /// True before the first.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.frame.is_empty()
    }

    /// Adds a frame at `pose`. Its disparity is the sensor's, far away where that is unknown; a
    /// frame of which nothing is known gets the mean disparity of frame `like`, or 1 without one.
    pub fn push(&mut self, input: &FrameInput, pose: Se3<f64>, like: Option<usize>) {
        let mean = like.map_or(1.0, |k| {
            let plane = &self.geometry.disparity[k];
            (plane.iter().map(|&d| f64::from(d)).sum::<f64>() / plane.len().max(1) as f64) as f32
        });
        let has_depth = input.sensor.iter().any(|&d| d > 0.0);
        let rest = if has_depth { UNKNOWN_DISPARITY } else { mean };
        let start = input.sensor.iter().map(|&d| if d > 0.0 { d } else { rest });
        self.geometry.disparity.push(start.collect());
        self.geometry.sensor.push(input.sensor.clone());
        self.geometry.poses.push(pose);
        self.frame.push(input.frame);
        self.time_s.push(input.time_s);
        self.damping.push(vec![INITIAL_DAMPING; input.sensor.len()]);
    }

    /// Removes keyframe `k`; later ones move down.
    pub fn remove(&mut self, k: usize) {
        self.geometry.disparity.remove(k);
        self.geometry.sensor.remove(k);
        self.geometry.poses.remove(k);
        self.frame.remove(k);
        self.damping.remove(k);
        self.time_s.remove(k);
    }

    /// Keeps the first `count`.
    pub fn truncate(&mut self, count: usize) {
        self.geometry.disparity.truncate(count);
        self.geometry.sensor.truncate(count);
        self.geometry.poses.truncate(count);
        self.frame.truncate(count);
        self.time_s.truncate(count);
        self.damping.truncate(count);
    }

    /// Puts the sensor's disparity back where it is known.
    pub fn reset_to_sensor(&mut self, k: usize) {
        let g = &mut self.geometry;
        for (d, &s) in g.disparity[k].iter_mut().zip(&g.sensor[k]) {
            if s > 0.0 {
                *d = s;
            }
        }
    }
}

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
        let report = adjust(
            &mut keyframes.geometry,
            &problem,
            self.window.clone(),
            &self.options,
        )?;
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
