//! Motion of the nodes of a window: each is aligned to every frame of it from the frame in the
//! middle, so that errors do not add up, and smoothed over time.

use crate::init::motion::{
    Field, Fields,
    align::{Extent, NARROW, Node, Pieces, Prior, WIDE, align},
    deviation::{Signs, UNIT_WIDTH, signs},
    observed::Observed,
    pieces::{depth_noise, pieces},
    rigid::Rigid,
    smooth::{Estimate, Expected, smooth, usual_snap},
};
use rayon::prelude::*;

/// Nodes of a window if its surface faced the camera; surfaces that do not have up to two or three
/// times as many (measured: docs/decisions/0022).
const NODES: f32 = 200.0;
/// Rounds of a frame.
const ROUNDS: [Extent; 8] = [WIDE, WIDE, WIDE, WIDE, NARROW, NARROW, NARROW, NARROW];
/// How often a window is aligned again from smoothed motion (measured, as the next:
/// docs/decisions/0022).
const AGAIN: usize = 2;
/// Fourth differences of paths may be this many times as large as they usually are in the window
/// (measured: docs/decisions/0022).
const SLACK: f64 = 3.0;
/// Deviations of the place on the reference, and where no frame tells it, pixels of [`UNIT_WIDTH`].
const EXACT_PX: f32 = 0.02;
const UNKNOWN_PX: f32 = 50.0;
/// Noise of the depth of a piece, in units of that of a pixel.
const DEPTH_OF_PIECE: f32 = 0.3;
/// How far a step of an alignment leads, widths of the image.
const STEP_WIDTHS: f32 = 1.0 / 160.0;
/// How far neighbouring nodes move apart, widths of the image.
const APART_WIDTHS: f32 = 1.0 / 320.0;
/// A guess that is not the node's own continued motion must explain this much more: the motion of
/// the field, that of a neighbour.
const OTHER: [f32; 2] = [0.02, 0.05];
/// Points that a guess is judged by: every third of a node.
const JUDGES: usize = 3;
/// Noise of depth where no keyframe tells it, share.
const DEPTH: f32 = 0.01;
/// What a point that no frame can judge costs, where 0 is agreement and 1 is contradiction.
const UNKNOWN: f32 = 0.7;

/// Nodes on the surface of one keyframe and their motions to the others of a window.
#[derive(Debug)]
pub(crate) struct WindowMotion {
    /// World units.
    pub nodes: Vec<[f32; 3]>,
    /// `[keyframes][nodes]`.
    pub motion: Vec<Vec<Rigid>>,
    pieces: Pieces,
    prior: Prior,
    reference: usize,
}

