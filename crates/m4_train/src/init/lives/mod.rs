//! Dynamic splats that live as long as what frames show agrees with their motion (docs/spec/scaffold.md 4).
//!
//! ```text
//! windows of time -> nodes and their motion (motion::WindowMotion)
//! keyframe by keyframe, the middle first: points that no living splat is at (cover)
//!     -> what carries them (carrier) -> how long frames agree (evidence) -> a bound splat, or a free one that lives for a keyframe
//! ```

mod carrier;
mod cover;
mod evidence;

use crate::init::{
    InitError,
    config::stopped,
    motion::{Fields, Observed, Rigid, WindowMotion},
    voxel::Centroids,
};
use carrier::Carrier;
use cover::covered;
use evidence::{Evidence, Shown};
use kiddo::ImmutableKdTree;
use m4_core::{Binding, Capture, Pose, Progress, Window, nalgebra::Vector3};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::ops::Range;

/// Length of a window, seconds: motion is not trusted for longer (measured: docs/decisions/0022).
const WINDOW_S: f64 = 0.7;
/// A window has at least this many keyframes.
const LEAST_KEYS: usize = 5;
/// Frames a second of a clip that does not tell its duration.
const FRAMES_A_SECOND: f64 = 24.0;
/// A change of colour is believed as if the splat had been seen unchanged this long after its birth, seconds.
const UNCHANGED_S: f64 = 1.0 / 12.0;

/// A point of a keyframe that becomes a splat bound to nodes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bound {
    /// Of the keyframe's points.
    pub point: u32,
    pub binding: Binding,
    /// Where it is when nodes have not moved, world units.
    pub mean: [f32; 3],
    /// Its rotation at the keyframe since nodes have not moved, `(w, x, y, z)`.
    pub turn: [f32; 4],
    /// Change of the colour per frame, 0..1.
    pub trend: [f32; 3],
}

/// What the dynamic points of a clip become.
#[derive(Debug, Default)]
pub(crate) struct Lives {
    pub windows: Vec<Window>,
    /// Per keyframe.
    pub bound: Vec<Vec<Bound>>,
    /// Per keyframe, points whose motion is not known.
    pub free: Vec<Vec<u32>>,
}

impl Lives {
    /// No motion is known: every point is free.
    pub fn free(dynamic: &[(f64, Centroids)]) -> Self {
        Self {
            windows: Vec::new(),
            bound: vec![Vec::new(); dynamic.len()],
            free: dynamic.iter().map(|(_, points)| (0..points.xyz.len() as u32).collect()).collect(),
        }
    }
}

/// The dynamic points of a clip, keyframe by keyframe.
#[derive(Clone, Copy)]
pub(crate) struct Clip<'a> {
    pub capture: &'a Capture,
    /// The frame of each keyframe.
    pub frames: &'a [usize],
    /// Time in frames, and points.
    pub dynamic: &'a [(f64, Centroids)],
    /// Motions from each keyframe to the next.
    pub fields: &'a [Fields],
}

/// Windows of a clip, and the lives of its points. Fails with [`InitError::Stopped`].
pub(crate) fn lives(clip: Clip<'_>, progress: &dyn Progress) -> Result<Lives, InitError> {
    let n = clip.dynamic.len();
    let mut out = Lives::free(clip.dynamic);
    let (Some(first), Some(last)) = (clip.dynamic.first(), clip.dynamic.last()) else { return Ok(out) };
    let frames_a_second = match clip.capture.duration_s {
        Some(seconds) if seconds > 0.0 => (clip.capture.time_frames.max(2) - 1) as f64 / seconds,
        _ => FRAMES_A_SECOND,
    };
    let seconds = (last.0 - first.0) / frames_a_second;
    let count = ((seconds / WINDOW_S).round() as usize).clamp(1, (n / LEAST_KEYS).max(1));
    for w in 0..count {
        stopped(progress)?;
        progress.update("lives", w, count, "");
        let unchanged = (UNCHANGED_S * frames_a_second) as f32;
        out.window(clip, w * n / count..(w + 1) * n / count, unchanged);
    }
    progress.update("lives", count, count, "");
    Ok(out)
}

impl Lives {
    /// Binds points of the keyframes `keys` to nodes; `unchanged` in frames.
    fn window(&mut self, clip: Clip<'_>, keys: Range<usize>, unchanged: f32) {
        let dynamic = &clip.dynamic[keys.clone()];
        let frames: Vec<_> = clip.frames[keys.clone()].iter().map(|&frame| &clip.capture.frames[frame]).collect();
        let observed: Vec<Option<Observed>> = frames.par_iter().map(|frame| Observed::new(frame)).collect();
        let times: Vec<f64> = dynamic.iter().map(|(t, _)| *t).collect();
        let fields = &clip.fields[keys.start.min(clip.fields.len())..];
        let Some(nodes) = WindowMotion::new(&observed, &times, reference(dynamic), fields) else { return };
        // keyframes of one instant, from other cameras, have one key
        let instants: Vec<usize> = (0..times.len()).filter(|&k| k == 0 || times[k] > times[k - 1]).collect();
        let pose = |m: &Rigid| {
            let q = m.rotation;
            Pose { rotation: [q.w, q.i, q.j, q.k], position: m.to.into() }
        };
        let poses = instants.iter().flat_map(|&k| nodes.motion[k].iter().map(pose)).collect();
        let at = instants.iter().map(|&k| times[k] as f32).collect();
        let Ok(window) = Window::new(at, nodes.nodes.clone(), poses) else { return };
        let shown = frames.iter().zip(&observed);
        let shown = shown.map(|(frame, o)| o.as_ref().map(|o| Shown::new(o, &frame.rgb, nodes.depth_noise)));
        let edge = |inside: usize, outside: Option<&(f64, Centroids)>, open: f32| match outside {
            Some((t, _)) => (0.5 * (times[inside] + t)) as f32,
            None => open,
        };
        let before = keys.start.checked_sub(1).and_then(|k| clip.dynamic.get(k));
        let ends =
            [edge(0, before, f32::NEG_INFINITY), edge(times.len() - 1, clip.dynamic.get(keys.end), f32::INFINITY)];
        let span = Span {
            index: self.windows.len() as u32,
            times: times.iter().map(|&t| t as f32).collect(),
            shown: shown.collect(),
            nodes: &nodes,
            ends,
            unchanged,
        };
        let mut splats: Vec<(Binding, Vector3<f32>)> = Vec::new();
        for at in bisecting(times.len()) {
            let Some((bound, free)) = span.born(at, &dynamic[at].1, &splats) else { continue };
            splats.extend(bound.iter().map(|b| (b.binding, Vector3::from(b.mean))));
            (self.bound[keys.start + at], self.free[keys.start + at]) = (bound, free);
        }
        self.windows.push(window);
    }
}

