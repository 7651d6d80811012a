//! Dissolves: one image turns into an unconnected one.

use super::link::coarse;
use super::timeline::{Inspection, Reason};
use m4_core::Plane;
use std::collections::BTreeMap;
use std::ops::Range;

/// Half of the time that a dissolve may take, seconds.
const REACHES_S: [f64; 7] = [0.12, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0];
/// A mixture of two images has less detail than both: at most this share.
const DIP: f32 = 0.93;
/// Share of a frame, from its mean, that a mixture of the images at both ends explains.
const EXPLAINED: f32 = 0.8;
/// Steps of the share of the first image from quarter to quarter.
const FALL: f32 = 0.1;
/// A frame with less than this share of the other shot belongs to its own.
const PURE: f32 = 0.06;

/// Cuts a segment where one image dissolves into an unconnected one, and leaves the frames between
/// out.
pub(super) fn without_dissolves(
    clip: &Inspection<'_>,
    segment: Vec<usize>,
    out: &mut BTreeMap<usize, Reason>,
) -> Vec<Vec<usize>> {
    let mut rest = segment;
    let mut parts = Vec::new();
    while let Some(run) = dissolve(clip, &rest) {
        for &i in &rest[run.clone()] {
            out.insert(i, Reason::Dissolve);
        }
        let after = rest.split_off(run.end);
        rest.truncate(run.start);
        parts.push(rest);
        rest = after;
    }
    parts.push(rest);
    parts.retain(|part| !part.is_empty());
    parts
}

/// The frames of the first dissolve of a segment; it neither starts nor ends there.
fn dissolve(clip: &Inspection<'_>, segment: &[usize]) -> Option<Range<usize>> {
    let time = |k: usize| clip.times_s[segment[k]];
    let detail = |k: usize| clip.detail[segment[k]];
    let mut k = 0;
    while k < segment.len() {
        let mut best = None;
        for reach_s in REACHES_S {
            let before = (0..k).rev().find(|&j| time(k) - time(j) >= reach_s);
            let after = (k + 1..segment.len()).find(|&j| time(j) - time(k) >= reach_s);
            let (Some(a), Some(b)) = (before, after) else {
                break;
            };
            if b - a < 4 || detail(k) > DIP * detail(a).min(detail(b)) {
                continue;
            }
            if let Some(run) = mixture(clip, segment, [a, b]) {
                best = Some(run);
            }
        }
        if best.is_some() {
            return best;
        }
        k += 1;
    }
    None
}

/// The frames between `a` and `b` that mix both, if all between are explained by the two.
fn mixture(clip: &Inspection<'_>, segment: &[usize], [a, b]: [usize; 2]) -> Option<Range<usize>> {
    let image = |k: usize| coarse(&clip.images[segment[k]]);
    let (first, last) = (image(a), image(b));
    let quarters = [1, 2, 3].map(|q| (a * (4 - q) + b * q) / 4);
    let mut shares = Vec::new();
    for k in quarters {
        let (share, explained) = share_of(&image(k), &first, &last)?;
        if explained < EXPLAINED {
            return None;
        }
        shares.push(share);
    }
    if shares[0] - shares[1] < FALL || shares[1] - shares[2] < FALL {
        return None;
    }
    if clip.connected(segment[a], segment[b]) {
        return None;
    }
    let mixed: Vec<usize> = (a + 1..b)
        .filter(|&k| {
            share_of(&image(k), &first, &last)
                .is_some_and(|(share, _)| (PURE..=1.0 - PURE).contains(&share))
        })
        .collect();
    Some(*mixed.first()?..*mixed.last()? + 1)
}

/// The share of `first` in `image` as a mixture of both, and the share of its variance that the
/// mixture explains; `None` where the two are alike.
fn share_of(image: &Plane<f32>, first: &Plane<f32>, last: &Plane<f32>) -> Option<(f32, f32)> {
    let dot = |a: &Plane<f32>, b: &Plane<f32>| -> f32 {
        a.data().iter().zip(b.data()).map(|(a, b)| a * b).sum()
    };
    let (aa, ab, bb) = (dot(first, first), dot(first, last), dot(last, last));
    let (ia, ib, ii) = (dot(image, first), dot(image, last), dot(image, image));
    let determinant = aa * bb - ab * ab;
    if determinant <= 0.1 * aa * bb || ii <= 0.0 {
        return None;
    }
    let alpha = (ia * bb - ib * ab) / determinant;
    let beta = (ib * aa - ia * ab) / determinant;
    let explained = (alpha * ia + beta * ib) / ii;
    let total = alpha + beta;
    (total > 0.0).then_some((alpha / total, explained))
}
