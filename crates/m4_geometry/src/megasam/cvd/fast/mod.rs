//! The fast path: the loss, its gradients and Adam in f32, fused, in vectors and threads.
//!
//! ```text
//! step:  rounds of sources: pair (all pairs of a source)   -> gradients of the source, scattered gradients of targets
//!        all frames:        frame (shape terms, sum, Adam) -> disparity and u, moved
//! ```
//!
//! Sources of a round share no target, rounds follow one another, a frame is one task, and sums are
//! added in order: the bits do not depend on the number of threads. Beside the flow, memory is 16
//! planes of f32 per frame; nothing grows with the number of pairs.

mod edges;
mod frame;
mod pair;
mod shape;
mod surface;

use super::pairs::{CompactFlow, FramePair, PairStore};
use super::{PairError, Weights};
use crate::dba::Pinhole;
pub(super) use frame::Moves;
use frame::{Frame, Rate, Scratch, Step};
use m4_core::{Se3, SimdLevel, dispatch};
use pair::{PairBuffers, Rows, Source, Sums};
use rayon::prelude::*;
use shape::{Motion, Shape};
use std::collections::HashSet;
use std::sync::{Mutex, PoisonError};

/// The state of a descent.
pub(super) struct Descent<'a> {
    level: SimdLevel,
    shape: Shape,
    scratch: Pool,
    pairs: &'a PairStore,
    motions: Vec<Motion>,
    rounds: Vec<Vec<Task>>,
    frames: Vec<Frame>,
}

/// What threads work in, made once: fresh memory costs more than the work in it.
struct Pool {
    shape: Shape,
    normal_lens: Pinhole<f64>,
    free: Mutex<Vec<Scratch>>,
}

impl Pool {
    fn lend<T>(&self, work: impl FnOnce(&mut Scratch) -> T) -> T {
        let free = || self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let spare = free().pop();
        let mut scratch = spare.unwrap_or_else(|| Scratch::new(self.shape, &self.normal_lens));
        let out = work(&mut scratch);
        free().push(scratch);
        out
    }
}

/// What a frame starts from, planes of `[height][width]`.
pub(super) struct Start<'a> {
    pub disparity: &'a [f32],
    pub uncertainty: &'a [f32],
}

/// Loss before a step and the number of pixels of pairs that counted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Report {
    pub loss: f64,
    pub count: f64,
}

