//! A part as a rigid body: dense bundle adjustment of the camera against it.

use super::edges::{Blocks, Inside, factors};
use super::shape::{Shape, shrink_relief};
use super::{BLOCK_PX, Tracklet, WorkingClip, reversal, silhouette};
use crate::dba::{DbaOptions, Free, Geometry, Pinhole, Problem, adjust};
use m4_core::Camera;

/// Fewest adjusted pixels per frame.
const LEAST_POINTS: usize = 12;
/// Noise of the flow, pixels at the working size (scale of the Cauchy weight).
const NOISE_PX: f64 = 0.6;
/// Weight of the disparity that contact suggests.
const PRIOR: f32 = 0.001;
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

/// Adjusts one part; `before` is the disparity that it was believed to have.
pub(super) fn reconstruct(
    clip: &WorkingClip<'_>,
    tracklet: &Tracklet,
    before: &[Vec<f32>],
) -> Option<Shape> {
    let (w, h) = (clip.width, clip.height);
    let blocks = Blocks::around(clip, tracklet);
    let grid = blocks.grid;
    let inside = Inside::of(clip, tracklet);
    let edges = factors(clip, tracklet, &inside, &blocks);
    let frames = tracklet.parts.len();
    let sensor: Vec<Vec<f32>> = (0..frames)
        .map(|k| {
            (0..grid.len())
                .map(|g| {
                    let (x, y) = blocks.pixel(g);
                    if inside.at(k, x as f32, y as f32, w, h) {
                        before[tracklet.first + k][y * w + x]
                    } else {
                        0.0
                    }
                })
                .collect()
        })
        .collect();
    let factors = silhouette::one_size(clip, tracklet, &sensor);
    let sensor: Vec<Vec<f32>> = (sensor.into_iter().zip(factors))
        .map(|(sensor, factor)| sensor.into_iter().map(|d| d * factor).collect())
        .collect();
    // Disparities count in units of the part's own, so that one prior fits near and far parts.
    let values: Vec<f32> = sensor
        .iter()
        .flatten()
        .copied()
        .filter(|d| *d > 0.0)
        .collect();
    let unit = values.iter().sum::<f32>() / values.len().max(1) as f32;
    if unit <= 0.0 || values.len() < LEAST_POINTS * frames {
        return None;
    }
    let scaled = |camera: &Camera| {
        let mut pose = camera.w2c();
        pose.translation *= f64::from(unit);
        pose
    };
    let sensor: Vec<Vec<f32>> = sensor
        .into_iter()
        .map(|s| s.into_iter().map(|d| d / unit).collect())
        .collect();
    let k = clip.cameras[tracklet.first].intrinsics;
    let lens = Pinhole::of_image(k.fx, k.fy, k.cx, k.cy, BLOCK_PX as f64);
    let [left, top] = blocks.corner;
    let mut geometry = Geometry {
        grid,
        lens: Pinhole {
            cx: lens.cx - left as f64,
            cy: lens.cy - top as f64,
            ..lens
        },
        poses: clip.cameras[tracklet.first..tracklet.first + frames]
            .iter()
            .map(scaled)
            .collect(),
        disparity: sensor
            .iter()
            .map(|s| s.iter().map(|d| if *d > 0.0 { *d } else { 1.0 }).collect())
            .collect(),
        sensor,
    };
    let eta = vec![vec![1.0f32; grid.len()]; frames];
    let refs: Vec<&_> = edges.iter().collect();
    let problem = Problem {
        edges: &refs,
        eta: &eta,
    };
    let run = |geometry: &mut Geometry<f32>, steps: &[(Free, usize, f64)]| {
        let mut solved = false;
        for &(free, iterations, tolerance) in steps {
            let options = DbaOptions {
                free,
                iterations,
                lm: 1e-4,
                ep: 1e-4,
                prior_alpha: Some(f64::from(PRIOR)),
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
    run(&mut geometry, &FROM_AFAR)?;
    reversal::resolve(&mut geometry, &refs, clip.rate, CAUCHY_PX, |other| {
        run(other, &FROM_NEARBY)
    });
    let mut disparity: Vec<Vec<f32>> = geometry
        .disparity
        .iter()
        .zip(&geometry.sensor)
        .map(|(d, s)| {
            d.iter()
                .zip(s)
                .map(|(d, s)| if *s > 0.0 { d * unit } else { 0.0 })
                .collect()
        })
        .collect();
    shrink_relief(clip, tracklet, &mut disparity);
    let mut poses = geometry.poses;
    for pose in &mut poses {
        pose.translation /= f64::from(unit);
    }
    Some(Shape {
        blocks,
        poses,
        disparity,
    })
}