/// The keyframe that nodes are on: one in the middle that shows much of the surface.
fn reference(dynamic: &[(f64, Centroids)]) -> usize {
    let n = dynamic.len();
    let worth = |k: usize| {
        let off = (2 * k + 1).abs_diff(n) as f32 / n as f32;
        dynamic[k].1.xyz.len() as f32 * (1.0 - 0.8 * off)
    };
    (0..n).rev().max_by(|&a, &b| worth(a).total_cmp(&worth(b))).unwrap_or(0)
}

/// The middle first, then the ends, then halves of halves.
fn bisecting(n: usize) -> Vec<usize> {
    let mut order = vec![n / 2, 0, n.saturating_sub(1)];
    let mut step = n as f64 / 4.0;
    while step >= 0.5 {
        order.extend((1..).map(|k| (f64::from(k) * step) as usize).take_while(|&k| k < n));
        step /= 2.0;
    }
    order.extend(0..n);
    let mut taken = BTreeSet::new();
    order.retain(|&k| k < n && taken.insert(k));
    order
}

/// A window while its splats are born.
struct Span<'a> {
    /// Of the window.
    index: u32,
    /// Of the keyframes, frames.
    times: Vec<f32>,
    shown: Vec<Option<Shown<'a>>>,
    nodes: &'a WindowMotion,
    /// Where a life ends that reaches the first or the last keyframe, frames.
    ends: [f32; 2],
    /// Frames.
    unchanged: f32,
}

impl Span<'_> {
    /// Bound and free points of keyframe `at` where no splat of `splats` lives; `None` if nothing is known of the keyframe.
    fn born(
        &self,
        at: usize,
        points: &Centroids,
        splats: &[(Binding, Vector3<f32>)],
    ) -> Option<(Vec<Bound>, Vec<u32>)> {
        let (here, motions) = (self.shown[at].as_ref()?, &self.nodes.motion[at]);
        let places: Vec<[f32; 3]> = motions.iter().map(|m| m.to.into()).collect();
        let tree = ImmutableKdTree::<f32, 3>::new_from_slice(&places).ok()?;
        let covered = covered(here, splats, motions, self.times[at], points);
        let born = (0..points.xyz.len() as u32).into_par_iter().filter(|&i| !covered[i as usize]);
        let born: Vec<(u32, Option<Bound>)> = born
            .map(|i| {
                let carrier = Carrier::new(&tree, &self.nodes.motion, at, points.xyz[i as usize], self.nodes.spacing);
                (i, carrier.and_then(|carrier| self.life(at, i, points.rgb[i as usize], &carrier)))
            })
            .collect();
        let free = born.iter().filter(|(_, bound)| bound.is_none()).map(|(i, _)| *i).collect();
        Some((born.iter().filter_map(|(_, bound)| *bound).collect(), free))
    }

    /// Follows a point of keyframe `at` both ways until a frame contradicts it. `None` where the next frames on both sides do.
    fn life(&self, at: usize, point: u32, rgb: [f32; 3], carrier: &Carrier) -> Option<Bound> {
        let (mut life, mut carried) = (self.ends, false);
        let (mut slope, mut squares) = ([0.0f32; 3], self.unchanged * self.unchanged);
        for ahead in [true, false] {
            let mut last = at;
            loop {
                let next = if ahead { last + 1 } else { last.wrapping_sub(1) };
                let Some(shown) = self.shown.get(next) else { break };
                let place = carrier.place(&self.nodes.motion[next]);
                match shown.as_ref().map_or(Evidence::Hidden, |shown| shown.evidence(&place, rgb)) {
                    Evidence::Contradicted => {
                        life[usize::from(ahead)] = 0.5 * (self.times[last] + self.times[next]);
                        break;
                    }
                    Evidence::Shown(colour) => {
                        let dt = self.times[next] - self.times[at];
                        (0..3).for_each(|c| slope[c] += dt * (colour[c] - rgb[c]));
                        squares += dt * dt;
                    }
                    Evidence::Hidden => {}
                }
                carried = true;
                last = next;
            }
        }
        carried.then(|| Bound {
            point,
            binding: Binding { window: self.index, nodes: carrier.nodes, weights: carrier.weights, life },
            mean: carrier.mean.into(),
            turn: carrier.turn,
            trend: slope.map(|s| s / squares.max(f32::MIN_POSITIVE)),
        })
    }
}
