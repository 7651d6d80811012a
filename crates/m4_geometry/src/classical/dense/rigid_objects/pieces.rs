//! The largest piece of a part that moves like one rigid body: the trunk of an animal and not its
//! legs, a tractor and neither its wheels nor its trailer. It is searched for by random samples in
//! the paths around some moments, and followed from the best one to the other frames.

use super::BLOCK_PX;
use super::edges::Part;
use super::silhouette::radius_px;
use super::subspace::Space;
use m4_core::CounterRng;
use rayon::prelude::*;

/// Paths are followed over this time before and after a frame, seconds.
const REACH_S: f64 = 1.0 / 3.0;
/// Random samples at one moment, and their paths: as many as determine a space, and one more.
const SAMPLES: usize = 300;
const SAMPLE: usize = 5;
/// Samples lie in a circle of this share of the part's radius.
const NEAR: f64 = 0.7;
/// Fewest paths of a piece.
const LEAST_PATHS: usize = 12;
/// Most paths that a space is fitted to; of more, every nth is taken.
const MOST_PATHS: usize = 500;
/// Least share of the part that a piece has.
const LEAST_SHARE: f64 = 0.15;
/// Share from which a block is followed to the next frame.
const FOLLOWED: f32 = 0.3;
/// Time between the moments at which the piece is searched for, seconds.
const SEARCH_S: f64 = 1.0 / 6.0;
/// Purpose of the random numbers.
const PURPOSE: u64 = 0x9_1ece;

/// How far the blocks of each frame belong to the largest rigid piece, `[frames][blocks]`, 0..1;
/// `None` where no piece is large enough.
pub(super) fn largest_piece(part: &Part<'_>) -> Option<Vec<Vec<f32>>> {
    let frames = part.frames();
    let reach = reach(part).min(frames.saturating_sub(1) / 2);
    let moments: Vec<usize> = (reach..frames - reach)
        .step_by(part.clip.rate.frames(SEARCH_S))
        .collect();
    let candidates: Vec<(f64, usize, Space)> = moments
        .into_par_iter()
        .filter_map(|k| {
            let (share, space) = Paths::of(part, k).search(k)?;
            Some((share, k, space))
        })
        .collect();
    let (share, start, space) = (candidates.into_iter()).max_by(|a, b| a.0.total_cmp(&b.0))?;
    if share < LEAST_SHARE {
        return None;
    }
    let mut shares = vec![Vec::new(); frames];
    shares[start] = Paths::of(part, start).shares(&space);
    let later = start + 1..frames;
    let earlier = (0..start).rev();
    for (k, before) in later.map(|k| (k, k - 1)).chain(earlier.map(|k| (k, k + 1))) {
        let paths = Paths::of(part, k);
        shares[k] = match paths.follow(before, &shares[before]) {
            Some(space) => paths.shares(&space),
            None => paths.carried(before, &shares[before]),
        };
    }
    Some(shares)
}

fn reach(part: &Part<'_>) -> usize {
    part.clip.rate.frames(REACH_S).max(2)
}

/// Where the blocks of a frame are in the frames around it.
struct Paths<'a> {
    part: &'a Part<'a>,
    /// The first of these frames.
    first: usize,
    /// Blocks of the part, rising.
    blocks: Vec<usize>,
    /// x and y by frame, pixels, not a number where a block is lost.
    paths: Vec<Vec<f64>>,
}

