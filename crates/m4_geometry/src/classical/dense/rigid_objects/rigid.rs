//! A part as a rigid body: dense bundle adjustment of the camera against it, of the whole part and
//! then of the largest piece of it that is rigid.

use super::edges::Part;
use super::shape::{Shape, Whole, shrink_relief};
use super::shape_prior::ShapePrior;
use super::{BLOCK_PX, Tracklet, WorkingClip, joints, pieces, relief, reversal, silhouette};
use crate::dba::{DbaOptions, Factor, Free, Geometry, Pinhole, Problem, adjust};
use m4_core::{Camera, Progress, Se3, quantile};
use nalgebra::Vector3;

/// Fewest adjusted pixels per frame.
const LEAST_POINTS: usize = 12;
/// Noise of the flow, pixels at the working size (scale of the Cauchy weight).
pub(super) const NOISE_PX: f64 = 0.6;
/// Weight of the disparity that contact suggests.
const PRIOR: f64 = 0.001;
/// Residual that counts half, pixels of the grid.
const CAUCHY_PX: f64 = NOISE_PX / BLOCK_PX as f64;
/// The steps of an adjustment from a flat part that moves as a static one would: what is free,
/// iterations, and how many times the usual residual counts half. At first all residuals count, so
/// that a motion far from the start is reached (graduated non-convexity; Blake and Zisserman 1987).
const FROM_AFAR: [(Free, usize, f64); 10] = [
    (Free::Poses, 6, 16.0),
    (Free::PosesAndDepth, 6, 16.0),
    (Free::Poses, 6, 8.0),
    (Free::PosesAndDepth, 6, 8.0),
    (Free::Poses, 6, 4.0),
    (Free::PosesAndDepth, 6, 4.0),
    (Free::Poses, 6, 2.0),
    (Free::PosesAndDepth, 6, 2.0),
    (Free::Poses, 6, 1.0),
    (Free::PosesAndDepth, 20, 1.0),
];
/// The same of a part whose shape was mirrored.
const FROM_NEARBY: [(Free, usize, f64); 3] = [
    (Free::Poses, 6, 4.0),
    (Free::PosesAndDepth, 6, 4.0),
    (Free::PosesAndDepth, 10, 1.0),
];
/// The same of one whose relief is held.
const HELD: [(Free, usize, f64); 1] = [(Free::PosesAndDepth, 8, 1.0)];
/// How often relief is held to a plane at the distance of each frame.
const ROUNDS: usize = 5;

/// Adjusts one part; `before` is the disparity that it was believed to have. Each rigid piece of it
/// has its shape by itself; the rest is above or below the nearest of them, by `down` (in the
/// world, of length 1), or as far as that. Stops between steps where `progress` says so.
pub(super) fn reconstruct(
    clip: &WorkingClip<'_>,
    tracklet: &Tracklet,
    before: &[Vec<f32>],
    down: Option<Vector3<f64>>,
    progress: &dyn Progress,
) -> Option<Shape> {
    let part = Part::of(clip, tracklet);
    let prior = ShapePrior::of(&part, down.as_ref());
    let start = Start::of(&part, before, &prior, progress)?;
    let (geometry, mut disparity) = start.adjust(&part, &part.factors(), None)?;
    shrink_relief(clip, tracklet, &mut disparity);
    let unit = f64::from(start.unit);
    let whole = Shape {
        blocks: part.blocks.clone(),
        poses: poses(geometry, unit),
        disparity,
        whole: None,
    };
    let pieces = pieces::pieces(&part);
    let mut adjusted = pieces.iter().map_while(|piece| {
        let mut edges = part.factors();
        for edge in &mut edges {
            for weight in &mut edge.weight {
                let own = weight.iter_mut().zip(&piece[edge.source]);
                own.for_each(|(weight, share)| *weight *= share);
            }
        }
        start.adjust(&part, &edges, Some(piece))
    });
    let Some((geometry, mut disparity)) = adjusted.next() else {
        return Some(whole);
    };
    for (_, other) in adjusted {
        joints::attach(&part, &prior, &mut disparity, &other);
    }
    let mut ratios: Vec<f32> = (disparity.iter().flatten())
        .zip(whole.disparity.iter().flatten())
        .filter(|(own, of_whole)| **own > 0.0 && **of_whole > 0.0)
        .map(|(own, of_whole)| own / of_whole)
        .collect();
    let Some(ratio) = quantile(&mut ratios, 0.5) else {
        return Some(whole);
    };
    // A frame without a piece has the shape of the whole.
    for (own, of_whole) in disparity.iter_mut().zip(&whole.disparity) {
        if own.iter().all(|d| *d <= 0.0) {
            *own = of_whole.iter().map(|d| d * ratio).collect();
        }
    }
    relief::fill(&part, &prior.upright, &mut disparity);
    Some(Shape {
        poses: poses(geometry, unit),
        disparity,
        whole: Some(Whole {
            shape: Box::new(whole),
            ratio,
        }),
        blocks: part.blocks,
    })
}

/// Poses in the unit of the cameras.
fn poses(geometry: Geometry<f32>, unit: f64) -> Vec<Se3<f64>> {
    let mut poses = geometry.poses;
    for pose in &mut poses {
        pose.translation /= unit;
    }
    poses
}

