//! Where the pixels of a part are in frames before and after: the edges of its adjustment.

use super::{BLOCK_PX, ROUND_TRIP_PX, Tracklet, WorkingClip};
use crate::classical::dense::working::{nearest_pixel, pixel_at};
use crate::dba::{Factor, Grid};
use crate::flow::FlowPair;

/// Over how many frames a region is compared with itself, each both ways; rising. Not in seconds:
/// errors add up with every step of the flow, and at 60 frames per second spans of the same seconds
/// as at 24 gave 3 to 12 % worse depth on three scenes.
const SPANS: [usize; 4] = [1, 3, 8, 16];

/// The pixels that are adjusted: one of every [`BLOCK_PX`] squared, in the box in which a part
/// stays.
#[derive(Clone)]
pub(super) struct Blocks {
    pub grid: Grid,
    /// Its first column and row.
    pub corner: [usize; 2],
}

impl Blocks {
    pub fn around(clip: &WorkingClip<'_>, tracklet: &Tracklet) -> Self {
        let (mut from, mut to) = ([usize::MAX; 2], [0usize; 2]);
        for &p in tracklet.parts.iter().flatten() {
            let p = p as usize;
            for (axis, at) in [p % clip.width, p / clip.width].into_iter().enumerate() {
                from[axis] = from[axis].min(at / BLOCK_PX);
                to[axis] = to[axis].max(at / BLOCK_PX + 1);
            }
        }
        Self {
            grid: Grid {
                width: to[0].saturating_sub(from[0]),
                height: to[1].saturating_sub(from[1]),
            },
            corner: from,
        }
    }

    /// Column and row in the frame.
    pub fn pixel(&self, g: usize) -> (usize, usize) {
        let [left, top] = self.corner;
        (
            (left + g % self.grid.width) * BLOCK_PX,
            (top + g / self.grid.width) * BLOCK_PX,
        )
    }

    /// The blocks up to this distance from one along rows and columns, with it.
    pub fn near(&self, g: usize, distance: usize) -> impl Iterator<Item = usize> + use<> {
        let Grid { width, height } = self.grid;
        let around =
            |at: usize, end: usize| at.saturating_sub(distance)..(at + distance + 1).min(end);
        let columns = around(g % width, width);
        around(g / width, height).flat_map(move |y| columns.clone().map(move |x| y * width + x))
    }
}

/// A part and its blocks.
pub(super) struct Part<'a> {
    pub clip: &'a WorkingClip<'a>,
    pub tracklet: &'a Tracklet,
    pub blocks: Blocks,
    /// One bit a pixel by frame of the tracklet.
    inside: Vec<Vec<bool>>,
}

impl<'a> Part<'a> {
    pub fn of(clip: &'a WorkingClip<'a>, tracklet: &'a Tracklet) -> Self {
        let one = |pixels: &Vec<u32>| {
            let mut inside = vec![false; clip.width * clip.height];
            for &p in pixels {
                inside[p as usize] = true;
            }
            inside
        };
        Self {
            clip,
            tracklet,
            blocks: Blocks::around(clip, tracklet),
            inside: tracklet.parts.iter().map(one).collect(),
        }
    }

    /// Number of frames; they are counted from the tracklet's first.
    pub fn frames(&self) -> usize {
        self.tracklet.parts.len()
    }

    /// Whether a block shows the part in a frame.
    pub fn has(&self, k: usize, g: usize) -> bool {
        let (x, y) = self.blocks.pixel(g);
        self.at(k, x as f32, y as f32)
    }

    fn at(&self, k: usize, x: f32, y: f32) -> bool {
        pixel_at(self.clip.width, self.clip.height, x, y)
            .is_some_and(|p| x > -0.5 && y > -0.5 && self.inside[k][p])
    }

    /// The edges of every frame to those [`SPANS`] before and after.
    pub fn factors(&self) -> Vec<Factor<f32>> {
        let ways = (0..self.frames()).flat_map(|k| [(k, true), (k, false)]);
        ways.flat_map(|(k, later)| self.chain(k, later)).collect()
    }

    fn chain(&self, k: usize, later: bool) -> Vec<Factor<f32>> {
        let block = BLOCK_PX as f32;
        let [left, top] = self.blocks.corner.map(|c| c as f32);
        let mut out = Vec::new();
        self.walk(k, later, SPANS[SPANS.len() - 1], |step| {
            if !SPANS.contains(&step.span) {
                return;
            }
            let weight = |m: &f32| {
                if m.is_finite() {
                    1.0 / (1.0 + m * m)
                } else {
                    0.0
                }
            };
            let weight: Vec<f32> = step.miss.iter().map(weight).collect();
            out.push(Factor {
                source: k,
                target: step.frame,
                target_px: [
                    step.px.iter().map(|x| x / block - left).collect(),
                    step.py.iter().map(|y| y / block - top).collect(),
                ],
                weight: [weight.clone(), weight],
            });
        });
        out
    }

    /// Follows the blocks of frame `k` along the flow, for up to `most` frames.
    pub fn walk(&self, k: usize, later: bool, most: usize, mut visit: impl FnMut(&Step)) {
        let (w, h) = (self.clip.width, self.clip.height);
        let n = self.blocks.grid.len();
        let mut step = Step {
            span: 0,
            frame: k,
            px: vec![0.0; n],
            py: vec![0.0; n],
            miss: vec![f32::INFINITY; n],
        };
        for g in (0..n).filter(|&g| self.has(k, g)) {
            let (x, y) = self.blocks.pixel(g);
            (step.px[g], step.py[g], step.miss[g]) = (x as f32, y as f32, 0.0);
        }
        for span in 1..=most {
            let at = step.frame;
            let next = if later { at + 1 } else { at.wrapping_sub(1) };
            let way = FlowPair::step(self.clip.flows, self.tracklet.first + at, later);
            let Some(way) = way.filter(|_| next < self.frames()) else {
                return;
            };
            for g in 0..n {
                if !step.miss[g].is_finite() {
                    continue;
                }
                let (x, y) = (step.px[g], step.py[g]);
                let (u, v) = way.flow.at(x, y);
                let trip = way.round_trip_px(nearest_pixel(w, h, x, y));
                (step.px[g], step.py[g]) = (x + u, y + v);
                step.miss[g] = if trip < ROUND_TRIP_PX && self.at(next, x + u, y + v) {
                    step.miss[g].hypot(trip)
                } else {
                    f32::INFINITY
                };
            }
            (step.span, step.frame) = (span, next);
            visit(&step);
        }
    }
}

/// Where the blocks of a frame are in another one.
pub(super) struct Step {
    /// Number of frames between both.
    span: usize,
    pub frame: usize,
    /// Pixel coordinates by block.
    pub px: Vec<f32>,
    pub py: Vec<f32>,
    /// How far the flow misses on its way back, pixels; infinite where a block is lost.
    pub miss: Vec<f32>,
}