impl<'a> Paths<'a> {
    fn of(part: &'a Part<'a>, k: usize) -> Self {
        let reach = reach(part);
        let first = k.saturating_sub(reach);
        let frames = (k + reach + 1).min(part.frames()) - first;
        let blocks: Vec<usize> = (0..part.blocks.grid.len())
            .filter(|&g| part.has(k, g))
            .collect();
        let mut paths = vec![vec![f64::NAN; 2 * frames]; blocks.len()];
        for (path, &g) in paths.iter_mut().zip(&blocks) {
            let (x, y) = part.blocks.pixel(g);
            path[2 * (k - first)..][..2].copy_from_slice(&[x as f64, y as f64]);
        }
        for later in [true, false] {
            part.walk(k, later, reach, |step| {
                let at = 2 * (step.frame - first);
                for (path, &g) in paths.iter_mut().zip(&blocks) {
                    if step.miss[g].is_finite() {
                        let place = [step.px[g], step.py[g]].map(f64::from);
                        path[at..][..2].copy_from_slice(&place);
                    }
                }
            });
        }
        Self {
            part,
            first,
            blocks,
            paths,
        }
    }

    /// Paths that are known in all frames, evenly chosen, and of how many blocks each is one.
    fn whole(&self) -> (Vec<&[f64]>, usize) {
        let known = |path: &&[f64]| path.iter().all(|v| !v.is_nan());
        let all: Vec<&[f64]> = self.paths.iter().map(Vec::as_slice).filter(known).collect();
        let every = all.len().div_ceil(MOST_PATHS).max(1);
        (all.into_iter().step_by(every).collect(), every)
    }

    /// The space that most paths around frame `k` lie in, and the share of the part in it.
    fn search(&self, k: usize) -> Option<(f64, Space)> {
        let (whole, every) = self.whole();
        if whole.len() < LEAST_PATHS {
            return None;
        }
        let total = |space: &Space| whole.iter().map(|path| space.share(path)).sum::<f64>();
        let at = 2 * (k - self.first);
        let radius = NEAR * radius_px(self.blocks.len()) * BLOCK_PX as f64;
        let mut best: Option<(f64, Space)> = None;
        for sample in 0..SAMPLES {
            let mut rng = CounterRng::new(PURPOSE, k as u64, sample as u64);
            let centre = whole[rng.below(whole.len())];
            let off = |path: &[f64]| (path[at] - centre[at]).hypot(path[at + 1] - centre[at + 1]);
            let near: Vec<&[f64]> = (whole.iter().copied())
                .filter(|path| off(path) < radius)
                .collect();
            if near.len() < SAMPLE {
                continue;
            }
            let chosen = rng.sample(near.len(), SAMPLE).into_iter().map(|i| near[i]);
            let Some(space) = Space::of(&chosen.collect::<Vec<_>>()) else {
                continue;
            };
            let score = total(&space);
            if best.as_ref().is_none_or(|(most, _)| score > *most) {
                best = Some((score, space));
            }
        }
        let space = best?.1.settle(&whole, LEAST_PATHS)?;
        Some((
            total(&space) * every as f64 / self.paths.len() as f64,
            space,
        ))
    }

    /// How far each block belongs to a body.
    fn shares(&self, space: &Space) -> Vec<f32> {
        let mut out = vec![0.0; self.part.blocks.grid.len()];
        for (path, &g) in self.paths.iter().zip(&self.blocks) {
            out[g] = space.share(path) as f32;
        }
        out
    }

    /// The shares of another frame, carried to this one.
    fn carried(&self, before: usize, shares: &[f32]) -> Vec<f32> {
        let mut out = vec![0.0; self.part.blocks.grid.len()];
        for (path, &g) in self.paths.iter().zip(&self.blocks) {
            out[g] = self.block(path, before).map_or(0.0, |block| shares[block]);
        }
        out
    }

    /// The body of the blocks that belonged to it in another frame.
    fn follow(&self, before: usize, shares: &[f32]) -> Option<Space> {
        let (whole, _) = self.whole();
        let own: Vec<&[f64]> = (whole.iter().copied())
            .filter(|path| {
                self.block(path, before)
                    .is_some_and(|b| shares[b] > FOLLOWED)
            })
            .collect();
        if own.len() < LEAST_PATHS {
            return None;
        }
        Space::of(&own)?.settle(&whole, LEAST_PATHS)
    }

