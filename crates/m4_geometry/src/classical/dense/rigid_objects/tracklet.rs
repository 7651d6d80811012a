//! A dynamic part through time, for as long as it stays one part, and which pixels of the masks
//! belong to which object while objects pass in front of one another.
//!
//! Two objects whose images touch are one connected part of the mask. Those that were separate
//! before are separated by carrying their labels along the flow, those that will be by carrying
//! labels back from then; a region is what has the same pair of labels.

use super::{LEAST_SHARE, ROUND_TRIP_PX, WorkingClip, shortest};
use crate::classical::dense::regions::Components;
use crate::classical::dense::working::pixel_at;
use crate::flow::FlowPair;
use rayon::prelude::*;
use std::collections::{BTreeMap, VecDeque};

/// Most frames that are adjusted together: bounds memory.
const LONGEST: usize = 96;
/// A region that grows or shrinks by more than this factor from one frame to the next is another
/// region.
const GROWTH: f32 = 1.6;

/// One connected part in consecutive frames.
pub(in super::super) struct Tracklet {
    /// Its first frame.
    pub first: usize,
    /// Pixels of the part in frames `first..`, in order of rows.
    pub parts: Vec<Vec<u32>>,
}

/// For every part of a frame the part of the other frame where most of it is seen, and the share.
fn heirs(
    clip: &WorkingClip<'_>,
    from: (usize, &Components),
    to: (usize, &Components),
) -> Vec<usize> {
    let (w, h) = (clip.width, clip.height);
    let Some(way) = FlowPair::step(clip.flows, from.0, from.0 < to.0) else {
        return Vec::new();
    };
    let (from, to) = (from.1, to.1);
    from.pixels
        .iter()
        .map(|pixels| {
            let mut hits = vec![0usize; to.pixels.len() + 1];
            let mut count = 0usize;
            for &p in pixels {
                let p = p as usize;
                if way.round_trip_px(p) > ROUND_TRIP_PX {
                    continue;
                }
                let x = ((p % w) as f32 + way.flow.u[p] + 0.5).max(0.0) as usize;
                let y = ((p / w) as f32 + way.flow.v[p] + 0.5).max(0.0) as usize;
                if x < w && y < h {
                    count += 1;
                    hits[to.label[y * w + x] as usize] += 1;
                }
            }
            let best = (1..hits.len())
                .max_by_key(|&k| (hits[k], usize::MAX - k))
                .unwrap_or(0);
            if best > 0 && 2 * hits[best] > count {
                best
            } else {
                0
            }
        })
        .collect()
}