impl WindowMotion {
    /// Of nodes on what keyframe `reference` of a window shows. `observed` and `times` (frames) are
    /// those of its keyframes; `fields` lead from each of them to the next; `rate` is that of
    /// frames a second. `None` where the reference shows nothing dynamic, or depth so torn that
    /// there are more nodes than a binding can name.
    ///
    /// Keyframes of one instant, from other cameras, share their motion.
    pub fn new(
        observed: &[Option<Observed>],
        times: &[f64],
        reference: usize,
        fields: &[Fields],
        rate: f64,
    ) -> Option<Self> {
        let from = observed.get(reference)?.as_ref()?;
        let places: Vec<[f32; 3]> = from.points(1).iter().map(|p| p.place.into()).collect();
        let px = (places.len() as f32 / NODES).sqrt().max(3.0);
        let (pieces, chosen) = pieces(from, &places, px)?;
        if chosen.len() > usize::from(u16::MAX) {
            return None;
        }
        let nodes: Vec<[f32; 3]> = chosen.iter().map(|&k| places[k as usize]).collect();
        let still: Vec<Rigid> = nodes.iter().map(|p| Rigid::shift(*p, *p)).collect();
        // the field that leads from a keyframe to the next one on that side
        let step = |key: usize, forward: bool| match forward {
            true => Some((key + 1, &fields.get(key)?.forward)),
            false => key
                .checked_sub(1)
                .and_then(|next| Some((next, &fields.get(next)?.backward))),
        };
        let noises = [true, false].iter().filter_map(|&forward| {
            let (key, field) = step(reference, forward)?;
            Some(depth_noise(
                observed.get(key)?.as_ref()?,
                &nodes,
                &field.motions(&nodes),
            ))
        });
        let depth = m4_core::median(&mut noises.collect::<Vec<f32>>()).unwrap_or(DEPTH);
        let seconds: Vec<f64> = times.iter().map(|t| t / rate).collect();
        let width = from.width() as f32;
        let prior = Prior {
            depth,
            apart_px: APART_WIDTHS * width,
            step_px: STEP_WIDTHS * width,
        };
        let along = |forward: bool| {
            let mut out = Vec::new();
            let (mut key, mut before, mut motion) = (reference, None, still.clone());
            while let Some((next, field)) =
                step(key, forward).filter(|(next, _)| *next < observed.len())
            {
                if times[next] != times[key] {
                    let frame = observed[next].as_ref();
                    let guess = guess(&pieces, &motion, before.as_deref(), field, frame, prior);
                    let now = match frame {
                        Some(frame) => align(&pieces, frame, &guess, prior, &ROUNDS),
                        None => guess,
                    };
                    before = Some(std::mem::replace(&mut motion, now));
                }
                out.push(motion.clone());
                key = next;
            }
            out
        };
        let (ahead, mut motions) = rayon::join(|| along(true), || along(false));
        motions.reverse();
        motions.push(still);
        motions.extend(ahead);
        let mut out = Self {
            nodes,
            motion: motions,
            pieces,
            prior,
            reference,
        };
        let instants = instants(&seconds);
        let times: Vec<f64> = instants.iter().map(|&k| seconds[k]).collect();
        let path = |i: usize| instants.iter().map(|&k| out.motion[k][i].to).collect();
        if let Some(usual) = usual_snap(&times, (0..out.nodes.len()).map(path), &from.axes()) {
            for _ in 0..AGAIN {
                out.smooth(observed, &seconds, SLACK * usual);
                out.align_again(observed, &seconds);
            }
            out.smooth(observed, &seconds, SLACK * usual);
        }
        Some(out)
    }

    /// Brings the motion of each node to that which is most likely over time, for fourth
    /// differences as large as `snap` (docs/spec/scaffold.md 4).
    fn smooth(&mut self, observed: &[Option<Observed>], seconds: &[f64], snap: f64) {
        let Some(from) = observed[self.reference].as_ref() else {
            return;
        };
        let keys = 0..observed.len();
        let signs: Vec<Option<Vec<Signs>>> =
            keys.clone().map(|key| self.signs(observed, key)).collect();
        let instants = instants(seconds);
        let of = |i: usize| {
            let z = from
                .project(&self.pieces.nodes[i].place)
                .map_or(1.0, |p| p.point[2]);
            let unit = from.pixel(z) * from.width() as f32 / UNIT_WIDTH;
            let depth = self.prior.depth * z;
            let estimate = |&key: &usize| {
                let across_px = match &signs[key] {
                    _ if seconds[key] == seconds[self.reference] => EXACT_PX,
                    Some(signs) => signs[i].deviation(from.width() as f32),
                    None => UNKNOWN_PX,
                };
                let across = across_px * unit;
                Estimate {
                    time: seconds[key],
                    motion: self.motion[key][i],
                    across,
                    along: across.max(DEPTH_OF_PIECE * depth),
                }
            };
            instants.iter().map(estimate).collect()
        };
        let paths: Vec<Vec<Estimate>> = (0..self.pieces.nodes.len())
            .into_par_iter()
            .map(of)
            .collect();
        let expected = Expected {
            axes: from.axes(),
            snap,
            radius: 2.0 * self.pieces.spacing,
        };
        let paths: Vec<Vec<Rigid>> = paths
            .par_iter()
            .map(|path| smooth(path, expected))
            .collect();
        let mut instant = 0;
        for key in keys {
            instant += usize::from(instants.get(instant + 1) == Some(&key));
            if seconds[key] != seconds[self.reference] {
                self.motion[key] = paths.iter().map(|path| path[instant]).collect();
            }
        }
    }

    /// Aligns the nodes to every frame from where they are.
    fn align_again(&mut self, observed: &[Option<Observed>], seconds: &[f64]) {
        for key in 0..observed.len() {
            if seconds[key] == seconds[self.reference] {
                continue;
            }
            if let Some(frame) = &observed[key] {
                self.motion[key] = align(
                    &self.pieces,
                    frame,
                    &self.motion[key],
                    self.prior,
                    &[NARROW; 2],
                );
            }
        }
    }

