//! A window of frames, in which points are moved a few times.

use super::Net;
use super::config::Config;
use super::encoding::encoded;
use super::frame::{Frame, Sides, rows_of};
use super::neighbours::{Cloud, Search};
use super::updater::QuerySide;
use crate::NetError;
use crate::error::numbers;
use crate::ops::tensor;
use burn_core::tensor::{Device, Tensor};
use rayon::prelude::*;
use std::sync::Arc;

/// Points whose neighbourhoods are compared at a time, on the processor (whose caches they should
/// fit) and elsewhere.
const TOGETHER: [usize; 2] = [4, 64];

/// Frames that are worked with together, in the network's space.
#[derive(Debug)]
pub struct Window {
    frames: Vec<Arc<Frame>>,
    pub space: Space,
    /// `[frame][level]`.
    clouds: Vec<Vec<Cloud>>,
}

/// Points in a window, in the network's space.
#[derive(Debug, Clone)]
pub struct State {
    /// `[frame][point]`.
    pub at: Vec<[f32; 3]>,
    /// How likely they are seen, as a logit, `[frame][point]`.
    pub logits: Vec<f32>,
}

impl Window {
    /// Of `frames`; `None` if they have no depth.
    pub fn new(frames: Vec<Arc<Frame>>, config: &Config) -> Option<Self> {
        let moments = frames
            .iter()
            .fold(Moments::default(), |sum, f| sum.with(&f.moments));
        let space = moments.space(config.norm_scale)?;
        let cloud =
            |points: &Vec<[f32; 3]>| Cloud::new(points.iter().map(|&p| space.enter(p)).collect());
        let clouds = frames
            .par_iter()
            .map(|frame| frame.points.iter().map(cloud).collect())
            .collect();
        Some(Self {
            frames,
            space,
            clouds,
        })
    }

    /// The side of the queries, a level each: `sides` in this window's space.
    pub fn query_sides(&self, net: &Net, sides: &Sides) -> Vec<QuerySide> {
        let level = |(level, (features, points)): (usize, (&Tensor<3>, &Vec<[f32; 3]>))| {
            let [_, tokens, _] = features.dims();
            let here: Vec<[f32; 3]> = points.iter().map(|&p| self.space.enter(p)).collect();
            let offsets: Vec<[f32; 3]> = here
                .chunks_exact(tokens)
                .flat_map(|around| around.iter().map(|&p| minus(p, around[0])))
                .collect();
            net.corr_processor
                .query_side(level, features.clone(), &offsets)
        };
        sides
            .features
            .iter()
            .zip(&sides.points)
            .enumerate()
            .map(level)
            .collect()
    }

    /// Numbers of the points of the maps near `at` `[frame][point]`, `[frame][point][neighbour]`.
    pub fn near(&self, level: usize, at: &[[f32; 3]], neighbours: usize) -> Vec<u32> {
        let points = at.len() / self.frames.len();
        let mut near = vec![0; at.len() * neighbours];
        near.par_chunks_mut(neighbours)
            .zip(at)
            .enumerate()
            .for_each_init(Search::default, |search, (i, (near, &at))| {
                let cloud = &self.clouds[i / points][level];
                for (near, neighbour) in near.iter_mut().zip(cloud.nearest(at, neighbours, search))
                {
                    *near = neighbour;
                }
            });
        near
    }

    /// How the neighbourhoods of points `at` `[frame][point]` compare with those of their queries,
    /// `[frames, points, levels * width]`.
    pub fn compared(
        &self,
        net: &Net,
        sides: &[QuerySide],
        at: &[[f32; 3]],
        neighbours: usize,
    ) -> Tensor<3> {
        let frames = self.frames.len();
        let points = at.len() / frames;
        let step = TOGETHER[usize::from(net.time_emb.device() != Device::flex())];
        let some = |first: usize| {
            let n = step.min(points - first);
            let at: Vec<[f32; 3]> = (0..frames)
                .flat_map(|t| at[t * points + first..][..n].iter().copied())
                .collect();
            let level = |(level, side): (usize, &QuerySide)| {
                let near = self.near(level, &at, neighbours);
                let offsets: Vec<[f32; 3]> = near
                    .par_chunks_exact(neighbours)
                    .zip(&at)
                    .enumerate()
                    .flat_map_iter(|(i, (near, &at))| {
                        let points = self.clouds[i / n][level].points();
                        near.iter().map(move |&j| minus(points[j as usize], at))
                    })
                    .collect();
                let features = self.frames.iter().zip(near.chunks_exact(n * neighbours));
                let features = features.map(|(frame, near)| {
                    rows_of(
                        &frame.features[level],
                        near.iter().map(|&j| j as i32).collect(),
                    )
                });
                let features = Tensor::cat(features.collect(), 0);
                let [_, c] = features.dims();
                let features = features.reshape([frames * n, neighbours, c]);
                let side = side.some(first, n);
                net.corr_processor.forward(level, &side, features, &offsets)
            };
            let levels = Tensor::cat(sides.iter().enumerate().map(level).collect(), 1);
            let [_, c] = levels.dims();
            levels.reshape([frames, n, c])
        };
        Tensor::cat((0..points).step_by(step).map(some).collect(), 1)
    }

