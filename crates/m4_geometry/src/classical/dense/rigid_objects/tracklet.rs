//! A moving part through time, for as long as it stays one part.

use super::super::components::Components;
use super::instances::regions;
use super::{Clip, LEAST_SHARE, ROUND_TRIP_PX, SHORTEST};
use m4_core::Flow;

/// Most frames that are adjusted together: bounds memory.
const LONGEST: usize = 96;
/// A region that grows or shrinks by more than this factor from one frame to the next is another region.
const GROWTH: f32 = 1.6;

/// One connected part in consecutive frames.
pub(in super::super) struct Tracklet {
    /// Its first frame.
    pub first: usize,
    /// Pixels of the part in frames `first..`, in order of rows.
    pub parts: Vec<Vec<u32>>,
}

/// For every part of a frame the part of the other frame where most of it is seen, and the share.
fn heirs(clip: &Clip<'_>, from: &Components, to: &Components, flow: &Flow, trip: &[f32]) -> Vec<usize> {
    let (w, h) = (clip.width, clip.height);
    from.pixels
        .iter()
        .map(|pixels| {
            let mut hits = vec![0usize; to.pixels.len() + 1];
            let mut seen = 0usize;
            for &p in pixels {
                let p = p as usize;
                if trip[p] > ROUND_TRIP_PX {
                    continue;
                }
                let x = ((p % w) as f32 + flow.u[p] + 0.5).max(0.0) as usize;
                let y = ((p / w) as f32 + flow.v[p] + 0.5).max(0.0) as usize;
                if x < w && y < h {
                    seen += 1;
                    hits[to.label[y * w + x] as usize] += 1;
                }
            }
            let best = (1..hits.len()).max_by_key(|&k| (hits[k], usize::MAX - k)).unwrap_or(0);
            if best > 0 && 2 * hits[best] > seen { best } else { 0 }
        })
        .collect()
}

/// Follows every part until it leaves, splits, merges or changes its size at once.
pub(in super::super) fn follow(clip: &Clip<'_>) -> Vec<Tracklet> {
    let (w, h) = (clip.width, clip.height);
    let mut done = Vec::new();
    // The open tracklet of every part of the frame before.
    let mut open: Vec<Option<Tracklet>> = Vec::new();
    let mut before: Option<Components> = None;
    let least = (LEAST_SHARE * (w * h) as f32) as usize;
    for (t, now) in regions(clip).into_iter().enumerate() {
        let mut next: Vec<Option<Tracklet>> = (0..now.pixels.len()).map(|_| None).collect();
        if let Some(before) = &before {
            let flow = &clip.flows[t - 1];
            let there = heirs(clip, before, &now, &flow.forward, &flow.forward_round_trip);
            let back = heirs(clip, &now, before, &flow.backward, &flow.backward_round_trip);
            for (a, tracklet) in open.drain(..).enumerate() {
                let Some(mut tracklet) = tracklet else { continue };
                let b = there[a];
                let mutual = b > 0 && back[b - 1] == a + 1;
                let (old, new) = (
                    before.pixels[a].len() as f32,
                    now.pixels.get(b.wrapping_sub(1)).map_or(0, Vec::len) as f32,
                );
                let alike = new > old / GROWTH && new < old * GROWTH;
                if mutual && alike && tracklet.parts.len() < LONGEST {
                    tracklet.parts.push(now.pixels[b - 1].clone());
                    next[b - 1] = Some(tracklet);
                } else {
                    done.push(tracklet);
                }
            }
        }
        for (k, slot) in next.iter_mut().enumerate() {
            if slot.is_none() && now.pixels[k].len() >= least {
                *slot = Some(Tracklet {
                    first: t,
                    parts: vec![now.pixels[k].clone()],
                });
            }
        }
        open = next;
        before = Some(now);
    }
    done.extend(open.into_iter().flatten());
    done.retain(|t| t.parts.len() >= SHORTEST);
    done
}
