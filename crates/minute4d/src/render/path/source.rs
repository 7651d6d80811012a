//! The source camera, interpolated between its frames, and smoothed.

use crate::Refusal;
use crate::render::DEFAULT_FPS;
use crate::render::spline::{PoseSpline, quaternion};
use m4_core::nalgebra::{UnitQuaternion, Vector3};
use m4_core::{Camera, Exposure, Intrinsics, Scene, Se3, SourceFrame};

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
    /// The source cameras of a scene; of several cameras at one moment the first. `path` is for the
    /// message.
    ///
    /// # Errors
    ///
    /// A refusal of a scene without its cameras.
    pub fn new(scene: &Scene, path: &str) -> Result<Self, Refusal> {
        let mut frames: Vec<SourceFrame> = scene.source.clone();
        frames.sort_by(|a, b| a.t.total_cmp(&b.t));
        frames.dedup_by(|later, earlier| later.t <= earlier.t);
        if frames.is_empty() {
            return Err(Refusal::bad_input(format!(
                "the scene has no cameras of its source, so there is no camera path {path}; give a file of cameras"
            )));
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
    pub fn span(&self) -> (f64, f64) {
        (self.times[0], self.times[self.times.len() - 1])
    }

    /// From the first to the last frame, seconds.
    pub fn seconds(&self) -> f64 {
        let (first, last) = self.span();
        (last - first) / self.frames_per_s
    }

    /// The moment (frames) this many seconds after the first frame.
    pub fn moment(&self, seconds: f64) -> f64 {
        let (first, last) = self.span();
        (first + seconds * self.frames_per_s).clamp(first, last)
    }

    /// Camera and exposure at a moment (frames); lens and exposure go evenly from frame to frame.
    pub fn at(&self, t: f64) -> SourceFrame {
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
        SourceFrame {
            camera: Camera {
                intrinsics: between_lenses(&lens(a), &lens(b), u),
                c2w: self.poses.at(t),
            },
            t,
            exposure: between_exposures(&a.exposure, &b.exposure, u),
            distance_sigma: None,
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
        matrix: std::array::from_fn(|i| {
            std::array::from_fn(|j| mix(a.matrix[i][j], b.matrix[i][j]))
        }),
        offset: std::array::from_fn(|i| mix(a.offset[i], b.offset[i])),
    }
}

/// Samples a second that are smoothed.
const RATE_HZ: f64 = 60.0;
/// Most samples: five minutes; longer clips are sampled less often.
const MAX_SAMPLES: f64 = 18_000.0;
/// Half width of the window, standard deviations.
const WINDOW_SIGMAS: f64 = 3.0;

/// Standard deviation of the smoothing, seconds.
const SMOOTH_S: f64 = 0.5;
/// Furthest that the smoothed camera leaves the source, as a share of the distance of what it looks
/// at.
pub(super) const STRAY: f64 = 0.08;
/// Furthest that it turns away from the source, degrees.
pub(super) const STRAY_DEG: f64 = 5.0;

/// The smoothed poses of the source, by moment (frames); what the camera looks at is `distance`
/// away, world units.
pub fn stabilised(source: &SourcePath, distance: f64) -> PoseSpline {
    let (first, last) = source.span();
    let seconds = source.seconds();
    let steps = (seconds * RATE_HZ).ceil().clamp(1.0, MAX_SAMPLES);
    let count = if seconds > 0.0 { steps as usize + 1 } else { 1 };
    let times: Vec<f64> = (0..count)
        .map(|i| first + (last - first) * i as f64 / steps)
        .collect();
    let poses: Vec<Se3<f64>> = times.iter().map(|t| source.at(*t).camera.c2w).collect();
    let turns: Vec<UnitQuaternion<f64>> = poses.iter().map(|p| quaternion(&p.rotation)).collect();
    // Standard deviation in samples.
    let sigma = if count > 1 {
        SMOOTH_S / seconds * steps
    } else {
        1.0
    };
    let reach = (WINDOW_SIGMAS * sigma).ceil().min(count as f64) as usize;
    let smoothed = (0..count).map(|i| {
        let window = i.saturating_sub(reach)..(i + reach + 1).min(count);
        let mut line = Line::default();
        for j in window {
            let x = j as f64 - i as f64;
            let turn = (turns[i].inverse() * turns[j]).scaled_axis();
            let way = poses[j].translation - poses[i].translation;
            line.add(x, (-0.5 * (x / sigma).powi(2)).exp(), way, turn);
        }
        let (way, turn) = line.middle();
        let way = limited(way, STRAY * distance);
        let turn = limited(turn, STRAY_DEG.to_radians());
        Se3 {
            rotation: (turns[i] * UnitQuaternion::from_scaled_axis(turn))
                .to_rotation_matrix()
                .into_inner(),
            translation: poses[i].translation + way,
        }
    });
    let smoothed = smoothed.collect();
    PoseSpline::new(times, smoothed)
}

fn limited(d: Vector3<f64>, limit: f64) -> Vector3<f64> {
    d / (1.0 + (d.norm() / limit).powi(8)).powf(0.125)
}

/// Sums of a weighted least-squares line.
#[derive(Default)]
struct Line {
    weight: f64,
    x: f64,
    xx: f64,
    y: [Vector3<f64>; 2],
    xy: [Vector3<f64>; 2],
}

impl Line {
    fn add(&mut self, x: f64, weight: f64, way: Vector3<f64>, turn: Vector3<f64>) {
        self.weight += weight;
        self.x += weight * x;
        self.xx += weight * x * x;
        for (k, y) in [way, turn].into_iter().enumerate() {
            self.y[k] += y * weight;
            self.xy[k] += y * (weight * x);
        }
    }

    /// Returns the value of the line at 0.
    fn middle(&self) -> (Vector3<f64>, Vector3<f64>) {
        let d = self.weight * self.xx - self.x * self.x;
        let at = |k: usize| {
            if d > 1e-12 * self.weight * self.weight {
                (self.y[k] * self.xx - self.xy[k] * self.x) / d
            } else {
                self.y[k] / self.weight
            }
        };
        (at(0), at(1))
    }
}
