//! Joins the pieces of a part. Each is adjusted alone, so each has a unit of its own; three things
//! tell their ratio: contact, blocks that both have while they move as one, and blocks that adjoin.

use super::edges::{Blocks, Part};
use super::scale::{self, Decision};
use super::shape_prior::ShapePrior;
use super::vote::Vote;
use super::{relief, shortest};
use m4_core::quantile;

/// Standard deviation of the logarithm of the ratio of two pieces where all frames agree: by the
/// same blocks, by those that adjoin, which is off by the gap between them, and by contact.
const SAME_SIGMA: f64 = 0.02;
const ADJOINING_SIGMA: f64 = 0.04;
const CONTACT_SIGMA: f64 = 0.04;
/// Largest standard deviation by contact. What is less steady does not stand: a leg that swings.
const MOST_SIGMA: f64 = 0.06;
/// Blocks adjoin up to this distance along rows and columns.
const ADJOINING_BLOCKS: usize = 2;
/// Fewest pairs of blocks of a frame that counts.
const LEAST_PAIRS: usize = 3;

/// Adds a `piece` to a `shape`, both `[frames][blocks]` with 0 where there is nothing, in the unit
/// of the shape: those blocks that the shape does not have. A piece that does not stand is not
/// added: what hangs on another is as far as that, better than by its own motion.
pub(super) fn attach(
    part: &Part<'_>,
    prior: &ShapePrior,
    shape: &mut [Vec<f32>],
    piece: &[Vec<f32>],
) {
    let blocks = &part.blocks;
    let vote = |ratio: &dyn Fn(usize) -> Option<f32>, sigma: f64| {
        let mut ratios: Vec<f32> = (0..part.frames()).filter_map(ratio).collect();
        let enough = ratios.len() >= shortest(part.clip);
        enough.then(|| Vote::of_frames(&mut ratios, sigma))?
    };
    let same = vote(&|k| same(&shape[k], &piece[k]), SAME_SIGMA);
    let adjoining = vote(
        &|k| adjoining(blocks, &prior.upright[k], &shape[k], &piece[k]),
        ADJOINING_SIGMA,
    );
    let standing = vote(
        &|k| standing(blocks, prior, k, &shape[k], &piece[k]),
        CONTACT_SIGMA,
    );
    let attached = (same.into_iter().chain(adjoining)).min_by(|a, b| a.sigma.total_cmp(&b.sigma));
    let steady = standing.filter(|vote| vote.sigma < MOST_SIGMA);
    // What adjoins may be another object, as what turns may just move.
    let decision = steady.and_then(|vote| scale::decide(Some(vote), attached));
    let Some(Decision { vote, .. }) = decision else {
        return;
    };
    for (shape, piece) in shape.iter_mut().zip(piece) {
        let added = (shape.iter_mut().zip(piece)).filter(|(d, own)| **d <= 0.0 && **own > 0.0);
        added.for_each(|(d, own)| *d = own * vote.factor as f32);
    }
}

/// Ratio of a shape to a piece in one frame by the blocks that both have.
fn same(shape: &[f32], piece: &[f32]) -> Option<f32> {
    let both = (shape.iter().zip(piece)).filter(|(d, own)| **d > 0.0 && **own > 0.0);
    middle(both.map(|(d, own)| d / own).collect())
}

/// Ratio of a shape to a piece in one frame where they adjoin, on the planes of `upright`.
fn adjoining(blocks: &Blocks, upright: &[f32], shape: &[f32], piece: &[f32]) -> Option<f32> {
    let only = |own: &[f32], other: &[f32], g: usize| own[g] > 0.0 && other[g] <= 0.0;
    let beside = |g: usize| {
        (blocks.near(g, ADJOINING_BLOCKS))
            .filter(|&n| only(shape, piece, n))
            .map(move |n| (shape[n] / upright[n]) / (piece[g] / upright[g]))
    };
    let own = (0..piece.len()).filter(|&g| only(piece, shape, g));
    middle(own.flat_map(beside).collect())
}

/// Their median, if there are enough.
fn middle(mut ratios: Vec<f32>) -> Option<f32> {
    let enough = ratios.len() >= LEAST_PAIRS;
    enough.then(|| quantile(&mut ratios, 0.5))?
}

/// Ratio of a shape to a piece in one frame, where both stand on the ground: each with the lower
/// ends of the part that are nearer to it than to the other.
fn standing(
    blocks: &Blocks,
    prior: &ShapePrior,
    k: usize,
    shape: &[f32],
    piece: &[f32],
) -> Option<f32> {
    if !prior.feet.on_ground(k) {
        return None;
    }
    let rest: Vec<f32> = (shape.iter().zip(piece))
        .map(|(d, own)| if *own > 0.0 { 0.0 } else { *d })
        .collect();
    let factor = |own: &[f32], other: &[f32]| {
        prior.feet.factor_of(k, |ends| {
            let values = relief::carried(blocks.grid.width, &prior.upright[k], own, ends);
            let nearer = |g: usize| distance(blocks, own, g) < distance(blocks, other, g);
            let of_end = |(g, value): (&usize, f32)| if nearer(*g) { value } else { 0.0 };
            ends.iter().zip(values).map(of_end).collect()
        })
    };
    Some(factor(piece, &rest)? / factor(&rest, piece)?)
}

