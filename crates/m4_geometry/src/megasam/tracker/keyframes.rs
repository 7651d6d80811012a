//! The frames whose geometry is adjusted.

use crate::dba::{Geometry, Grid, Pinhole};
use m4_core::Se3;

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

    /// Adds a frame at `pose`. Its disparity is the sensor's, far away where that is unknown; a frame of which nothing is
    /// known gets the mean disparity of frame `like`, or 1 without one.
    pub fn push(&mut self, input: &FrameInput, pose: Se3<f64>, like: Option<usize>) {
        let mean = like.map_or(1.0, |k| {
            let plane = &self.geometry.disparity[k];
            (plane.iter().map(|&d| f64::from(d)).sum::<f64>() / plane.len().max(1) as f64) as f32
        });
        let known = input.sensor.iter().any(|&d| d > 0.0);
        let rest = if known { UNKNOWN_DISPARITY } else { mean };
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
