//! Measures the motion of dynamic surfaces against true tracks.

use crate::init::{
    InitConfig, InitError,
    assemble::{DynamicPart, dynamic_part},
    cloud::clouds,
    config::stopped,
    lives::{Carrier, LifeInputs, Span},
    motion::UNIT_WIDTH,
};
use m4_core::{Capture, Progress, Tracks, nalgebra::Vector3};
use rayon::prelude::*;
use serde::Serialize;

/// Time over which a point is carried, frames at 24 a second.
const AFTER: [f64; 2] = [5.0, 10.0];
/// A life should end when the error passes this, pixels.
const LARGEST_PX: f32 = 1.5;
/// A life is right within this, frames at 24 a second.
const ON_TIME: f64 = 2.0;
/// A track that is not at the depth of its pixel within this share is not what the frame shows
/// there.
const SAME_DEPTH: f32 = 0.03;

/// Errors of points of dynamic surfaces that nodes carry from a frame to another of the same window
/// that shows them, whether or not a life would last as long.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CarriedErrors {
    /// Time between the two, frames at 24 a second.
    pub after: f64,
    /// Pairs of frames of all tracks.
    pub count: usize,
    /// Half of the errors are below, pixels of an image 480 wide.
    pub median_px: Option<f32>,
    /// Four of five errors are below, pixels of an image 480 wide.
    pub p80_px: Option<f32>,
    /// Share of the errors below the standard deviation that nodes report.
    pub within_sigma: Option<f32>,
}

/// Ends of lives beside the moments when the error passes 1.5 pixels, or the window ends; one for
/// each point, frame and side.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct LifeErrors {
    /// Ends.
    pub count: usize,
    /// Share that ends within two frames at 24 a second of that moment.
    pub on_time: f32,
    /// Share that ends later.
    pub late: f32,
    /// Share that ends earlier.
    pub early: f32,
}

/// How far off the motion of a clip is.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MotionErrors {
    /// Points on dynamic surfaces that frames of windows with nodes show, one per point and frame.
    pub points: usize,
    /// Share of them that no node carries; the figures below leave them out.
    pub without_node: f32,
    /// After 5 and after 10 frames at 24 a second.
    pub carried: Vec<CarriedErrors>,
    /// Ends of lives.
    pub lives: LifeErrors,
}

/// What is known of some points.
#[derive(Default)]
struct Samples {
    points: usize,
    without_node: usize,
    /// Error and standard deviation, pixels, per time of [`AFTER`].
    carried: [Vec<[f32; 2]>; AFTER.len()],
    /// Ends of lives after their moments, frames at 24 a second.
    ends: Vec<f64>,
}

impl Samples {
    fn and(mut self, other: Self) -> Self {
        self.carried
            .iter_mut()
            .zip(other.carried)
            .for_each(|(a, b)| a.extend(b));
        self.ends.extend(other.ends);
        self.points += other.points;
        self.without_node += other.without_node;
        self
    }
}

/// Follows the points of `truth`, world units and frames of `capture`, by the motion that first
/// splats have, and compares (docs/spec/scaffold.md 4). Fails as [`initialise`](super::initialise),
/// and where tracks do not match the frames.
pub fn motion_errors(
    capture: &Capture,
    truth: &Tracks,
    config: &InitConfig,
    progress: &dyn Progress,
) -> Result<MotionErrors, InitError> {
    config.check()?;
    if truth.frames() != capture.frames.len() {
        return Err(InitError::Tracks {
            frames: capture.frames.len(),
            tracks: truth.frames(),
        });
    }
    let clouds = clouds(capture, config, progress)?;
    let DynamicPart {
        frames,
        dynamic,
        fields,
        ..
    } = dynamic_part(capture, config, &clouds, progress)?;
    let clip = LifeInputs {
        capture,
        frames: &frames,
        dynamic: &dynamic,
        fields: &fields,
    };
    let mut all = Samples::default();
    for keys in clip.spans() {
        stopped(progress)?;
        if let Some(samples) = clip.span(keys, |span| window(&clip, span, truth)) {
            all = all.and(samples);
        }
    }
    Ok(summary(all))
}

/// Collects the samples of every point and keyframe of a window.
fn window(clip: &LifeInputs<'_>, span: &Span<'_>, truth: &Tracks) -> Samples {
    let deviations: Vec<Option<Vec<f32>>> = (0..span.times.len())
        .map(|key| {
            let width = span.observed[key].as_ref()?.width() as f32;
            let signs = span.nodes.signs(span.observed, key)?;
            Some(signs.iter().map(|signs| signs.deviation(width)).collect())
        })
        .collect();
    let of = |at: usize| {
        let Some(tree) = span.tree(at) else {
            return Samples::default();
        };
        let frame = clip.frames[span.keys.start + at];
        let points = (0..truth.count())
            .filter_map(|track| Some((track, visible_place(truth, frame, track)?)));
        let samples = points.filter_map(|(track, p)| {
            let rgb = colour(clip, span, at, p)?;
            let Some(carrier) = span.carrier(&tree, at, p) else {
                return Some(Samples {
                    points: 1,
                    without_node: 1,
                    ..Samples::default()
                });
            };
            Some(point(
                clip,
                span,
                &deviations,
                (at, track, rgb),
                &carrier,
                truth,
            ))
        });
        samples.fold(Samples::default(), Samples::and)
    };
    (0..span.times.len())
        .into_par_iter()
        .map(of)
        .reduce(Samples::default, Samples::and)
}

