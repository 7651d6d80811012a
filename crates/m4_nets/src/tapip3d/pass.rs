//! One pass over a clip, forward or backward.

use super::frame::{Frame, Sides};
use super::source::{Loaded, Source, grid, no_depth, sides};
use super::track::{Batch, Group, TrackState};
use super::window::{State, Window};
use crate::NetError;
use m4_core::Progress;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The order in which frames are gone through: times count from 0 in that order, and beyond its end
/// it is static.
#[derive(Debug, Clone, Copy)]
pub struct FrameOrder {
    pub frames: usize,
    pub backward: bool,
    pub window: usize,
}

impl FrameOrder {
    pub fn frame(self, time: usize) -> usize {
        let time = time.min(self.frames - 1);
        if self.backward {
            self.frames - 1 - time
        } else {
            time
        }
    }

    pub fn time(self, frame: usize) -> usize {
        if self.backward {
            self.frames - 1 - frame
        } else {
            frame
        }
    }

    /// Times with what is repeated at the end: whole halves of windows, and one window at least.
    pub fn times(self) -> usize {
        self.frames
            .next_multiple_of(self.window / 2)
            .max(self.window)
    }

    /// Where windows begin.
    pub fn starts(self) -> impl Iterator<Item = usize> {
        (0..=self.times() - self.window).step_by(self.window / 2)
    }
}

/// A point and its track so far.
#[derive(Debug, Clone)]
pub struct TrackedPoint {
    /// The query that it is of; none for those of the grid.
    pub query: Option<usize>,
    time: usize,
    start: [f32; 3],
    /// `[time]`.
    pub at: Vec<[f32; 3]>,
    /// `[time]`.
    pub logits: Vec<f32>,
}

impl TrackedPoint {
    fn new(query: Option<usize>, time: usize, start: [f32; 3], times: usize) -> Self {
        Self {
            query,
            time,
            start,
            at: vec![start; times],
            logits: vec![0.0; times],
        }
    }

    /// Where it is taken to be at step `j` of the window that begins at `first`, before that is
    /// worked with.
    fn before(&self, first: usize, j: usize, window: usize) -> ([f32; 3], f32) {
        let half = window / 2;
        if self.time < first + half {
            let time = first + j.min(half - 1);
            (self.at[time], self.logits[time])
        } else {
            (self.start, 0.0)
        }
    }
}

/// Frames that were loaded, as many as memory may hold.
#[derive(Debug)]
pub struct Frames {
    held: BTreeMap<usize, Arc<Frame>>,
    most: usize,
}

impl Frames {
    /// None yet, and at most `most` later.
    pub fn new(most: usize) -> Self {
        let held = BTreeMap::new();
        Self { held, most }
    }

    /// Lets go of frames that are not in `needed`, those first that the backward pass needs last.
    fn shrink(&mut self, needed: &[usize], order: FrameOrder) {
        while self.held.len() >= self.most {
            let mut free = self
                .held
                .keys()
                .copied()
                .filter(|frame| !needed.contains(frame));
            let Some(frame) = (if order.backward {
                free.next_back()
            } else {
                free.next()
            }) else {
                return;
            };
            self.held.remove(&frame);
        }
    }
}

