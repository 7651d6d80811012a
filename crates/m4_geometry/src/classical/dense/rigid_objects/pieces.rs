//! The pieces of a part that move like one rigid body: the trunk of an animal and not its legs, a
//! tractor, and its trailer. They are searched for by random samples in the paths around some
//! moments, and followed from the best one to the other frames.

use super::BLOCK_PX;
use super::edges::Part;
use super::silhouette::radius_px;
use super::subspace::Space;
use m4_core::{CounterRng, quantile};
use rayon::prelude::*;

/// Paths are followed over this time before and after a frame, seconds.
const REACH_S: f64 = 1.0 / 3.0;
/// It is shortened, down to this time, until this share of the blocks is visible in all of it.
const LEAST_REACH_S: f64 = 1.0 / 8.0;
const LEAST_WHOLE: f64 = 0.3;
/// Random samples at one moment, and their paths: as many as determine a space, and one more.
const SAMPLES: usize = 300;
const SAMPLE: usize = 5;
/// Samples lie in a circle of this share of the part's radius.
const NEAR: f64 = 0.7;
/// Fewest paths of a piece.
const LEAST_PATHS: usize = 12;
/// Most paths that a space is fitted to; of more, every nth is taken.
const MOST_PATHS: usize = 500;
/// Least share of the part that the largest piece has, and that others have.
const LEAST_SHARE: f64 = 0.15;
const LEAST_OTHER_SHARE: f64 = 0.06;
/// Least share that the largest piece has in half of the frames.
const LEAST_LASTING: f64 = 0.05;
/// Most pieces of a part.
const MOST_PIECES: usize = 4;
/// Share from which a block is followed to the next frame.
const FOLLOWED: f32 = 0.3;
/// Time between the moments at which the piece is searched for, seconds.
const SEARCH_S: f64 = 1.0 / 6.0;
/// Purpose of the random numbers.
const PURPOSE: u64 = 0x9_1ece;

/// How far the blocks of each frame belong to a rigid piece, `[frames][blocks]`, 0..1.
pub(super) type Shares = Vec<Vec<f32>>;

/// The rigid pieces of a part, largest first. Each is searched for in the blocks that are in none
/// before it. While two move as one, the first has the blocks of both, and the second keeps those
/// that it has before or after.
pub(super) fn pieces(part: &Part<'_>) -> Vec<Shares> {
    let mut pieces: Vec<Shares> = Vec::new();
    while pieces.len() < MOST_PIECES {
        let lasting = |piece: &Shares| !pieces.is_empty() || lasts(part, piece);
        let Some(piece) = next(part, &pieces).filter(lasting) else {
            break;
        };
        pieces.push(piece);
    }
    pieces
}

/// Whether a piece is visible in most frames: the others follow from it.
fn lasts(part: &Part<'_>, piece: &Shares) -> bool {
    let of_frame = |k: usize| {
        let all = (0..piece[k].len()).filter(|&g| part.has(k, g)).count();
        f64::from(piece[k].iter().sum::<f32>()) / all.max(1) as f64
    };
    let mut shares: Vec<f64> = (0..part.frames()).map(of_frame).collect();
    quantile(&mut shares, 0.5).is_some_and(|share| share > LEAST_LASTING)
}