    /// Distance between nodes, world units.
    pub fn spacing(&self) -> f32 {
        self.pieces.spacing
    }

    /// Noise of depth, share.
    pub fn depth_noise(&self) -> f32 {
        self.prior.depth
    }

    /// Returns the signs of the error of each node at keyframe `key` of the `observed` ones that
    /// this was made of; `None` on the reference, where nodes are exact, and where nothing was
    /// observed.
    pub fn signs(&self, observed: &[Option<Observed>], key: usize) -> Option<Vec<Signs>> {
        let frame = observed
            .get(key)?
            .as_ref()
            .filter(|_| key != self.reference)?;
        Some(signs(&self.pieces, frame, &self.motion[key], self.prior))
    }
}

/// The first keyframe of each instant: those of other cameras share its motion.
fn instants(seconds: &[f64]) -> Vec<usize> {
    (0..seconds.len())
        .filter(|&k| k == 0 || seconds[k] > seconds[k - 1])
        .collect()
}

/// The motion `b` after `a` once more.
fn again(a: &Rigid, b: &Rigid) -> Rigid {
    let turn = b.rotation * a.rotation.inverse();
    Rigid {
        rotation: turn * b.rotation,
        from: b.from,
        to: b.to + (b.to - a.to),
    }
}

/// What comes next: the motion once more, by the field, or as a neighbour, whichever explains the
/// frame best.
fn guess(
    pieces: &Pieces,
    motion: &[Rigid],
    before: Option<&[Rigid]>,
    field: &Field,
    frame: Option<&Observed>,
    prior: Prior,
) -> Vec<Rigid> {
    let at: Vec<[f32; 3]> = motion.iter().map(|m| m.to.into()).collect();
    let by = field.motions(&at);
    let by: Vec<Rigid> = motion
        .iter()
        .zip(&by)
        .map(|(m, f)| Rigid {
            rotation: f.rotation * m.rotation,
            from: m.from,
            to: f.moved(&m.to),
        })
        .collect();
    let (Some(before), Some(frame)) = (before, frame) else {
        return by;
    };
    let onward = |i: usize| again(&before[i], &motion[i]);
    (0..motion.len())
        .into_par_iter()
        .map(|i| {
            let node = &pieces.nodes[i];
            let cost = |m: &Rigid| cost(node, pieces, frame, m, prior.depth);
            let first = onward(i);
            let mut best = (cost(&first), first);
            let mut compare = |m: Rigid, more: f32| {
                let c = cost(&m) + more;
                if c < best.0 {
                    best = (c, m);
                }
            };
            compare(by[i], OTHER[0]);
            for &j in &node.near {
                let place = node.place.into();
                compare(by[j as usize].about(place), OTHER[1]);
                compare(onward(j as usize).about(place), OTHER[1]);
            }
            best.1
        })
        .collect()
}

/// How badly a motion of a node explains a frame: 0 where all of its points agree, to 1.
fn cost(node: &Node, pieces: &Pieces, frame: &Observed, m: &Rigid, depth: f32) -> f32 {
    let (mut sum, mut total) = (0.0f32, 0.0f32);
    for &(k, d) in node.points.iter().step_by(JUDGES) {
        let w = (-d).exp();
        if w < 0.05 {
            break;
        }
        let point = &pieces.points[k as usize];
        total += w;
        let projected = frame.project(&m.moved(&point.place));
        let (Some(projected), Some(z)) = (projected, projected.and_then(|p| frame.depth(p.at)))
        else {
            sum += UNKNOWN * w;
            continue;
        };
        let expected = projected.point[2];
        if z > 0.0 && z < expected * (1.0 - 6.0 * depth) {
            sum += UNKNOWN * w;
            continue;
        }
        let Some(sample) = frame.sample(projected.at) else {
            sum += w;
            continue;
        };
        let off = (0..3)
            .map(|c| ((sample.measures[c] - point.measures[c]) / 0.03).powi(2) / 3.0)
            .sum::<f32>();
        let far = match sample.depth > 0.0 {
            true => ((sample.depth - expected) / (2.0 * depth * expected)).powi(2),
            false => 1.0,
        };
        let square = off + far;
        sum += w * square / (square + 4.0);
    }
    if total > 0.0 { sum / total } else { 1.0 }
}