/// Squared distance of a block from the nearest of a piece, blocks; `None` if it has none.
fn distance(blocks: &Blocks, piece: &[f32], g: usize) -> Option<usize> {
    let place = |g: usize| (g % blocks.grid.width, g / blocks.grid.width);
    let (x, y) = place(g);
    (0..piece.len())
        .filter(|&n| piece[n] > 0.0)
        .map(place)
        .map(|(u, v)| u.abs_diff(x).pow(2) + v.abs_diff(y).pow(2))
        .min()
}

#[cfg(test)]
mod tests {
    use super::super::Tracklet;
    use super::{Part, ShapePrior, attach};
    use crate::classical::dense::working::ClipData;

    const W: usize = 160;
    const H: usize = 90;
    const FRAMES: usize = 12;
    /// Columns and rows of a part of two pieces that meet in its middle.
    const COLUMNS: std::ops::Range<usize> = 40..120;
    const ROWS: std::ops::Range<usize> = 20..60;
    const MIDDLE: usize = 80;

    /// What the right piece is after it was attached to the left one, of disparity 0.7, over ground
    /// that is as near as `ground` says by column. The left one also has the right one's blocks, of
    /// disparity `same`, in the first half of the frames; all end at row 60 but those of a right
    /// one that is `raised`.
    fn attached(same: f32, ground: impl Fn(usize) -> f32, raised: bool) -> f32 {
        let inside = |x: usize, y: usize| {
            let end = if raised && x >= MIDDLE { 40 } else { ROWS.end };
            COLUMNS.contains(&x) && (ROWS.start..end).contains(&y)
        };
        let at = |p: usize| (p % W, p / W);
        let pixels: Vec<u32> = (0..W * H)
            .filter(|&p| inside(at(p).0, at(p).1))
            .map(|p| p as u32)
            .collect();
        let mask = |p: usize| 255 * u8::from(inside(at(p).0, at(p).1));
        let background = |p: usize| ground(at(p).0) + 0.01 * (at(p).1 as f32 - ROWS.end as f32);
        let data = ClipData {
            size: (W, H),
            cameras: Vec::new(),
            dynamic: vec![(0..W * H).map(mask).collect(); FRAMES],
            disparity: vec![(0..W * H).map(background).collect(); FRAMES],
            flows: Vec::new(),
        };
        let clip = data.clip();
        let tracklet = Tracklet {
            first: 0,
            parts: vec![pixels; FRAMES],
        };
        let part = Part::of(&clip, &tracklet);
        let prior = ShapePrior::of(&part, None);
        let of_piece = |right: bool, value: f32| -> Vec<f32> {
            (0..part.blocks.grid.len())
                .map(|g| match part.blocks.pixel(g) {
                    (x, y) if inside(x, y) && (x >= MIDDLE) == right => value,
                    _ => 0.0,
                })
                .collect()
        };
        let [left, right, both] = [
            of_piece(false, 0.7),
            of_piece(true, 0.5),
            of_piece(true, same),
        ];
        let mut shape = vec![left; FRAMES];
        for shape in &mut shape[..FRAMES / 2] {
            let joined = shape.iter_mut().zip(&both).filter(|(_, d)| **d > 0.0);
            joined.for_each(|(shape, d)| *shape = *d);
        }
        attach(&part, &prior, &mut shape, &vec![right; FRAMES]);
        let of_right = part.blocks.grid.width - 1;
        shape[FRAMES - 1][of_right]
    }

    #[test]
    fn a_piece_is_as_far_as_the_same_blocks_of_another_and_what_it_adjoins() {
        let adjoins = attached(0.0, |_| 0.7, false);
        assert!((adjoins / 0.7).ln().abs() < 0.005, "{adjoins}");
        // the same blocks are surer than contact, which says 0.7
        let same = attached(0.69, |_| 0.7, false);
        assert!((same / 0.692).ln().abs() < 0.003, "{same}");
    }

    #[test]
    fn a_piece_that_does_not_stand_is_not_added() {
        assert_eq!(attached(0.0, |_| 0.7, true), 0.0);
    }

    #[test]
    fn contact_is_averaged_with_what_adjoins() {
        // 0.7 under the middle of the left piece, 0.728 under that of the right one
        let standing = attached(0.0, |x| 0.7 + 0.0007 * (x as f32 - 60.0), false);
        assert!(standing > 0.71 && standing < 0.735, "{standing}");
    }
}