impl<'a> Descent<'a> {
    /// `lenses` project points and give the rays of normals. The caller has checked that everything
    /// fits together.
    pub fn new(
        level: SimdLevel,
        [lens, normal_lens]: [Pinhole<f64>; 2],
        w2c: &[Se3<f64>],
        pairs: &'a PairStore,
        starts: &[Start<'_>],
    ) -> Self {
        let (width, height) = pairs.size();
        let shape = Shape::new(width, height);
        let frame = |s: &Start<'_>| Frame::new(shape, s.disparity, s.uncertainty);
        Self {
            level,
            shape,
            scratch: Pool {
                shape,
                normal_lens,
                free: Mutex::default(),
            },
            pairs,
            motions: pairs
                .pairs()
                .iter()
                .map(|&p| Motion::new(&lens, w2c, p))
                .collect(),
            rounds: rounds(w2c.len(), pairs.pairs()),
            frames: starts.par_iter().map(frame).collect(),
        }
    }

    /// Begins a stage at the disparity that the last one reached.
    pub fn begin(&mut self) {
        let (level, shape, scratch) = (self.level, self.shape, &self.scratch);
        self.frames.par_iter_mut().for_each(|frame| {
            scratch.lend(|scratch| dispatch!(level.level(), _s => frame.begin(shape, scratch)));
        });
    }

    /// One step of Adam; `number` counts from 1 in each stage.
    pub fn step(
        &mut self,
        moves: Moves,
        weights: &Weights,
        learning_rate: f64,
        epsilon: f64,
        number: usize,
    ) -> Result<Report, PairError> {
        let sums = self.pair_terms(weights)?;
        let (level, shape, scratch) = (self.level, self.shape, &self.scratch);
        let pair_scale = 1.0 / (sums.count + 1e-8);
        let step = Step {
            shape,
            frames: self.frames.len(),
            weights,
            pair_scale,
            moves,
            rate: Rate::new(learning_rate, number, epsilon),
        };
        let losses: Vec<f64> = self
            .frames
            .par_iter_mut()
            .map(|frame| {
                scratch.lend(|scratch| dispatch!(level.level(), _s => frame.step(&step, scratch)))
            })
            .collect();
        Ok(Report {
            loss: pair_scale * sums.loss + losses.iter().sum::<f64>(),
            count: sums.count,
        })
    }

    /// The terms of the pairs, round by round.
    fn pair_terms(&mut self, weights: &Weights) -> Result<Sums, PairError> {
        let Self { level, shape, .. } = *self;
        let mut total = Sums::default();
        for round in &self.rounds {
            // each task owns what it writes to, and gives it back afterwards
            let mut work: Vec<Work<'_>> = Vec::with_capacity(round.len());
            for task in round {
                let frame = &mut self.frames[task.source];
                let own = [
                    std::mem::take(&mut frame.by_disparity),
                    std::mem::take(&mut frame.by_uncertainty),
                ];
                let target = |&k: &usize| {
                    std::mem::take(&mut self.frames[self.pairs.pairs()[k].target].scatter)
                };
                work.push(Work {
                    task,
                    own,
                    targets: task.pairs.iter().map(target).collect(),
                });
            }
            let (frames, motions, pairs) = (&self.frames, &self.motions, self.pairs);
            let sums: Vec<Result<Sums, PairError>> = work
                .par_iter_mut()
                .map_init(
                    || (Rows::default(), Vec::<CompactFlow>::new()),
                    |(rows, buffers), work| {
                        buffers.resize_with(work.task.pairs.len(), CompactFlow::default);
                        let mut views = Vec::with_capacity(work.task.pairs.len());
                        for ((&k, buffer), scatter) in work.task.pairs.iter().zip(buffers).zip(&mut work.targets) {
                            views.push(PairBuffers {
                                flow: pairs.flow(k, buffer)?,
                                motion: motions[k],
                                seen: &frames[pairs.pairs()[k].target].seen,
                                scatter,
                            });
                        }
                        let frame = &frames[work.task.source];
                        let [by_disparity, by_uncertainty] = &mut work.own;
                        let source = Source {
                            seen: &frame.seen,
                            uncertainty: &frame.seen_uncertainty,
                            by_disparity,
                            by_uncertainty,
                        };
                        Ok(dispatch!(level.level(), s => pair::source(s, shape, weights, source, &mut views, rows)))
                    },
                )
                .collect();
            for work in work {
                let frame = &mut self.frames[work.task.source];
                [frame.by_disparity, frame.by_uncertainty] = work.own;
                for (&k, scatter) in work.task.pairs.iter().zip(work.targets) {
                    self.frames[self.pairs.pairs()[k].target].scatter = scatter;
                }
            }
            for sums in sums {
                let Sums { loss, count } = sums?;
                total.loss += loss;
                total.count += count;
            }
        }
        Ok(total)
    }

    /// Puts the disparity of all frames, `[frames][height][width]`, somewhere else than where the
    /// stage began.
    #[cfg(test)]
    pub fn place(&mut self, disparity: &[f32]) {
        for (frame, d) in self
            .frames
            .iter_mut()
            .zip(disparity.chunks_exact(self.shape.pixels()))
        {
            frame.disparity = self.shape.spread(d, 1.0);
            frame.look(self.shape, 1.0, 0.0);
        }
    }

    /// Ends stage 1: scale and shift of each frame, which become part of its disparity.
    pub fn settle(&mut self) -> Vec<(f64, f64)> {
        self.frames.par_iter_mut().for_each(Frame::settle);
        self.frames
            .iter()
            .map(|f| (f.log_scale.exp(), f.shift))
            .collect()
    }

    /// The disparity of each frame, `[height][width]`, not clamped.
    pub fn disparity(&self) -> Vec<Vec<f32>> {
        self.frames
            .iter()
            .map(|f| self.shape.gather(&f.disparity))
            .collect()
    }

    /// u of each frame, `[height][width]`, not clamped.
    pub fn uncertainty(&self) -> Vec<Vec<f32>> {
        self.frames
            .iter()
            .map(|f| self.shape.gather(&f.uncertainty))
            .collect()
    }
}

/// A task and what it writes to.
struct Work<'a> {
    task: &'a Task,
    /// Gradients of the source with respect to disparity and uncertainty.
    own: [Vec<f32>; 2],
    /// Scattered gradients of the targets, one a pair.
    targets: Vec<Vec<f32>>,
}

/// All pairs of one source.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Task {
    pub source: usize,
    /// Indices of its pairs, in the order of their sums.
    pub pairs: Vec<usize>,
}

