//! Interpolates cameras between the keyframes of a file.

use super::SourcePath;
use crate::render::spline::{PoseSpline, Spline};
use crate::render::swing::looking;
use crate::render::{Moment, Span, TimeError};
use m4_core::{
    Camera, Exposure, Intrinsics, SourceFrame,
    nalgebra::{Vector1, Vector3},
};
use m4_io::trajectory::{KeyPose, Keyed, Keyframe, SceneTime};

/// Nodes beyond the ends of a closed path, so that it has no corner there.
const WRAPPED: usize = 2;

/// A camera path through keyframes.
pub struct KeyedPath {
    start_s: f64,
    /// From the first keyframe to the last, or back to the first where the path is closed.
    pub seconds: f64,
    /// Whether the path is closed.
    pub closed: bool,
    way: Interpolation,
    /// Natural logarithm of the focal length in image heights.
    zoom: Spline<1>,
    /// Times of the path and moments of the scene (frames), straight between.
    clock: Vec<(f64, f64)>,
    last_frame: f64,
    size: (usize, usize),
}

enum Interpolation {
    /// Position and direction apart.
    Poses(PoseSpline),
    /// Every keyframe looks at a point: so does every camera between.
    Targets {
        centres: Spline<3>,
        targets: Spline<3>,
        downs: Spline<3>,
    },
}

impl KeyedPath {
    /// The path through the keyframes of a file; what they leave open is as in the source.
    pub fn new(keyed: &Keyed, source: &SourcePath, span: &Span) -> Result<Self, TimeError> {
        let (first_moment, _) = source.span();
        let own = source.at(first_moment).camera;
        let keys = &keyed.keyframes;
        let (first, last) = (&keys[0], &keys[keys.len() - 1]);
        let back_s = keyed.back_s.filter(|_| keys.len() > 1);
        let seconds = last.time_s - first.time_s + back_s.unwrap_or(0.0);
        let (order, times) = nodes(keys, back_s.map(|_| seconds));
        let k = &own.intrinsics;
        let size = keyed.size.unwrap_or((k.width, k.height));
        let focal = |key: &Keyframe| match key.fov_y_deg {
            Some(degrees) => 0.5 / (0.5 * degrees).to_radians().tan(),
            None => k.fy / k.height as f64,
        };
        let zoom = order
            .iter()
            .map(|i| Vector1::new(focal(&keys[*i]).ln()))
            .collect();
        Ok(Self {
            start_s: first.time_s,
            seconds,
            closed: back_s.is_some(),
            way: Interpolation::new(keys, &order, &times, &mean_down(source)),
            zoom: Spline::new(times, zoom),
            clock: clock(keys, back_s.map(|_| seconds), source.frames_per_s, span)?,
            last_frame: span.time_frames.saturating_sub(1) as f64,
            size,
        })
    }

    /// The camera this many seconds after the first keyframe.
    pub fn at(&self, path_s: f64) -> SourceFrame {
        let time = self.start_s + path_s;
        let (width, height) = self.size;
        let focal_px = self.zoom.at(time).x.exp() * height as f64;
        SourceFrame {
            camera: Camera {
                intrinsics: Intrinsics::centred(width, height, focal_px),
                c2w: self.way.at(time),
            },
            t: straight(&self.clock, time).clamp(0.0, self.last_frame),
            exposure: Exposure::IDENTITY,
            distance_sigma: None,
        }
    }
}

impl Interpolation {
    fn new(keys: &[Keyframe], order: &[usize], times: &[f64], down: &Vector3<f64>) -> Self {
        let looks: Option<Vec<[Vector3<f64>; 3]>> = order
            .iter()
            .map(|i| match keys[*i].pose {
                KeyPose::LookAt {
                    position,
                    look_at,
                    up,
                } => Some([position, look_at, up.map_or(*down, |up| -up.normalize())]),
                KeyPose::C2w(_) => None,
            })
            .collect();
        if let Some(looks) = looks {
            let part =
                |k: usize| Spline::new(times.to_vec(), looks.iter().map(|look| look[k]).collect());
            return Self::Targets {
                centres: part(0),
                targets: part(1),
                downs: part(2),
            };
        }
        let poses = order.iter().map(|i| match keys[*i].pose {
            KeyPose::C2w(pose) => pose,
            KeyPose::LookAt {
                position,
                look_at,
                up,
            } => looking(position, &look_at, &up.map_or(*down, |up| -up)),
        });
        Self::Poses(PoseSpline::new(times.to_vec(), poses.collect()))
    }

    fn at(&self, time: f64) -> m4_core::Se3<f64> {
        match self {
            Self::Poses(poses) => poses.at(time),
            Self::Targets {
                centres,
                targets,
                downs,
            } => looking(centres.at(time), &targets.at(time), &downs.at(time)),
        }
    }
}

/// Keyframes in the order of the nodes, and the times of the nodes; a closed path continues beyond
/// its ends.
fn nodes(keys: &[Keyframe], period: Option<f64>) -> (Vec<usize>, Vec<f64>) {
    let n = keys.len();
    let Some(period) = period else {
        return ((0..n).collect(), keys.iter().map(|k| k.time_s).collect());
    };
    let (from, to) = (-(WRAPPED as isize), (n + WRAPPED) as isize);
    (from..=to)
        .map(|i| {
            let (round, i) = (i.div_euclid(n as isize), i.rem_euclid(n as isize) as usize);
            (i, keys[i].time_s + period * round as f64)
        })
        .unzip()
}

/// Downwards in the images of the source, on the whole.
fn mean_down(source: &SourcePath) -> Vector3<f64> {
    let (first, last) = source.span();
    let down = |share: f64| {
        source
            .at(first + (last - first) * share)
            .camera
            .c2w
            .rotation
            .column(1)
            .into_owned()
    };
    let sum = (0..=8).fold(Vector3::zeros(), |sum, i| sum + down(f64::from(i) / 8.0));
    if sum.norm() > 1e-3 {
        sum.normalize()
    } else {
        down(0.0)
    }
}

/// Moments of the scene at the keyframes, and at the end of a closed path.
fn clock(
    keys: &[Keyframe],
    period: Option<f64>,
    frames_per_s: f64,
    span: &Span,
) -> Result<Vec<(f64, f64)>, TimeError> {
    let named = |scene: SceneTime| {
        span.frames(match scene {
            SceneTime::Frames(t) => Moment::Frames(t),
            SceneTime::Seconds(s) => Moment::Seconds(s),
        })
    };
    let mut clock: Vec<(f64, f64)> = Vec::with_capacity(keys.len() + 1);
    let mut speed = 1.0;
    let end = period.map(|period| (keys[0].time_s + period, &keys[0]));
    for (time_s, key) in keys.iter().map(|key| (key.time_s, key)).chain(end) {
        let t = match (key.scene, clock.last()) {
            (Some(scene), _) => named(scene)?,
            (None, Some((before_s, t))) => t + speed * frames_per_s * (time_s - before_s),
            (None, None) => 0.0,
        };
        clock.push((time_s, t));
        speed = key.speed.unwrap_or(1.0);
    }
    Ok(clock)
}

/// The value at `x` on the straight lines between the points; outside, that of the nearest.
fn straight(points: &[(f64, f64)], x: f64) -> f64 {
    let next = points.partition_point(|p| p.0 <= x);
    match (
        next.checked_sub(1).and_then(|i| points.get(i)),
        points.get(next),
    ) {
        (Some(a), Some(b)) => a.1 + (b.1 - a.1) * (x - a.0) / (b.0 - a.0),
        (Some(only), None) | (None, Some(only)) => only.1,
        (None, None) => 0.0,
    }
}