/// Takes all `groups` in `order`. The forward pass comes first and adds queries to `track_state`.
pub fn walk(
    source: &Source<'_>,
    order: FrameOrder,
    range: [f32; 2],
    track_state: &mut TrackState,
    groups: &[Group],
    frames: &mut Frames,
    mut report: impl FnMut(),
    progress: &dyn Progress,
) -> Result<Vec<Vec<TrackedPoint>>, NetError> {
    let (net, config) = (&source.net.net, &source.net.config);
    let mut walkers: Vec<Vec<TrackedPoint>> = vec![Vec::new(); groups.len()];
    let mut entered = 0;
    for first in order.starts() {
        let needed: Vec<usize> = (first..first + order.window)
            .map(|time| order.frame(time))
            .collect();
        let mut window = Vec::with_capacity(order.window);
        for &frame in &needed {
            if progress.cancelled() {
                return Err(NetError::Cancelled);
            }
            if !frames.held.contains_key(&frame) {
                frames.shrink(&needed, order);
                let loaded = source.load(frame, range)?;
                if !order.backward {
                    track_state.learn(source, frame, &loaded, groups);
                }
                frames
                    .held
                    .insert(frame, Arc::new(loaded.frame(source.net)));
            }
            window.extend(frames.held.get(&frame).cloned());
        }
        let end = (first + order.window).min(order.frames);
        for time in entered..end {
            for (group, walkers) in track_state.groups.iter().zip(&mut walkers) {
                for batch in track_state.batches_at(group, order, time) {
                    let some = batch.points.iter().enumerate();
                    let some = some.map(|(i, &p)| {
                        TrackedPoint::new(batch.queries.get(i).copied(), time, p, order.times())
                    });
                    walkers.extend(some);
                }
            }
        }
        entered = entered.max(end);
        let (lowest, highest) = (needed.iter().min(), needed.iter().max());
        let (lowest, highest) = (lowest.copied().unwrap_or(0), highest.copied().unwrap_or(0));
        let window = Window::new(window, config).ok_or_else(|| no_depth(lowest, highest))?;
        for (group, walkers) in track_state.groups.iter().zip(&mut walkers) {
            if walkers.is_empty() {
                report();
                continue;
            }
            let batches = (0..end).flat_map(|time| track_state.batches_at(group, order, time));
            let batches: Vec<&Sides> = batches.map(|batch| &batch.sides).collect();
            let sides = window.query_sides(net, &Sides::together(&batches)?);
            let mut state = State::before(walkers, first, order.window, &window);
            for _ in 0..source.options.iterations {
                if progress.cancelled() {
                    return Err(NetError::Cancelled);
                }
                state = window.moved(net, &sides, state, config.neighbours)?;
                if !state.is_finite() {
                    return Err(NetError::Device(format!(
                        "the network lost its points in frames {lowest} to {highest}: its output is NaN or infinite; 32-bit \
                         precision may help"
                    )));
                }
            }
            state.enter(walkers, first, &window);
            report();
        }
    }
    Ok(walkers)
}

impl State {
    /// Where `walkers` are taken to be in the window that begins at time `first`.
    fn before(walkers: &[TrackedPoint], first: usize, frames: usize, window: &Window) -> Self {
        let all = (0..frames).flat_map(|j| {
            walkers
                .iter()
                .map(move |walker| walker.before(first, j, frames))
        });
        let (at, logits) = all
            .map(|(at, logit)| (window.space.enter(at), logit))
            .unzip();
        Self { at, logits }
    }

    fn is_finite(&self) -> bool {
        self.at
            .as_flattened()
            .iter()
            .chain(&self.logits)
            .all(|x| x.is_finite())
    }

    /// Gives `walkers` what was found.
    fn enter(&self, walkers: &mut [TrackedPoint], first: usize, window: &Window) {
        let n = walkers.len();
        for (k, (&at, &logit)) in self.at.iter().zip(&self.logits).enumerate() {
            let (time, walker) = (first + k / n, &mut walkers[k % n]);
            walker.at[time] = window.space.leave(at);
            walker.logits[time] = logit;
        }
    }
}

impl TrackState {
    /// Takes in what `loaded`, which is `frame`, shows of the queries in it, and the grid of points
    /// if it is an end of the clip.
    fn learn(&mut self, source: &Source<'_>, frame: usize, loaded: &Loaded, groups: &[Group]) {
        let side = |points: &[[f32; 3]]| {
            sides(
                &source.net.net,
                &loaded.maps,
                &loaded.geometry.points,
                &loaded.geometry.lens,
                source.options.size,
                points,
                source.net.config.neighbours,
            )
        };
        for (batches, group) in self.groups.iter_mut().zip(groups) {
            if let Some((queries, points)) = group.get(&frame) {
                batches.insert(
                    frame,
                    Batch {
                        queries: queries.clone(),
                        sides: side(points),
                        points: points.clone(),
                    },
                );
            }
        }
        let ends = [frame == 0, frame + 1 == self.frames];
        if ends.contains(&true) && source.options.support_grid > 0 {
            let points = grid(
                source.options.support_grid,
                &loaded.z,
                source.options.size,
                &loaded.geometry.lens,
            );
            if !points.is_empty() {
                let batch = Batch {
                    queries: Vec::new(),
                    sides: side(&points),
                    points,
                };
                for (end, here) in self.grids.iter_mut().zip(ends) {
                    if here {
                        *end = Some(batch.clone());
                    }
                }
            }
        }
    }
}
