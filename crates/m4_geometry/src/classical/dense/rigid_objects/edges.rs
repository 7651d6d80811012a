//! Where the pixels of a part are seen in other frames, for dense bundle adjustment.

use super::super::flow::FlowPair;
use super::{BLOCK_PX, Clip, ROUND_TRIP_PX, Tracklet};
use crate::dba::{Factor, Grid};

/// Over how many frames a region is compared with itself, each both ways; rising.
const SPANS: [usize; 3] = [1, 3, 8];

/// The flow at a pixel from frame `i` to a neighbour, and how far its round trip misses.
fn step(flows: &[FlowPair], i: usize, later: bool, x: f32, y: f32, w: usize, h: usize) -> (f32, f32, f32) {
    let (flow, trip) = if later {
        (&flows[i].forward, &flows[i].forward_round_trip)
    } else {
        (&flows[i - 1].backward, &flows[i - 1].backward_round_trip)
    };
    let (u, v) = flow.at(x, y);
    let q = ((y + 0.5).max(0.0) as usize).min(h - 1) * w + ((x + 0.5).max(0.0) as usize).min(w - 1);
    (u, v, trip[q])
}

/// One bit a pixel of every frame of a tracklet.
pub(super) struct Inside(Vec<Vec<bool>>);

impl Inside {
    pub fn of(clip: &Clip<'_>, tracklet: &Tracklet) -> Self {
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
        if !(x > -0.5 && y > -0.5) {
            return false;
        }
        let (x, y) = ((x + 0.5) as usize, (y + 0.5) as usize);
        x < w && y < h && self.0[k][y * w + x]
    }
}

/// The edges of every frame to those [`SPANS`] before and after; frames are counted from the tracklet's first.
pub(super) fn factors(clip: &Clip<'_>, tracklet: &Tracklet, inside: &Inside, grid: Grid) -> Vec<Factor<f32>> {
    let mut out = Vec::new();
    for k in 0..tracklet.parts.len() {
        for later in [true, false] {
            out.extend(chain(clip, tracklet, inside, grid, k, later));
        }
    }
    out
}

fn chain(clip: &Clip<'_>, tracklet: &Tracklet, inside: &Inside, grid: Grid, k: usize, later: bool) -> Vec<Factor<f32>> {
    let (w, h, block) = (clip.width, clip.height, BLOCK_PX as f32);
    let n = grid.len();
    let (mut px, mut py, mut miss) = (vec![0.0f32; n], vec![0.0f32; n], vec![f32::INFINITY; n]);
    for g in 0..n {
        let (x, y) = ((g % grid.width) as f32 * block, (g / grid.width) as f32 * block);
        if inside.at(k, x, y, w, h) {
            (px[g], py[g], miss[g]) = (x, y, 0.0);
        }
    }
    let mut out = Vec::new();
    let mut at = k;
    for span in 1..=SPANS[SPANS.len() - 1] {
        let next = if later { at + 1 } else { at.wrapping_sub(1) };
        if next >= tracklet.parts.len() {
            break;
        }
        for g in 0..n {
            if !miss[g].is_finite() {
                continue;
            }
            let (u, v, trip) = step(clip.flows, tracklet.first + at, later, px[g], py[g], w, h);
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
                .map(|m| if m.is_finite() { 1.0 / (1.0 + m * m) } else { 0.0 })
                .collect();
            out.push(Factor {
                source: k,
                target: at,
                target_px: [
                    px.iter().map(|x| x / block).collect(),
                    py.iter().map(|y| y / block).collect(),
                ],
                weight: [weight.clone(), weight],
            });
        }
    }
    out
}
