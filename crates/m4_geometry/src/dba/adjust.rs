//! The fast path: Gauss-Newton iterations over f32 planes, the product's solver.

use super::lanes::Rays;
use super::options::{DbaOptions, DbaReport};
use super::problem::{DbaError, Factor, Geometry, Problem};
use super::solve::System;
use super::source::{Context, Source};
use fearless_simd::Level;
use m4_core::Se3;
use rayon::prelude::*;
use std::ops::Range;

/// Sources whose shares exist at the same time: bounds memory.
const SOURCES_AT_ONCE: usize = 64;

/// The edges by source frame, ascending; within a source in the order given.
pub(super) fn by_source<'a>(edges: &[&'a Factor<f32>], frames: usize) -> Vec<Source<'a>> {
    let mut all: Vec<Source<'a>> = (0..frames)
        .map(|frame| Source {
            frame,
            edges: Vec::new(),
        })
        .collect();
    for &edge in edges {
        all[edge.source].edges.push(edge);
    }
    all.retain(|s| !s.edges.is_empty());
    all
}

/// Moves poses, disparities and focal length towards what the edges say. `window` holds the frames whose poses
/// move; the disparities of every source frame move where `options.free` says so. The result does not
/// depend on the number of threads.
///
/// # Errors
///
/// [`DbaError`] where sizes or indices do not fit.
pub fn adjust(
    geometry: &mut Geometry<f32>,
    problem: &Problem<'_, f32>,
    window: Range<usize>,
    options: &DbaOptions,
) -> Result<DbaReport, DbaError> {
    adjust_on(Level::new(), geometry, problem, window, options)
}

/// [`adjust`] with the instructions of `level`.
pub(super) fn adjust_on(
    level: Level,
    geometry: &mut Geometry<f32>,
    problem: &Problem<'_, f32>,
    window: Range<usize>,
    options: &DbaOptions,
) -> Result<DbaReport, DbaError> {
    problem.check(geometry, &window)?;
    let sources = by_source(problem.edges, geometry.frames());
    let mut report = DbaReport::default();
    for _ in 0..options.iterations {
        report.iterations += 1;
        let context = Context {
            geometry,
            eta: problem.eta,
            rays: Rays::new(geometry.grid, &geometry.lens),
            options,
            level,
        };
        let mut system = System::new(window.clone(), options.free.focal());
        for group in sources.chunks(SOURCES_AT_ONCE) {
            let parts: Vec<_> = group.par_iter().map(|s| s.reduce(&context)).collect();
            for part in &parts {
                system.add(part);
            }
        }
        report.rms_px = system.rms_px();
        let Some(step) = system.solve(geometry.frames(), options) else {
            report.failed += 1;
            continue;
        };
        let disparity: Vec<(usize, Vec<f32>)> = if options.free.depth() {
            let steps = sources.par_iter();
            steps
                .map(|s| (s.frame, s.substitute(&context, &step.twists, step.focal)))
                .collect()
        } else {
            Vec::new()
        };
        for (frame, plane) in disparity {
            geometry.disparity[frame] = plane;
        }
        for frame in window.clone() {
            geometry.poses[frame] = Se3::exp(&step.twists[frame]).compose(&geometry.poses[frame]);
        }
        if options.free.focal() {
            geometry.lens = geometry.lens.with_focal_step(step.focal);
        }
    }
    Ok(report)
}