/// Rounds of tasks. Tasks of a round share no target, so each may add to its targets' gradients
/// without waiting; rounds follow one another, so every sum has one order on any number of threads.
pub(super) fn rounds(frames: usize, pairs: &[FramePair]) -> Vec<Vec<Task>> {
    let mut tasks: Vec<Task> = (0..frames)
        .map(|source| Task {
            source,
            pairs: Vec::new(),
        })
        .collect();
    for (index, pair) in pairs.iter().enumerate() {
        tasks[pair.source].pairs.push(index);
    }
    let mut rounds: Vec<(Vec<Task>, HashSet<usize>)> = Vec::new();
    for task in tasks.into_iter().filter(|t| !t.pairs.is_empty()) {
        let targets: Vec<usize> = task.pairs.iter().map(|&k| pairs[k].target).collect();
        let free = rounds
            .iter_mut()
            .find(|(_, round_targets)| targets.iter().all(|t| !round_targets.contains(t)));
        match free {
            Some((tasks, round_targets)) => {
                tasks.push(task);
                round_targets.extend(targets);
            }
            None => rounds.push((vec![task], targets.into_iter().collect())),
        }
    }
    rounds.into_iter().map(|(tasks, _)| tasks).collect()
}

/// The natural logarithm of a positive, normal number.
#[inline(always)]
fn ln(x: f32) -> f32 {
    // the mantissa between sqrt(1/2) and sqrt(2)
    const ROOT: u32 = 0x3f35_04f3;
    let shifted = x.to_bits().wrapping_sub(ROOT);
    let e = ((shifted as i32) >> 23) as f32;
    let f = f32::from_bits((shifted & 0x007f_ffff) + ROOT) - 1.0;
    let mut p = 7.037_684e-2;
    p = p * f - 1.151_461e-1;
    p = p * f + 1.167_699_9e-1;
    p = p * f - 1.242_014_1e-1;
    p = p * f + 1.424_932_3e-1;
    p = p * f - 1.666_805_8e-1;
    p = p * f + 2.000_071_5e-1;
    p = p * f - 2.499_999_4e-1;
    p = p * f + 3.333_333e-1;
    let square = f * f;
    let low = p * square * f - 2.121_944_4e-4 * e - 0.5 * square;
    (f + low) + 0.693_359_4 * e
}

/// `e^x` for `x` of 0 or less; 1e-35 and the like become about that.
#[inline(always)]
fn exp(x: f32) -> f32 {
    let x = if x > -80.0 { x } else { -80.0 };
    // adding 1.5 * 2^23 rounds, and leaves the whole number in the low bits
    let magic = 12_582_912.0;
    let shifted = x * std::f32::consts::LOG2_E + magic;
    let n = shifted - magic;
    let r = (x - n * 0.693_359_4) + n * 2.121_944_4e-4;
    let mut p = 1.987_569_1e-4;
    p = p * r + 1.398_199_9e-3;
    p = p * r + 8.333_452e-3;
    p = p * r + 4.166_579_6e-2;
    p = p * r + 1.666_666_5e-1;
    p = p * r + 5.0e-1;
    let y = p * r * r + r + 1.0;
    f32::from_bits(y.to_bits().wrapping_add(shifted.to_bits() << 23))
}

#[cfg(test)]
mod tests {
    use super::{exp, ln, rounds};
    use crate::megasam::cvd::pairs::{FramePair, pair_list};
    use std::collections::HashSet;

    #[test]
    fn every_pair_is_in_one_round_and_rounds_share_no_target() {
        let mut pairs = pair_list(60);
        let back: Vec<FramePair> = pairs
            .iter()
            .map(|p| FramePair {
                source: p.target,
                target: p.source,
            })
            .collect();
        for both in [false, true] {
            if both {
                pairs.extend(&back);
            }
            let rounds = rounds(60, &pairs);
            let mut indices = HashSet::new();
            for round in &rounds {
                let mut targets = HashSet::new();
                for task in round {
                    for &k in &task.pairs {
                        assert_eq!(pairs[k].source, task.source);
                        assert!(indices.insert(k) && targets.insert(pairs[k].target));
                    }
                }
            }
            assert_eq!(indices.len(), pairs.len());
            assert!(
                rounds.len() <= if both { 30 } else { 8 },
                "{} rounds",
                rounds.len()
            );
        }
    }

    #[test]
    fn elementary_functions_match_the_standard_library() {
        for k in 0..200_000 {
            let x = 1e-4 * 1.000_12f64.powi(k % 150_000) as f32;
            let want = f64::from(x).ln();
            assert!(
                (f64::from(ln(x)) - want).abs() <= 2e-7 * want.abs().max(0.5),
                "ln {x}"
            );
            let y = -60.0 * k as f32 / 200_000.0;
            let want = f64::from(y).exp();
            assert!((f64::from(exp(y)) - want).abs() <= 5e-7 * want, "exp {y}");
        }
        assert_eq!((ln(1.0), exp(0.0)), (0.0, 1.0));
        assert!(exp(-1e9) < 1e-30);
    }
}
