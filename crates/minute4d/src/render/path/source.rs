//! The source camera, interpolated between its frames.

use super::{PathError, Stop};
use crate::render::DEFAULT_FPS;
use crate::render::spline::PoseSpline;
use m4_core::{Camera, Exposure, Intrinsics, Scene, SourceFrame};

/// The source camera at any moment.
#[derive(Debug, Clone)]
pub struct SourcePath {
    /// Those with a moment of their own, in order of time.
    frames: Vec<SourceFrame>,
    times: Vec<f64>,
    poses: PoseSpline,
    /// Frames of the scene a second.
    pub frames_per_s: f64,
}

impl SourcePath {
    /// The source cameras of a scene; of several cameras at one moment the first. `path` is for the message.
    ///
    /// # Errors
    ///
    /// [`PathError::NoSource`].
    pub fn new(scene: &Scene, path: &str) -> Result<Self, PathError> {
        let mut frames: Vec<SourceFrame> = scene.source.clone();
        frames.sort_by(|a, b| a.t.total_cmp(&b.t));
        frames.dedup_by(|later, kept| later.t <= kept.t);
        if frames.is_empty() {
            return Err(PathError::NoSource { path: path.to_owned() });
        }
        let times: Vec<f64> = frames.iter().map(|f| f.t).collect();
        let poses = frames.iter().map(|f| f.camera.c2w).collect();
        let last = scene.time_frames.saturating_sub(1) as f64;
        let frames_per_s = match scene.duration_s {
            Some(duration_s) if duration_s > 0.0 && last > 0.0 => last / duration_s,
            _ => DEFAULT_FPS,
        };
        Ok(Self {
            poses: PoseSpline::new(times.clone(), poses),
            frames,
            times,
            frames_per_s,
        })
    }

    /// First and last moment, frames.
    #[must_use]
    pub fn span(&self) -> (f64, f64) {
        (self.times[0], self.times[self.times.len() - 1])
    }

    /// From the first to the last frame, seconds.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        let (first, last) = self.span();
        (last - first) / self.frames_per_s
    }

    /// The moment (frames) this many seconds after the first frame.
    #[must_use]
    pub fn moment(&self, seconds: f64) -> f64 {
        let (first, last) = self.span();
        (first + seconds * self.frames_per_s).clamp(first, last)
    }

    /// Camera and exposure at a moment (frames); lens and exposure go evenly from frame to frame.
    #[must_use]
    pub fn at(&self, t: f64) -> Stop {
        let last = self.times.len() - 1;
        let next = self.times.partition_point(|time| *time <= t).min(last);
        let before = if self.times[next] <= t {
            next
        } else {
            next.saturating_sub(1)
        };
        let (a, b) = (&self.frames[before], &self.frames[next]);
        let gap = self.times[next] - self.times[before];
        let u = if gap > 0.0 {
            ((t - self.times[before]) / gap).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let size = &self.frames[0].camera.intrinsics;
        let lens = |frame: &SourceFrame| frame.camera.intrinsics.resized(size.width, size.height);
        Stop {
            camera: Camera {
                intrinsics: between_lenses(&lens(a), &lens(b), u),
                c2w: self.poses.at(t),
            },
            t,
            exposure: between_exposures(&a.exposure, &b.exposure, u),
        }
    }
}

fn between_lenses(a: &Intrinsics, b: &Intrinsics, u: f64) -> Intrinsics {
    let mix = |x: f64, y: f64| x + (y - x) * u;
    Intrinsics {
        fx: mix(a.fx, b.fx),
        fy: mix(a.fy, b.fy),
        cx: mix(a.cx, b.cx),
        cy: mix(a.cy, b.cy),
        ..*a
    }
}

fn between_exposures(a: &Exposure, b: &Exposure, u: f64) -> Exposure {
    let mix = |x: f32, y: f32| x + (y - x) * u as f32;
    Exposure {
        matrix: std::array::from_fn(|i| std::array::from_fn(|j| mix(a.matrix[i][j], b.matrix[i][j]))),
        offset: std::array::from_fn(|i| mix(a.offset[i], b.offset[i])),
    }
}
