//! Dynamic splats that live as long as what frames show agrees with their motion
//! (docs/spec/scaffold.md 4).
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
pub(crate) use carrier::Carrier;
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
/// A change of colour is believed as if the splat had been seen unchanged this long after its
/// birth, seconds.
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
            free: dynamic
                .iter()
                .map(|(_, points)| (0..points.xyz.len() as u32).collect())
                .collect(),
        }
    }
}

/// The dynamic points of a clip, keyframe by keyframe.
#[derive(Clone, Copy)]
pub(crate) struct LifeInputs<'a> {
    pub capture: &'a Capture,
    /// The frame of each keyframe.
    pub frames: &'a [usize],
    /// Time in frames, and points.
    pub dynamic: &'a [(f64, Centroids)],
    /// Motions from each keyframe to the next.
    pub fields: &'a [Fields],
}

/// Windows of a clip, and the lives of its points. Fails with [`InitError::Stopped`].
pub(crate) fn lives(clip: LifeInputs<'_>, progress: &dyn Progress) -> Result<Lives, InitError> {
    let mut out = Lives::free(clip.dynamic);
    let spans = clip.spans();
    for (w, keys) in spans.iter().enumerate() {
        stopped(progress)?;
        progress.update("lives", w, spans.len(), "");
        clip.span(keys.clone(), |span| out.window(span, clip.dynamic));
    }
    progress.update("lives", spans.len(), spans.len(), "");
    Ok(out)
}

impl LifeInputs<'_> {
    /// Frames a second.
    pub fn rate(&self) -> f64 {
        match self.capture.duration_s {
            Some(seconds) if seconds > 0.0 => {
                (self.capture.time_frames.max(2) - 1) as f64 / seconds
            }
            _ => FRAMES_A_SECOND,
        }
    }

    /// The keyframes of each window.
    pub fn spans(&self) -> Vec<Range<usize>> {
        let n = self.dynamic.len();
        let (Some(first), Some(last)) = (self.dynamic.first(), self.dynamic.last()) else {
            return Vec::new();
        };
        let seconds = (last.0 - first.0) / self.rate();
        let count = ((seconds / WINDOW_S).round() as usize).clamp(1, (n / LEAST_KEYS).max(1));
        (0..count)
            .map(|w| w * n / count..(w + 1) * n / count)
            .collect()
    }

    /// What `of` makes of the motion of nodes in the keyframes `keys`; `None` where nothing is
    /// known of it.
    pub fn span<R>(&self, keys: Range<usize>, of: impl FnOnce(&Span<'_>) -> R) -> Option<R> {
        let dynamic = &self.dynamic[keys.clone()];
        let frames: Vec<_> = self.frames[keys.clone()]
            .iter()
            .map(|&frame| &self.capture.frames[frame])
            .collect();
        let observed: Vec<Option<Observed>> = frames
            .par_iter()
            .map(|frame| Observed::new(frame))
            .collect();
        let times: Vec<f64> = dynamic.iter().map(|(t, _)| *t).collect();
        let fields = &self.fields[keys.start.min(self.fields.len())..];
        let nodes = WindowMotion::new(&observed, &times, reference(dynamic), fields, self.rate())?;
        let shown = frames.iter().zip(&observed);
        let shown = shown.map(|(frame, o)| {
            o.as_ref()
                .map(|o| Shown::new(o, &frame.rgb, nodes.depth_noise()))
        });
        let edge = |inside: usize, outside: Option<&(f64, Centroids)>, open: f32| match outside {
            Some((t, _)) => (0.5 * (times[inside] + t)) as f32,
            None => open,
        };
        let before = keys.start.checked_sub(1).and_then(|k| self.dynamic.get(k));
        let ends = [
            edge(0, before, f32::NEG_INFINITY),
            edge(times.len() - 1, self.dynamic.get(keys.end), f32::INFINITY),
        ];
        Some(of(&Span {
            keys: keys.clone(),
            times: times.iter().map(|&t| t as f32).collect(),
            shown: shown.collect(),
            observed: &observed,
            nodes: &nodes,
            ends,
            unchanged: (UNCHANGED_S * self.rate()) as f32,
        }))
    }
}

impl Lives {
    /// Binds points of the keyframes of `span` to its nodes.
    fn window(&mut self, span: &Span<'_>, dynamic: &[(f64, Centroids)]) {
        // keyframes of one instant, from other cameras, have one key
        let times = &span.times;
        let instants: Vec<usize> = (0..times.len())
            .filter(|&k| k == 0 || times[k] > times[k - 1])
            .collect();
        let pose = |m: &Rigid| {
            let q = m.rotation;
            Pose {
                rotation: [q.w, q.i, q.j, q.k],
                position: m.to.into(),
            }
        };
        let poses = instants
            .iter()
            .flat_map(|&k| span.nodes.motion[k].iter().map(pose))
            .collect();
        let at = instants.iter().map(|&k| times[k]).collect();
        let Ok(window) = Window::new(at, span.nodes.nodes.clone(), poses) else {
            return;
        };
        let index = self.windows.len() as u32;
        let mut splats: Vec<(Binding, Vector3<f32>)> = Vec::new();
        for at in bisecting(times.len()) {
            let key = span.keys.start + at;
            let Some((bound, free)) = span.born(index, at, &dynamic[key].1, &splats) else {
                continue;
            };
            splats.extend(bound.iter().map(|b| (b.binding, Vector3::from(b.mean))));
            (self.bound[key], self.free[key]) = (bound, free);
        }
        self.windows.push(window);
    }
}