/// Follows every part until it leaves, splits, merges or changes its size at once.
pub(in super::super) fn follow(clip: &WorkingClip<'_>) -> Vec<Tracklet> {
    let (w, h) = (clip.width, clip.height);
    let mut done = Vec::new();
    // The open tracklet of every part of the frame before.
    let mut open: Vec<Option<Tracklet>> = Vec::new();
    let least = (LEAST_SHARE * (w * h) as f32) as usize;
    let regions = regions(clip);
    let both = |t: usize| {
        let (before, now) = ((t - 1, &regions[t - 1]), (t, &regions[t]));
        (heirs(clip, before, now), heirs(clip, now, before))
    };
    let links: Vec<(Vec<usize>, Vec<usize>)> =
        (1..regions.len()).into_par_iter().map(both).collect();
    for (t, now) in regions.iter().enumerate() {
        let mut next: Vec<Option<Tracklet>> = (0..now.pixels.len()).map(|_| None).collect();
        if let Some(before) = t.checked_sub(1).map(|t| &regions[t]) {
            let (forward, backward) = &links[t - 1];
            for (a, tracklet) in open.drain(..).enumerate() {
                let Some(mut tracklet) = tracklet else {
                    continue;
                };
                let b = forward[a];
                let mutual = b > 0 && backward[b - 1] == a + 1;
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
    }
    done.extend(open.into_iter().flatten());
    done.retain(|t| t.parts.len() >= shortest(clip));
    done
}

/// Least share of its pixels that a label must keep, to be in a part at all.
const KEPT: f32 = 0.35;
/// Of a part with several labels, the share that one must have for the others to be noise.
const ALL_BUT: f32 = 0.97;
/// A pair of labels is one thing if it has this share of the pixels of either.
const PAIR: f32 = 0.5;

/// The regions of every frame.
pub(super) fn regions(clip: &WorkingClip<'_>) -> Vec<Components> {
    let (w, h) = (clip.width, clip.height);
    let parts: Vec<Components> = clip
        .dynamic
        .par_iter()
        .map(|m| Components::of(w, h, m))
        .collect();
    let least = ((LEAST_SHARE * (w * h) as f32) as usize).max(1);
    let (later, earlier) = rayon::join(
        || carry(clip, &parts, least, true),
        || carry(clip, &parts, least, false),
    );
    let labels = later.par_iter().zip(&earlier);
    parts
        .par_iter()
        .zip(labels)
        .map(|(parts, (a, b))| pairs(w, h, parts, a, b, least))
        .collect()
}

/// Labels (`[height][width]` by frame, 0 outside the masks) carried from one end of the clip to the
/// other.
fn carry(clip: &WorkingClip<'_>, parts: &[Components], least: usize, later: bool) -> Vec<Vec<u32>> {
    let n = parts.len();
    let mut out: Vec<Vec<u32>> = vec![Vec::new(); n];
    let mut fresh = 0u32;
    // In how many frames a label had a part of its own.
    let mut age: BTreeMap<u32, usize> = BTreeMap::new();
    let mut before: Option<usize> = None;
    for step in 0..n {
        let t = if later { step } else { n - 1 - step };
        let labels = match before {
            Some(s) => next(clip, &parts[t], &out[s], (s, t), least, &age, &mut fresh),
            None => own(&parts[t], &mut fresh),
        };
        for pixels in &parts[t].pixels {
            let first = labels[pixels[0] as usize];
            if pixels.iter().all(|&p| labels[p as usize] == first) {
                *age.entry(first).or_default() += 1;
            }
        }
        out[t] = labels;
        before = Some(t);
    }
    out
}

/// A label of its own for every part.
fn own(parts: &Components, fresh: &mut u32) -> Vec<u32> {
    let first = *fresh;
    *fresh += parts.pixels.len() as u32;
    parts
        .label
        .iter()
        .map(|&l| if l > 0 { first + l } else { 0 })
        .collect()
}

/// The labels of frame `t` from those of its neighbour `s`.
fn next(
    clip: &WorkingClip<'_>,
    parts: &Components,
    labels: &[u32],
    (s, t): (usize, usize),
    least: usize,
    age: &BTreeMap<u32, usize>,
    fresh: &mut u32,
) -> Vec<u32> {
    let (w, h) = (clip.width, clip.height);
    let Some(way) = FlowPair::step(clip.flows, t, t < s) else {
        return own(parts, fresh);
    };
    let mut area: BTreeMap<u32, usize> = BTreeMap::new();
    for &l in labels.iter().filter(|l| **l > 0) {
        *area.entry(l).or_default() += 1;
    }
    let shortest = shortest(clip);
    let mut out = vec![0u32; w * h];
    // By part: the labels it takes on, with their votes.
    let mut heirs: Vec<Vec<(u32, usize)>> = Vec::new();
    for pixels in &parts.pixels {
        let mut votes: BTreeMap<u32, usize> = BTreeMap::new();
        let mut all = 0usize;
        for &p in pixels {
            let p = p as usize;
            let target = pixel_at(
                w,
                h,
                (p % w) as f32 + way.flow.u[p],
                (p / w) as f32 + way.flow.v[p],
            );
            if let Some(q) =
                target.filter(|&q| way.round_trip_px(p) <= ROUND_TRIP_PX && labels[q] > 0)
            {
                out[p] = labels[q];
                *votes.entry(out[p]).or_default() += 1;
                all += 1;
            }
        }
        let first = votes
            .iter()
            .max_by_key(|(l, n)| (**n, u32::MAX - **l))
            .map(|(l, n)| (*l, *n));
        let alone = first.is_some_and(|(_, n)| n as f32 >= ALL_BUT * all as f32);
        // What was apart for a moment only is a flaw of the masks.
        let is_heir = |l: u32, n: usize| {
            n as f32 >= KEPT * area[&l] as f32
                && (Some((l, n)) == first
                    || !alone && n >= least / 2 && age.get(&l).is_some_and(|a| *a >= shortest))
        };
        heirs.push(votes.into_iter().filter(|(l, n)| is_heir(*l, *n)).collect());
    }
    // A label that went to several parts stays with the one that has most of it.
    let mut most: BTreeMap<u32, (usize, usize)> = BTreeMap::new();
    for (k, heir) in heirs.iter().enumerate() {
        for &(l, n) in heir {
            let best = most.entry(l).or_insert((k, n));
            if n > best.1 {
                *best = (k, n);
            }
        }
    }
    for (k, pixels) in parts.pixels.iter().enumerate() {
        let mut renamed: BTreeMap<u32, u32> = BTreeMap::new();
        for &(l, _) in &heirs[k] {
            let mine = most.get(&l).is_some_and(|(best, _)| *best == k);
            renamed.insert(l, if mine { l } else { new(fresh) });
        }
        if renamed.is_empty() {
            let only = new(fresh);
            for &p in pixels {
                out[p as usize] = only;
            }
            continue;
        }
        for &p in pixels {
            let label = &mut out[p as usize];
            *label = renamed.get(label).copied().unwrap_or(0);
        }
        flood(w, h, parts, k, &mut out);
    }
    out
}

fn new(fresh: &mut u32) -> u32 {
    *fresh += 1;
    *fresh
}

/// Gives every pixel of a part without a label that of the nearest that has one.
fn flood(w: usize, h: usize, parts: &Components, k: usize, labels: &mut [u32]) {
    let part = k as u32 + 1;
    let mut open: VecDeque<usize> = parts.pixels[k]
        .iter()
        .map(|&p| p as usize)
        .filter(|&p| labels[p] > 0)
        .collect();
    while let Some(p) = open.pop_front() {
        let (x, y) = (p % w, p / w);
        for ny in y.saturating_sub(1)..(y + 2).min(h) {
            for nx in x.saturating_sub(1)..(x + 2).min(w) {
                let n = ny * w + nx;
                if parts.label[n] == part && labels[n] == 0 {
                    labels[n] = labels[p];
                    open.push_back(n);
                }
            }
        }
    }
}

/// The regions of one frame: pairs of labels that are the better part of either, the rest with the
/// nearest of them.
fn pairs(w: usize, h: usize, parts: &Components, a: &[u32], b: &[u32], least: usize) -> Components {
    let mut label = vec![0u32; w * h];
    let mut regions: Vec<Vec<u32>> = Vec::new();
    for (k, pixels) in parts.pixels.iter().enumerate() {
        let mut count: BTreeMap<(u32, u32), usize> = BTreeMap::new();
        let (mut of_a, mut of_b): (BTreeMap<u32, usize>, BTreeMap<u32, usize>) =
            (BTreeMap::new(), BTreeMap::new());
        for &p in pixels {
            let (a, b) = (a[p as usize], b[p as usize]);
            *count.entry((a, b)).or_default() += 1;
            *of_a.entry(a).or_default() += 1;
            *of_b.entry(b).or_default() += 1;
        }
        let whole = |(pair, n): (&(u32, u32), &usize)| {
            *n >= least && *n as f32 >= PAIR * of_a[&pair.0].min(of_b[&pair.1]) as f32
        };
        let numbers: BTreeMap<(u32, u32), u32> = count
            .iter()
            .filter(|x| whole(*x))
            .map(|(pair, _)| *pair)
            .zip(regions.len() as u32 + 1..)
            .collect();
        if numbers.len() < 2 {
            regions.push(pixels.clone());
            for &p in pixels {
                label[p as usize] = regions.len() as u32;
            }
            continue;
        }
        for &p in pixels {
            let p = p as usize;
            label[p] = numbers.get(&(a[p], b[p])).copied().unwrap_or(0);
        }
        flood(w, h, parts, k, &mut label);
        let first = regions.len();
        regions.resize(first + numbers.len(), Vec::new());
        for &p in pixels {
            regions[label[p as usize] as usize - 1].push(p);
        }
    }
    Components {
        label,
        pixels: regions,
    }
}
