//! Where the pixels of a part are in frames before and after: the edges of its adjustment.

use super::{BLOCK_PX, ROUND_TRIP_PX, Tracklet, WorkingClip};
use crate::classical::dense::working::{nearest_pixel, pixel_at};
use crate::dba::{Factor, Grid};
use crate::flow::FlowPair;

/// Over how many frames a region is compared with itself, each both ways; rising. Not in seconds:
/// errors add up with every step of the flow, and at 60 frames per second spans of the same seconds
/// as at 24 gave 3 to 12 % worse depth on three scenes.
const SPANS: [usize; 3] = [1, 3, 8];

/// The pixels that are adjusted: one of every [`BLOCK_PX`] squared, in the box in which a part
/// stays.
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
}

/// One bit a pixel of every frame of a tracklet.
pub(super) struct Inside(Vec<Vec<bool>>);

impl Inside {
    pub fn of(clip: &WorkingClip<'_>, tracklet: &Tracklet) -> Self {
        let one = |pixels: &Vec<u32>| {
            let mut inside = vec![false; clip.width * clip.height];
            for &p in pixels {
                inside[p as usize] = true;
            }
            inside
        };
        Self(tracklet.parts.iter().map(one).collect())
    }

    pub fn at(&self, k: usize, x: f32, y: f32, w: usize, h: usize) -> bool {
        pixel_at(w, h, x, y).is_some_and(|p| x > -0.5 && y > -0.5 && self.0[k][p])
    }
}

/// The edges of every frame to those [`SPANS`] before and after; frames are counted from the
/// tracklet's first.
pub(super) fn factors(
    clip: &WorkingClip<'_>,
    tracklet: &Tracklet,
    inside: &Inside,
    blocks: &Blocks,
) -> Vec<Factor<f32>> {
    let ways = (0..tracklet.parts.len()).flat_map(|k| [(k, true), (k, false)]);
    ways.flat_map(|(k, later)| chain(clip, tracklet, inside, blocks, k, later))
        .collect()
}

fn chain(
    clip: &WorkingClip<'_>,
    tracklet: &Tracklet,
    inside: &Inside,
    blocks: &Blocks,
    k: usize,
    later: bool,
) -> Vec<Factor<f32>> {
    let (w, h, block) = (clip.width, clip.height, BLOCK_PX as f32);
    let [left, top] = blocks.corner.map(|c| c as f32);
    let n = blocks.grid.len();
    let (mut px, mut py, mut miss) = (vec![0.0f32; n], vec![0.0f32; n], vec![f32::INFINITY; n]);
    for g in 0..n {
        let (x, y) = blocks.pixel(g);
        let (x, y) = (x as f32, y as f32);
        if inside.at(k, x, y, w, h) {
            (px[g], py[g], miss[g]) = (x, y, 0.0);
        }
    }
    let mut out = Vec::new();
    let mut at = k;
    for span in 1..=SPANS[SPANS.len() - 1] {
        let next = if later { at + 1 } else { at.wrapping_sub(1) };
        let step = FlowPair::step(clip.flows, tracklet.first + at, later);
        let Some((flow, trip)) = step.filter(|_| next < tracklet.parts.len()) else {
            break;
        };
        for g in 0..n {
            if !miss[g].is_finite() {
                continue;
            }
            let (u, v) = flow.at(px[g], py[g]);
            let trip = trip[nearest_pixel(w, h, px[g], py[g])];
            (px[g], py[g]) = (px[g] + u, py[g] + v);
            miss[g] = if trip < ROUND_TRIP_PX && inside.at(next, px[g], py[g], w, h) {
                miss[g].hypot(trip)
            } else {
                f32::INFINITY
            };
        }
        at = next;
        if SPANS.contains(&span) {
            let weight: Vec<f32> = miss
                .iter()
                .map(|m| {
                    if m.is_finite() {
                        1.0 / (1.0 + m * m)
                    } else {
                        0.0
                    }
                })
                .collect();
            out.push(Factor {
                source: k,
                target: at,
                target_px: [
                    px.iter().map(|x| x / block - left).collect(),
                    py.iter().map(|y| y / block - top).collect(),
                ],
                weight: [weight.clone(), weight],
            });
        }
    }
    out
}