/// Returns where a track is, if the frame shows it.
fn visible_place(truth: &Tracks, frame: usize, track: usize) -> Option<[f32; 3]> {
    truth
        .place(frame, track)
        .filter(|_| truth.visible()[frame * truth.count() + track])
}

/// Returns the colour of a dynamic surface that keyframe `at` shows at a place.
fn colour(clip: &LifeInputs<'_>, span: &Span<'_>, at: usize, p: [f32; 3]) -> Option<[f32; 3]> {
    let observed = span.observed[at].as_ref()?;
    let projected = observed.project(&Vector3::from(p))?;
    let [x, y] = projected.at.map(f32::round);
    let rgb = &clip.capture.frames[clip.frames[span.keys.start + at]].rgb;
    let (width, height) = rgb.size();
    if !(x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32) {
        return None;
    }
    let pixel = (x as usize, y as usize);
    let depth = observed.dynamic_depth(pixel)?;
    let z = projected.point[2];
    ((depth - z).abs() <= SAME_DEPTH * z).then(|| rgb[pixel].map(|c| f32::from(c) / 255.0))
}

/// Collects the samples of one point of keyframe `at`, in colour `rgb`.
fn point(
    clip: &LifeInputs<'_>,
    span: &Span<'_>,
    deviations: &[Option<Vec<f32>>],
    (at, track, rgb): (usize, usize, [f32; 3]),
    carrier: &Carrier,
    truth: &Tracks,
) -> Samples {
    let frame_24 = clip.rate() / 24.0;
    let times = &span.times;
    // where the point is visible
    let error = |key: usize| -> Option<f32> {
        let true_place = visible_place(truth, clip.frames[span.keys.start + key], track)?;
        let observed = span.observed[key].as_ref()?;
        let place = observed
            .project(&carrier.place(&span.nodes.motion[key]))?
            .at;
        let true_place = observed.project(&Vector3::from(true_place))?.at;
        Some(
            (place[0] - true_place[0]).hypot(place[1] - true_place[1]) * UNIT_WIDTH
                / observed.width() as f32,
        )
    };
    let deviation = |key: usize| {
        let Some(all) = &deviations[key] else {
            return 0.0;
        };
        carrier
            .nodes
            .iter()
            .zip(carrier.weights)
            .map(|(&n, w)| w * all[usize::from(n)])
            .sum::<f32>()
    };
    let mut out = Samples {
        points: 1,
        ..Samples::default()
    };
    for (after, pairs) in AFTER.iter().zip(&mut out.carried) {
        for side in [-1.0, 1.0] {
            let wanted = f64::from(times[at]) + side * after * frame_24;
            let near = |key: &usize| (f64::from(times[*key]) - wanted).abs() <= 0.5;
            // a slow clip has no frame at that time but its own
            let Some(key) = (0..times.len()).find(near).filter(|key| *key != at) else {
                continue;
            };
            let Some(error) = error(key) else { continue };
            pairs.push([error, deviation(at).hypot(deviation(key))]);
        }
    }
    let life = span
        .life(at, rgb, carrier)
        .map_or([times[at]; 2], |life| life.life);
    for ahead in [true, false] {
        let keys: Vec<usize> = if ahead {
            (at..times.len()).collect()
        } else {
            (0..=at).rev().collect()
        };
        let wrong = keys
            .iter()
            .position(|&key| error(key).is_some_and(|e| e > LARGEST_PX));
        let last = f64::from(times[*keys.last().unwrap_or(&at)]);
        // the last moment at which the point is where it should be
        let right = wrong.map_or(last, |k| f64::from(times[keys[k.saturating_sub(1)]]));
        let end = f64::from(life[usize::from(ahead)]);
        let end = if ahead { end.min(last) } else { end.max(last) };
        out.ends
            .push(if ahead { end - right } else { right - end } / frame_24);
    }
    out
}

fn summary(samples: Samples) -> MotionErrors {
    let quantile =
        |sorted: &[f32], share: f64| sorted.get((share * sorted.len() as f64) as usize).copied();
    let carried = AFTER.iter().zip(samples.carried).map(|(&after, pairs)| {
        let mut errors: Vec<f32> = pairs.iter().map(|[error, _]| *error).collect();
        errors.sort_by(f32::total_cmp);
        let within = pairs.iter().filter(|[error, sigma]| error <= sigma).count();
        CarriedErrors {
            after,
            count: pairs.len(),
            median_px: quantile(&errors, 0.5),
            p80_px: quantile(&errors, 0.8),
            within_sigma: (!pairs.is_empty()).then(|| within as f32 / pairs.len() as f32),
        }
    });
    let share = |of: &dyn Fn(f64) -> bool| {
        samples.ends.iter().filter(|end| of(**end)).count() as f32
            / samples.ends.len().max(1) as f32
    };
    let lives = LifeErrors {
        count: samples.ends.len(),
        on_time: share(&|end| end.abs() <= ON_TIME),
        late: share(&|end| end > ON_TIME),
        early: share(&|end| end < -ON_TIME),
    };
    let without_node = samples.without_node as f32 / samples.points.max(1) as f32;
    MotionErrors {
        points: samples.points,
        without_node,
        carried: carried.collect(),
        lives,
    }
}
