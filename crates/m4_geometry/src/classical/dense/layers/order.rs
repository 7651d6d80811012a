//! Which of two dynamic regions that touch is in front: the outline between them moves with the front one, so pixels of the back
//! one are covered and uncovered there (Stein and Hebert 2009). A pixel of the back region, moved on as its region moves, lands in the
//! front one.

use super::super::rigid_objects::{Clip, ROUND_TRIP_PX};
use m4_core::{Flow, quantile};
use std::collections::BTreeMap;

/// How far from a region its neighbour is asked, in image widths.
const BAND: f32 = 0.006;
/// Standard deviations by which the shares of hidden pixels must differ to be believed.
const SURE: f32 = 3.0;

/// What is known of region `a` next to region `b`.
#[derive(Debug, Clone, Copy, Default)]
struct Beside {
    /// Pixels of `a` near `b`, all frames together.
    pixels: usize,
    /// Those of them that land in `b`, moved on as `a` moves.
    hidden: usize,
}

/// The rank of every tracklet: 0 for the farthest; greater than those of all that it touches and surely occludes. Regions that touch
/// without a sure order share a rank: they may be parts of one body.
pub(super) fn ranks(clip: &Clip<'_>, labels: &[Vec<u32>], count: usize) -> Vec<usize> {
    let mut beside: BTreeMap<(usize, usize), Beside> = BTreeMap::new();
    for t in 0..labels.len() {
        observe(clip, labels, t, &mut beside);
    }
    // By tracklet: those that it touches in a sure order, with how surely it is in front of them.
    let mut ordered: Vec<Vec<(usize, f32)>> = vec![Vec::new(); count];
    for (&(a, b), x) in &beside {
        let score = beside.get(&(b, a)).map_or(0.0, |y| in_front(*x, *y));
        if score.abs() >= SURE {
            ordered[a].push((b, score));
        }
    }
    // The farthest first: what is least in front of those that are left.
    let mut lead: Vec<f32> = ordered.iter().map(|with| with.iter().map(|(_, s)| s).sum()).collect();
    let mut rank: Vec<Option<usize>> = vec![None; count];
    for _ in 0..count {
        let left = (0..count).filter(|&a| rank[a].is_none());
        let Some(a) = left.min_by(|&a, &b| lead[a].total_cmp(&lead[b])) else {
            break;
        };
        let behind = ordered[a].iter().filter_map(|&(b, _)| rank[b]);
        rank[a] = Some(behind.max().map_or(0, |r| r + 1));
        for &(b, score) in &ordered[a] {
            lead[b] += score;
        }
    }
    rank.into_iter().map(Option::unwrap_or_default).collect()
}

/// How surely `a` is in front of `b`, standard deviations; below 0 where it is behind.
fn in_front(a: Beside, b: Beside) -> f32 {
    let (n, m) = (a.pixels as f32, b.pixels as f32);
    let mean = (a.hidden + b.hidden) as f32 / (n + m);
    let sigma = (mean * (1.0 - mean) * (1.0 / n + 1.0 / m)).sqrt();
    (b.hidden as f32 / m - a.hidden as f32 / n) / sigma.max(1e-6)
}

/// Adds what frame `t` shows together with the frames before and after it.
fn observe(clip: &Clip<'_>, labels: &[Vec<u32>], t: usize, beside: &mut BTreeMap<(usize, usize), Beside>) {
    let (w, h) = (clip.width, clip.height);
    let reach = ((BAND * w as f32).round() as usize).max(1);
    let label = &labels[t];
    let mut pairs: Vec<(usize, u32)> = Vec::new();
    for p in (0..w * h).filter(|&p| label[p] > 0) {
        let (x, y) = (p % w, p / w);
        let first = pairs.len();
        for ny in y.saturating_sub(reach)..(y + reach + 1).min(h) {
            for &other in &label[ny * w + x.saturating_sub(reach)..ny * w + (x + reach + 1).min(w)] {
                if other > 0 && other != label[p] && pairs[first..].iter().all(|&(_, l)| l != other) {
                    pairs.push((p, other));
                }
            }
        }
    }
    if pairs.is_empty() {
        return;
    }
    let neighbours = [
        clip.flows.get(t).map(|f| (t + 1, &f.forward, &f.forward_round_trip)),
        t.checked_sub(1).map(|s| (s, &clip.flows[s].backward, &clip.flows[s].backward_round_trip)),
    ];
    for (to, flow, trip) in neighbours.into_iter().flatten() {
        let motion = motions(label, flow, trip);
        for &(p, other) in &pairs {
            let Some([u, v]) = motion.get(&label[p]) else {
                continue;
            };
            let (x, y) = ((p % w) as f32 + u + 0.5, (p / w) as f32 + v + 0.5);
            if x >= 0.0 && y >= 0.0 && x < w as f32 && y < h as f32 {
                let seen = beside.entry((label[p] as usize - 1, other as usize - 1)).or_default();
                seen.pixels += 1;
                seen.hidden += usize::from(labels[to][y as usize * w + x as usize] == other);
            }
        }
    }
}

/// Median flow of each label, of the pixels whose flow comes back.
fn motions(label: &[u32], flow: &Flow, trip: &[f32]) -> BTreeMap<u32, [f32; 2]> {
    let mut all: BTreeMap<u32, [Vec<f32>; 2]> = BTreeMap::new();
    for p in (0..label.len()).filter(|&p| label[p] > 0 && trip[p] <= ROUND_TRIP_PX) {
        let [u, v] = all.entry(label[p]).or_default();
        u.push(flow.u[p]);
        v.push(flow.v[p]);
    }
    let median = |v: &mut Vec<f32>| quantile(v, 0.5).unwrap_or(0.0);
    all.into_iter().map(|(l, [mut u, mut v])| (l, [median(&mut u), median(&mut v)])).collect()
}