/// What an adjustment starts from: a flat part that moves as a static one would.
struct Start<'a> {
    geometry: Geometry<f32>,
    /// Disparities count in units of the part's own, so that one prior fits near and far parts.
    unit: f32,
    prior: &'a ShapePrior,
    progress: &'a dyn Progress,
}

impl<'a> Start<'a> {
    fn of(
        part: &Part<'_>,
        before: &[Vec<f32>],
        prior: &'a ShapePrior,
        progress: &'a dyn Progress,
    ) -> Option<Self> {
        let (clip, blocks, frames) = (part.clip, &part.blocks, part.frames());
        let (grid, first) = (blocks.grid, part.tracklet.first);
        let suggested = |k: usize, g: usize| {
            let (x, y) = blocks.pixel(g);
            match part.has(k, g) {
                true => before[first + k][y * clip.width + x],
                false => 0.0,
            }
        };
        let mut sensor: Vec<Vec<f32>> = (0..frames)
            .map(|k| (0..grid.len()).map(|g| suggested(k, g)).collect())
            .collect();
        let factors = silhouette::one_size(clip, part.tracklet, &sensor);
        for (sensor, factor) in sensor.iter_mut().zip(factors) {
            sensor.iter_mut().for_each(|d| *d *= factor);
        }
        let known = || sensor.iter().flatten().filter(|d| **d > 0.0);
        let count = known().count();
        let unit = known().sum::<f32>() / count.max(1) as f32;
        if unit <= 0.0 || count < LEAST_POINTS * frames {
            return None;
        }
        sensor.iter_mut().flatten().for_each(|d| *d /= unit);
        let scaled = |camera: &Camera| {
            let mut pose = camera.w2c();
            pose.translation *= f64::from(unit);
            pose
        };
        let k = clip.cameras[first].intrinsics;
        let lens = Pinhole::of_image(k.fx, k.fy, k.cx, k.cy, BLOCK_PX as f64);
        let [left, top] = blocks.corner;
        let geometry = Geometry {
            grid,
            lens: Pinhole {
                cx: lens.cx - left as f64,
                cy: lens.cy - top as f64,
                ..lens
            },
            poses: clip.cameras[first..first + frames]
                .iter()
                .map(scaled)
                .collect(),
            disparity: sensor
                .iter()
                .map(|s| s.iter().map(|d| if *d > 0.0 { *d } else { 1.0 }).collect())
                .collect(),
            sensor,
        };
        Some(Self {
            geometry,
            unit,
            prior,
            progress,
        })
    }

    /// Adjusts the part, or the piece that blocks belong to by these shares; with a piece, relief
    /// is held by its variance. Returns the disparities, too, 0 where there is none.
    fn adjust(
        &self,
        part: &Part<'_>,
        edges: &[Factor<f32>],
        piece: Option<&[Vec<f32>]>,
    ) -> Option<(Geometry<f32>, Vec<Vec<f32>>)> {
        let mut geometry = self.geometry.clone();
        for (sensor, share) in geometry.sensor.iter_mut().zip(piece.into_iter().flatten()) {
            let other = sensor.iter_mut().zip(share).filter(|(_, s)| **s <= 0.0);
            other.for_each(|(sensor, _)| *sensor = 0.0);
        }
        let frames = part.frames();
        let eta = vec![vec![1.0f32; geometry.grid.len()]; frames];
        let edges: Vec<&_> = edges.iter().collect();
        let problem = Problem {
            edges: &edges,
            eta: &eta,
        };
        let run = |geometry: &mut Geometry<f32>, steps: &[(Free, usize, f64)], prior: f64| {
            let mut solved = false;
            for &(free, iterations, tolerance) in steps {
                if self.progress.cancelled() {
                    return None;
                }
                let options = DbaOptions {
                    free,
                    iterations,
                    lm: 1e-4,
                    ep: 1e-4,
                    prior_alpha: Some(prior),
                    cauchy_px: Some(tolerance * CAUCHY_PX),
                    min_depth: 0.1,
                    #[cfg(test)]
                    python_twin: false,
                };
                let report = adjust(geometry, &problem, 1..frames, &options).ok()?;
                solved = report.failed < report.iterations;
            }
            solved.then_some(())
        };
        run(&mut geometry, &FROM_AFAR, PRIOR)?;
        reversal::resolve(
            &mut geometry,
            &edges,
            part.clip.rate,
            CAUCHY_PX,
            |other| self.prior.log_probability(other),
            |other| run(other, &FROM_NEARBY, PRIOR),
        );
        if piece.is_some() {
            let prior = relief::prior(part, &geometry, &edges)?;
            for _ in 0..ROUNDS {
                relief::flatten(&mut geometry);
                run(&mut geometry, &HELD, prior)?;
            }
            relief::agree(&mut geometry, &edges);
        }
        let disparity = (geometry.disparity.iter())
            .zip(&geometry.sensor)
            .map(|(d, sensor)| {
                let own = |(d, s): (&f32, &f32)| if *s > 0.0 { d * self.unit } else { 0.0 };
                d.iter().zip(sensor).map(own).collect()
            })
            .collect();
        Some((geometry, disparity))
    }
}