/// How long a point is carried.
pub(crate) struct Life {
    /// Begin and end, frames.
    pub life: [f32; 2],
    /// Change of the colour per frame, 0..1.
    trend: [f32; 3],
}

/// The keyframe that nodes are on: one in the middle that shows much of the surface.
fn reference(dynamic: &[(f64, Centroids)]) -> usize {
    let n = dynamic.len();
    let worth = |k: usize| {
        let off = (2 * k + 1).abs_diff(n) as f32 / n as f32;
        dynamic[k].1.xyz.len() as f32 * (1.0 - 0.8 * off)
    };
    (0..n)
        .rev()
        .max_by(|&a, &b| worth(a).total_cmp(&worth(b)))
        .unwrap_or(0)
}

/// The middle first, then the ends, then halves of halves.
fn bisecting(n: usize) -> Vec<usize> {
    let mut order = vec![n / 2, 0, n.saturating_sub(1)];
    let mut step = n as f64 / 4.0;
    while step >= 0.5 {
        order.extend(
            (1..)
                .map(|k| (f64::from(k) * step) as usize)
                .take_while(|&k| k < n),
        );
        step /= 2.0;
    }
    order.extend(0..n);
    let mut indices = BTreeSet::new();
    order.retain(|&k| k < n && indices.insert(k));
    order
}

/// The keyframes of a window, and the motion of its nodes.
pub(crate) struct Span<'a> {
    /// Of the clip.
    pub keys: Range<usize>,
    /// Of the keyframes, frames.
    pub times: Vec<f32>,
    shown: Vec<Option<Shown<'a>>>,
    pub observed: &'a [Option<Observed>],
    pub nodes: &'a WindowMotion,
    /// Where a life ends that reaches the first or the last keyframe, frames.
    ends: [f32; 2],
    /// Frames.
    unchanged: f32,
}

impl Span<'_> {
    /// Bound and free points of keyframe `at` where no splat of `splats` lives; `None` if nothing
    /// is known of the keyframe.
    fn born(
        &self,
        window: u32,
        at: usize,
        points: &Centroids,
        splats: &[(Binding, Vector3<f32>)],
    ) -> Option<(Vec<Bound>, Vec<u32>)> {
        let (here, motions) = (self.shown[at].as_ref()?, &self.nodes.motion[at]);
        let tree = self.tree(at)?;
        let covered = covered(here, splats, motions, self.times[at], points);
        let born = (0..points.xyz.len() as u32)
            .into_par_iter()
            .filter(|&i| !covered[i as usize]);
        let born: Vec<(u32, Option<Bound>)> = born
            .map(|i| {
                let bound = self
                    .carrier(&tree, at, points.xyz[i as usize])
                    .and_then(|carrier| {
                        let Life { life, trend } =
                            self.life(at, points.rgb[i as usize], &carrier)?;
                        let binding = Binding {
                            window,
                            nodes: carrier.nodes,
                            weights: carrier.weights,
                            life,
                        };
                        Some(Bound {
                            point: i,
                            binding,
                            mean: carrier.mean.into(),
                            turn: carrier.turn,
                            trend,
                        })
                    });
                (i, bound)
            })
            .collect();
        let free = born
            .iter()
            .filter(|(_, bound)| bound.is_none())
            .map(|(i, _)| *i)
            .collect();
        Some((born.iter().filter_map(|(_, bound)| *bound).collect(), free))
    }

    /// Finds nodes by their places at keyframe `at`.
    pub fn tree(&self, at: usize) -> Option<ImmutableKdTree<f32, 3>> {
        let places: Vec<[f32; 3]> = self.nodes.motion[at].iter().map(|m| m.to.into()).collect();
        ImmutableKdTree::<f32, 3>::new_from_slice(&places).ok()
    }

    /// What carries a place of keyframe `at`, whose nodes `tree` finds.
    pub fn carrier(
        &self,
        tree: &ImmutableKdTree<f32, 3>,
        at: usize,
        p: [f32; 3],
    ) -> Option<Carrier> {
        Carrier::new(tree, &self.nodes.motion, at, p, self.nodes.spacing())
    }

    /// Follows a point of keyframe `at` both ways until a frame contradicts it. `None` where the
    /// next frames on both sides do.
    pub fn life(&self, at: usize, rgb: [f32; 3], carrier: &Carrier) -> Option<Life> {
        let (mut life, mut carried) = (self.ends, false);
        let (mut slope, mut squares) = ([0.0f32; 3], self.unchanged * self.unchanged);
        for ahead in [true, false] {
            let mut last = at;
            loop {
                let next = if ahead {
                    last + 1
                } else {
                    last.wrapping_sub(1)
                };
                let Some(shown) = self.shown.get(next) else {
                    break;
                };
                let place = carrier.place(&self.nodes.motion[next]);
                match shown
                    .as_ref()
                    .map_or(Evidence::Hidden, |shown| shown.evidence(&place, rgb))
                {
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
        carried.then(|| Life {
            life,
            trend: slope.map(|s| s / squares.max(f32::MIN_POSITIVE)),
        })
    }
}
