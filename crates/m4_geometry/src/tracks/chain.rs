//! Points followed along the flow, frame by frame.

use super::Strip;
use super::grid::nearest;

/// A point in consecutive frames.
#[derive(Debug, Clone)]
pub(crate) struct Chain {
    pub first: usize,
    /// Pixel coordinates in frames `first..`.
    pub seen: Vec<[f32; 2]>,
}

/// The chain through `at` of frame `start`, as far as it goes both ways.
pub(crate) fn chain(strip: &Strip, start: usize, at: [f32; 2]) -> Chain {
    let mut seen = one_way(strip, start, at, false);
    let first = start - seen.len();
    seen.reverse();
    seen.push(at);
    seen.extend(one_way(strip, start, at, true));
    Chain { first, seen }
}

/// Where the point at `at` of frame `start` is in the frames after it, or before, as far as it can be followed.
pub(super) fn one_way(strip: &Strip, start: usize, at: [f32; 2], forward: bool) -> Vec<[f32; 2]> {
    let mut out = Vec::new();
    let (mut frame, mut at) = (start, at);
    while let Some((next, to)) = step(strip, frame, at, forward) {
        out.push(to);
        (frame, at) = (next, to);
    }
    out
}

/// Where a point is one frame on, or back.
fn step(strip: &Strip, frame: usize, at: [f32; 2], forward: bool) -> Option<(usize, [f32; 2])> {
    let next = if forward { frame + 1 } else { frame.checked_sub(1)? };
    let [u, v] = flow_of_part(strip, frame, at, forward)?;
    let to = [at[0] + u, at[1] + v];
    let (x, y) = nearest(to);
    (is_inside(strip, to) && strip.moving.get(next)?.get(x, y).is_some()).then_some((next, to))
}

/// Whether a place is in the image.
pub(super) fn is_inside(strip: &Strip, at: [f32; 2]) -> bool {
    at[0] > -0.5 && at[1] > -0.5 && at[0] < strip.width as f32 - 0.5 && at[1] < strip.height as f32 - 0.5
}

/// Bilinear flow of those of the four pixels around that move and lead back; none if the nearest does not.
fn flow_of_part(strip: &Strip, frame: usize, at: [f32; 2], forward: bool) -> Option<[f32; 2]> {
    let flow = if forward {
        strip.forward.get(frame)?
    } else {
        strip.backward.get(frame.checked_sub(1)?)?
    };
    let (x, y) = nearest(at);
    flow.get(x, y)?;
    let (left, top) = (at[0].floor(), at[1].floor());
    let (fx, fy) = (at[0] - left, at[1] - top);
    let (mut u, mut v, mut total) = (0.0, 0.0, 0.0);
    for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let (px, py) = (left + dx, top + dy);
        if px < 0.0 || py < 0.0 {
            continue;
        }
        if let Some([to_right, down]) = flow.get(px as usize, py as usize) {
            let weight = (1.0 - (fx - dx).abs()) * (1.0 - (fy - dy).abs());
            u += weight * to_right;
            v += weight * down;
            total += weight;
        }
    }
    (total > 0.0).then(|| [u / total, v / total])
}
