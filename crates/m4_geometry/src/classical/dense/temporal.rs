//! Means over time along the flow.

use super::working::nearest_pixel;
use crate::flow::FlowPair;
use rayon::prelude::*;

/// A pixel of a frame, and the one of a neighbouring frame that the flow leads to.
pub(super) struct Step {
    pub frame: usize,
    pub pixel: usize,
    pub other_frame: usize,
    pub other_pixel: usize,
    /// See [`Way::round_trip_px`](crate::flow::Way::round_trip_px).
    pub round_trip_px: f32,
}

/// Means from one end of the clip up to a frame.
struct Running {
    sum: Vec<f32>,
    weight: Vec<f32>,
}

/// Averages `values` (`[height][width]` by frame) over time: weights decrease by e in `frames`
/// frames along the flow, forwards and backwards alike, so that nothing lags, and with what `trust`
/// (0..1) has of each step.
pub(super) fn mean(
    width: usize,
    values: &[Vec<f32>],
    flows: &[FlowPair],
    frames: f32,
    trust: impl Fn(&Step) -> f32 + Sync,
) -> Vec<Vec<f32>> {
    let along = Along {
        width,
        values,
        flows,
        decay: (-1.0 / frames).exp(),
        trust,
    };
    let mut backward: Vec<Running> = Vec::with_capacity(values.len());
    for i in (0..values.len()).rev() {
        backward.push(along.extended(i, backward.last(), true));
    }
    let mut forward: Option<Running> = None;
    let mut out = Vec::with_capacity(values.len());
    for (i, own) in values.iter().enumerate() {
        let f = along.extended(i, forward.as_ref(), false);
        // Backward means are consumed as the forward ones are made: they come out first frame
        // first.
        let Some(b) = backward.pop() else { break };
        let both = f.sum.iter().zip(&f.weight).zip(b.sum.iter().zip(&b.weight));
        // The frame's own value is in both.
        out.push(
            both.zip(own)
                .map(|(((fs, fw), (bs, bw)), own)| (fs + bs - own) / (fw + bw - 1.0))
                .collect(),
        );
        forward = Some(f);
    }
    out
}

struct Along<'a, T> {
    width: usize,
    values: &'a [Vec<f32>],
    flows: &'a [FlowPair],
    decay: f32,
    trust: T,
}

impl<T: Fn(&Step) -> f32 + Sync> Along<'_, T> {
    /// Frame `i` with `last`, which ends at frame `i - 1` or, `backward`, at `i + 1`.
    fn extended(&self, i: usize, last: Option<&Running>, backward: bool) -> Running {
        let mut running = Running {
            sum: self.values[i].clone(),
            weight: vec![1.0; self.values[i].len()],
        };
        let (Some(last), Some(way)) = (last, FlowPair::step(self.flows, i, backward)) else {
            return running;
        };
        let flow = way.flow;
        let (w, h) = (self.width, self.values[i].len() / self.width);
        let other_frame = if backward { i + 1 } else { i - 1 };
        let rows = running
            .sum
            .par_chunks_mut(w)
            .zip(running.weight.par_chunks_mut(w))
            .enumerate();
        rows.for_each(|(y, (sum, weight))| {
            for (x, (sum, weight)) in sum.iter_mut().zip(weight).enumerate() {
                let pixel = y * w + x;
                let other_pixel =
                    nearest_pixel(w, h, x as f32 + flow.u[pixel], y as f32 + flow.v[pixel]);
                let step = Step {
                    frame: i,
                    pixel,
                    other_frame,
                    other_pixel,
                    round_trip_px: way.round_trip_px(pixel),
                };
                let share = self.decay * (self.trust)(&step);
                *sum += share * last.sum[other_pixel];
                *weight += share * last.weight[other_pixel];
            }
        });
        running
    }
}

#[cfg(test)]
mod tests {
    use super::{FlowPair, mean};
    use m4_core::Flow;

    #[test]
    fn values_spread_both_ways_along_the_flow_as_far_as_it_is_trusted() {
        let (w, n) = (8, 5);
        // everything moves one pixel to the right, and one pixel of the middle frame has a value
        let flow = |u: f32| Flow {
            u: vec![u; w * 2],
            ..Flow::zero(w, 2)
        };
        let flows: Vec<FlowPair> = (1..n)
            .map(|_| FlowPair {
                forward: flow(1.0),
                backward: flow(-1.0),
            })
            .collect();
        let mut values = vec![vec![0.0f32; w * 2]; n];
        values[2][4] = 1.0;
        let out = mean(w, &values, &flows, 2.0, |_| 1.0);
        assert!(out[2][4] > out[1][3] && out[1][3] > out[0][2] && out[0][2] > 0.0);
        assert!((out[1][3] - out[3][5]).abs() < 1e-6 && out[1][4] == 0.0);
        let cut = mean(w, &values, &flows, 2.0, |step| {
            if step.frame.max(step.other_frame) > 2 {
                0.0
            } else {
                1.0
            }
        });
        assert!(cut[1][3] > 0.0 && cut[3][5] == 0.0);
        assert_eq!(mean(w, &values, &flows, 2.0, |_| 0.0), values);
    }
}
