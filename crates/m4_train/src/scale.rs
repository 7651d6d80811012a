//! The size of the scene, in the unit of its poses.

use m4_core::{Capture, median, nalgebra::Vector3};

/// Lengths that rates and thresholds are measured in.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneScale {
    /// `max(1.1 * largest distance of a camera from their mean, 0.1 * median depth)`
    /// (docs/spec/optimiser.md 3).
    pub extent: f32,
    /// Median of the depth maps; without any, the extent of the cameras.
    pub median_depth: f32,
    /// Mean focal length at full size, pixels.
    pub focal_px: f32,
    /// All frames have the same centre of projection: a static camera, or one that only rotates.
    pub one_centre: bool,
    /// Centres of at most 32 cameras, evenly spread.
    pub centres: Vec<[f32; 3]>,
}

impl SceneScale {
    /// Measures a capture of at least one frame.
    pub fn of(capture: &Capture) -> Self {
        let n = capture.frames.len().max(1);
        let centres: Vec<Vector3<f64>> = capture.frames.iter().map(|f| f.camera.centre()).collect();
        let mean = centres.iter().sum::<Vector3<f64>>() / n as f64;
        let cameras = 1.1
            * centres
                .iter()
                .map(|c| (c - mean).norm())
                .fold(0.0, f64::max);
        let mut depths: Vec<f32> = Vec::new();
        for depth in capture.frames.iter().filter_map(|f| f.depth.as_ref()) {
            depths.extend(depth.every(37).filter(|z| z.is_finite() && *z > 0.0));
        }
        let median_depth =
            median(&mut depths).map_or(if cameras > 0.0 { cameras } else { 1.0 }, f64::from);
        let focal: f64 = capture
            .frames
            .iter()
            .map(|f| 0.5 * (f.camera.intrinsics.fx + f.camera.intrinsics.fy))
            .sum();
        Self {
            extent: cameras.max(0.1 * median_depth) as f32,
            median_depth: median_depth as f32,
            focal_px: (focal / n as f64) as f32,
            one_centre: centres.windows(2).all(|pair| pair[0] == pair[1]),
            centres: centres
                .iter()
                .step_by(n.div_ceil(32))
                .map(|c| [c.x as f32, c.y as f32, c.z as f32])
                .collect(),
        }
    }

    /// Distance to the nearest of [`Self::centres`].
    pub fn nearest_camera(&self, p: [f32; 3]) -> f32 {
        let square = |c: &[f32; 3]| (0..3).map(|k| (c[k] - p[k]) * (c[k] - p[k])).sum::<f32>();
        self.centres
            .iter()
            .map(square)
            .fold(f32::INFINITY, f32::min)
            .sqrt()
    }
}