    /// What the updater is given, `[frames, points, input]`: visibility, `compared`, steps from the
    /// frames beside, and the time.
    pub fn input(&self, net: &Net, state: &State, compared: Tensor<3>) -> Tensor<3> {
        let frames = self.frames.len();
        let points = state.at.len() / frames;
        let (device, dtype) = (compared.device(), compared.dtype());
        let at = |t: usize, i: usize| state.at[t * points + i];
        let steps: Vec<[f32; 6]> = (0..frames * points)
            .map(|k| {
                let (t, i) = (k / points, k % points);
                let here = at(t, i);
                let next = if t + 1 < frames {
                    minus(here, at(t + 1, i))
                } else {
                    [0.0; 3]
                };
                let last = if t > 0 {
                    minus(here, at(t - 1, i))
                } else {
                    [0.0; 3]
                };
                [next[0], next[1], next[2], last[0], last[1], last[2]]
            })
            .collect();
        let steps = encoded(&steps, &device, dtype);
        let [_, c] = steps.dims();
        let logits = tensor(state.logits.clone(), [frames, points, 1], &device).cast(dtype);
        let all = Tensor::cat(
            vec![logits, compared, steps.reshape([frames, points, c])],
            2,
        );
        let [_, _, c] = all.dims();
        all + net.time_emb.val().reshape([frames, 1, c])
    }

    /// `state` moved once.
    pub fn moved(
        &self,
        net: &Net,
        sides: &[QuerySide],
        mut state: State,
        neighbours: usize,
    ) -> Result<State, NetError> {
        let compared = self.compared(net, sides, &state.at, neighbours);
        let out = net
            .point_updater
            .forward(self.input(net, &state, compared))
            .narrow(2, 0, 4);
        let out = numbers(out)?;
        let points = state.at.iter_mut().zip(&mut state.logits);
        for ((at, logit), d) in points.zip(out.as_chunks::<4>().0) {
            (0..3).for_each(|axis| at[axis] += d[axis]);
            *logit += d[3];
        }
        Ok(state)
    }
}

fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Mean and sum of squared distances from it, an axis each, of some points.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Moments {
    n: f64,
    mean: [f64; 3],
    squares: [f64; 3],
}

impl Moments {
    /// Of points from their sums and sums of squares about `about`.
    pub fn of_sums(n: usize, about: [f64; 3], sums: [f64; 3], squares: [f64; 3]) -> Self {
        let n = n as f64;
        if n == 0.0 {
            return Self::default();
        }
        Self {
            n,
            mean: [0, 1, 2].map(|i| about[i] + sums[i] / n),
            squares: [0, 1, 2].map(|i| (squares[i] - sums[i] * sums[i] / n).max(0.0)),
        }
    }

    /// Of these points and those of `other`.
    pub fn with(self, other: &Self) -> Self {
        let n = self.n + other.n;
        if n == 0.0 {
            return self;
        }
        let apart = [0, 1, 2].map(|i| other.mean[i] - self.mean[i]);
        Self {
            n,
            mean: [0, 1, 2].map(|i| self.mean[i] + apart[i] * other.n / n),
            squares: [0, 1, 2].map(|i| {
                self.squares[i] + other.squares[i] + apart[i] * apart[i] * self.n * other.n / n
            }),
        }
    }

    /// The space of these points, by their mean and one standard deviation; `None` if there are
    /// none, or all at one place.
    pub fn space(&self, scale: f32) -> Option<Space> {
        let std = (self.squares.iter().sum::<f64>() / (3.0 * self.n)).sqrt() as f32;
        let space = Space {
            mean: self.mean.map(|x| x as f32),
            std,
            scale,
        };
        let usable = self.n > 0.0 && space.mean.iter().all(|x| x.is_finite());
        (usable && std.is_finite() && std > 0.0).then_some(space)
    }
}

/// A space: what is taken off, by what is divided, by what is multiplied.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Space {
    pub mean: [f32; 3],
    pub std: f32,
    scale: f32,
}

impl Space {
    /// A point of the world.
    pub fn enter(&self, p: [f32; 3]) -> [f32; 3] {
        [0, 1, 2].map(|i| (p[i] - self.mean[i]) / self.std * self.scale)
    }

    /// A point of this space in the world.
    pub fn leave(&self, p: [f32; 3]) -> [f32; 3] {
        [0, 1, 2].map(|i| p[i] / self.scale * self.std + self.mean[i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_have_the_moments_of_the_whole() {
        let points: Vec<[f64; 3]> = (0..97)
            .map(|i| [(i * i % 31) as f64 + 1e4, (i % 7) as f64 * 0.1, -(i as f64)])
            .collect();
        let of = |points: &[[f64; 3]]| {
            let about = points[0];
            let sums = [0, 1, 2].map(|a| points.iter().map(|p| p[a] - about[a]).sum());
            let squares = [0, 1, 2].map(|a| points.iter().map(|p| (p[a] - about[a]).powi(2)).sum());
            Moments::of_sums(points.len(), about, sums, squares)
        };
        let parts = of(&points[..40])
            .with(&of(&points[40..]))
            .with(&Moments::default());
        let mean = [0, 1, 2].map(|a| points.iter().map(|p| p[a]).sum::<f64>() / 97.0);
        let variance =
            |a: usize| points.iter().map(|p| (p[a] - mean[a]).powi(2)).sum::<f64>() / 97.0;
        let space = parts.space(2.0).unwrap();
        let std = ((variance(0) + variance(1) + variance(2)) / 3.0).sqrt();
        for a in 0..3 {
            assert!((f64::from(space.mean[a]) / mean[a] - 1.0).abs() < 1e-6);
        }
        assert!((f64::from(space.std) / std - 1.0).abs() < 1e-6);
        let p = [1e4_f32, 3.0, -8.0];
        let back = space.leave(space.enter(p));
        assert!((0..3).all(|a| (back[a] - p[a]).abs() < 2e-3), "{back:?}");
        assert_eq!(Moments::default().space(1.0), None);
        assert_eq!(of(&points[..1]).space(1.0), None);
    }
}