/// The largest rigid piece of the blocks that are in none of the others; `None` where it is too
/// small.
fn next(part: &Part<'_>, others: &[Shares]) -> Option<Shares> {
    let frames = part.frames();
    let reach = reach(part).min(frames.saturating_sub(1) / 2);
    let free = |k: usize, g: usize| others.iter().all(|shares| shares[k][g] <= FOLLOWED);
    let moments: Vec<usize> = (reach..frames - reach)
        .step_by(part.clip.rate.frames(SEARCH_S))
        .collect();
    let candidates: Vec<(f64, usize, Space)> = moments
        .into_par_iter()
        .filter_map(|k| {
            let paths = Paths::of(part, k).only(|g, _| free(k, g));
            let (share, space) = paths.search(k)?;
            Some((share, k, space))
        })
        .collect();
    let (share, start, space) = (candidates.into_iter()).max_by(|a, b| a.0.total_cmp(&b.0))?;
    let least = match others {
        [] => LEAST_SHARE,
        _ => LEAST_OTHER_SHARE,
    };
    if share < least {
        return None;
    }
    let mut shares = vec![Vec::new(); frames];
    let first = Paths::of(part, start).only(|g, _| free(start, g));
    shares[start] = first.shares(&space);
    let later = start + 1..frames;
    let earlier = (0..start).rev();
    for (k, before) in later.map(|k| (k, k - 1)).chain(earlier.map(|k| (k, k + 1))) {
        let all = Paths::of(part, k);
        let own = |g, path: &[f64]| free(k, g) || all.follows(path, before, &shares[before]);
        let paths = all.only(own);
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
    /// Blocks of the part, of which these are some.
    all: usize,
}

impl<'a> Paths<'a> {
    /// Over [`REACH_S`], or as much of it as enough blocks are visible for: those of a thing that
    /// turns fast are hidden soon, and show their motion sooner.
    fn of(part: &'a Part<'a>, k: usize) -> Self {
        let mut reach = reach(part);
        let least = part.clip.rate.frames(LEAST_REACH_S).max(2);
        loop {
            let paths = Self::over(part, k, reach);
            let (whole, every) = paths.whole();
            let enough = (whole.len() * every) as f64 >= LEAST_WHOLE * paths.all as f64;
            if enough || reach <= least {
                return paths;
            }
            reach = (2 * reach / 3).max(least);
        }
    }

    fn over(part: &'a Part<'a>, k: usize, reach: usize) -> Self {
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
            all: blocks.len(),
            blocks,
            paths,
        }
    }

    /// The paths of some blocks.
    fn only(&self, kept: impl Fn(usize, &[f64]) -> bool) -> Self {
        let (blocks, paths) = (self.blocks.iter().zip(&self.paths))
            .filter(|(g, path)| kept(**g, path))
            .map(|(g, path)| (*g, path.clone()))
            .unzip();
        Self {
            blocks,
            paths,
            ..*self
        }
    }

    /// Whether a path is in the piece that has these shares in another frame.
    fn follows(&self, path: &[f64], frame: usize, shares: &[f32]) -> bool {
        (self.block(path, frame)).is_some_and(|block| shares[block] > FOLLOWED)
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
        Some((total(&space) * every as f64 / self.all as f64, space))
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
            .filter(|path| self.follows(path, before, shares))
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
    use super::{Part, Shares, pieces};
    use crate::classical::dense::working::ClipData;
    use crate::flow::FlowPair;
    use m4_core::Flow;

    const W: usize = 160;
    const H: usize = 80;
    const FRAMES: usize = 48;
    const LEFT: usize = 8;
    const JOINT: usize = 60;
    const RIGHT: usize = 92;

    /// A trunk that grows and turns, so that its relief shows, and beside it, from column [`JOINT`]
    /// on, a limb that also goes up and down, by `swing` pixels a frame from frame `from` on.
    fn clip(swing: f32, from: usize) -> (ClipData, Tracklet) {
        let speed = |k: usize| match (k < from, (k / 5).is_multiple_of(2)) {
            (true, _) => 0.0,
            (false, true) => swing,
            (false, false) => -swing,
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

    /// The pieces of a clip, and their mean shares of the trunk and of the limb in frame `k`, away
    /// from the joint.
    fn shares(swing: f32, from: usize, k: usize) -> Vec<[f32; 2]> {
        let (data, tracklet) = clip(swing, from);
        let clip = data.clip();
        let part = Part::of(&clip, &tracklet);
        let of_piece = |shares: &Shares| {
            assert_eq!(shares.len(), FRAMES);
            [(LEFT + 8, JOINT - 8), (JOINT + 8, RIGHT - 8)].map(|(from, end)| {
                let inside: Vec<f32> = (0..part.blocks.grid.len())
                    .filter(|&g| (from..end).contains(&part.blocks.pixel(g).0))
                    .filter(|&g| (30..50).contains(&part.blocks.pixel(g).1))
                    .map(|g| shares[k][g])
                    .collect();
                inside.iter().sum::<f32>() / inside.len() as f32
            })
        };
        pieces(&part).iter().map(of_piece).collect()
    }

    #[test]
    fn a_limb_that_moves_otherwise_is_a_piece_of_its_own() {
        let one = shares(0.0, 0, FRAMES / 2);
        assert!(one[0].iter().all(|share| *share > 0.8), "{one:?}");
        assert_eq!(one.len(), 1);
        let two = shares(1.5, 0, FRAMES / 2);
        assert!(two[0][0] > 0.8 && two[0][1] < 0.1, "{two:?}");
        assert!(two[1][0] < 0.1 && two[1][1] > 0.3, "{two:?}");
    }

    #[test]
    fn a_limb_stays_one_while_it_moves_with_the_trunk() {
        let all = shares(1.5, FRAMES / 2, FRAMES / 5);
        assert!(all[0].iter().all(|share| *share > 0.8), "{all:?}");
        let limb = |[trunk, limb]: &[f32; 2]| *trunk < 0.1 && *limb > 0.8;
        assert!(all.iter().any(limb), "{all:?}");
    }
}