    /// The block nearest to a path in a frame.
    fn block(&self, path: &[f64], frame: usize) -> Option<usize> {
        let at = 2 * frame.checked_sub(self.first)?;
        let (grid, [left, top]) = (self.part.blocks.grid, self.part.blocks.corner);
        let index = |v: f64, from: usize, count: usize| {
            let i = (v / BLOCK_PX as f64).round() - from as f64;
            (i >= 0.0 && i < count as f64).then_some(i as usize)
        };
        let column = index(*path.get(at)?, left, grid.width)?;
        let row = index(*path.get(at + 1)?, top, grid.height)?;
        Some(row * grid.width + column)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Tracklet;
    use super::{Part, largest_piece};
    use crate::classical::dense::working::ClipData;
    use crate::flow::FlowPair;
    use m4_core::Flow;

    const W: usize = 160;
    const H: usize = 80;
    const FRAMES: usize = 20;
    const LEFT: usize = 8;
    const JOINT: usize = 60;
    const RIGHT: usize = 92;

    /// A trunk that grows and turns, so that its relief shows, and beside it, from column [`JOINT`]
    /// on, a limb that also goes up and down, by `swing` pixels a frame.
    fn clip(swing: f32) -> (ClipData, Tracklet) {
        let speed = |k: usize| {
            if (k / 5).is_multiple_of(2) {
                swing
            } else {
                -swing
            }
        };
        let limb = |p: usize| p % W >= JOINT && p % W < RIGHT + FRAMES;
        let grows = |p: usize| 0.01 * ((p % W) as f32 - 40.0);
        let relief = |p: usize, k: usize| (0.2 * (p / W) as f32).sin() * (0.5 * k as f32).cos();
        let flow = |k: usize, sign: f32| Flow {
            width: W,
            height: H,
            u: (0..W * H)
                .map(|p| sign * (grows(p) + relief(p, k)))
                .collect(),
            v: (0..W * H)
                .map(|p| if limb(p) { sign * speed(k) } else { 0.0 })
                .collect(),
        };
        let part = |_| -> Vec<u32> {
            let inside = |p: &u32| {
                let (x, y) = (*p as usize % W, *p as usize / W);
                (LEFT..RIGHT).contains(&x) && (20..60).contains(&y)
            };
            (0..(W * H) as u32).filter(inside).collect()
        };
        let data = ClipData {
            size: (W, H),
            cameras: Vec::new(),
            dynamic: Vec::new(),
            disparity: Vec::new(),
            flows: (0..FRAMES - 1)
                .map(|k| FlowPair {
                    forward: flow(k, 1.0),
                    backward: flow(k, -1.0),
                })
                .collect(),
        };
        let parts = (0..FRAMES).map(part).collect();
        (data, Tracklet { first: 0, parts })
    }

    /// Mean shares of the trunk and of the limb in the middle frame, away from the joint.
    fn shares(swing: f32) -> [f32; 2] {
        let (data, tracklet) = clip(swing);
        let clip = data.clip();
        let part = Part::of(&clip, &tracklet);
        let shares = largest_piece(&part).unwrap();
        assert_eq!(shares.len(), FRAMES);
        [(LEFT + 8, JOINT - 8), (JOINT + 8, RIGHT - 8)].map(|(from, end)| {
            let of_piece: Vec<f32> = (0..part.blocks.grid.len())
                .filter(|&g| (from..end).contains(&part.blocks.pixel(g).0))
                .filter(|&g| (30..50).contains(&part.blocks.pixel(g).1))
                .map(|g| shares[FRAMES / 2][g])
                .collect();
            of_piece.iter().sum::<f32>() / of_piece.len() as f32
        })
    }

    #[test]
    fn a_limb_that_moves_otherwise_is_not_of_the_trunk() {
        let [trunk, limb] = shares(0.0);
        assert!(trunk > 0.8 && limb > 0.8, "{trunk} {limb}");
        let [trunk, limb] = shares(1.5);
        assert!(trunk > 0.8 && limb < 0.1, "{trunk} {limb}");
    }
}
