//! Points followed along the flow, frame by frame, and brought into the world with the depth under them.

use super::TrackConfig;
use super::clip::Strip;
use super::grid::nearest;
use m4_core::quantile;

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
    let flow = if forward { strip.forward.get(frame)? } else { strip.backward.get(frame.checked_sub(1)?)? };
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

/// Fewest frames of a track.
pub(super) const SHORTEST: usize = 4;
/// A track is cut at a step longer than this many times its median step.
const JUMP: f32 = 5.0;
/// A step shorter than this is none that could be a jump, pixels.
const SMALL_STEP_PX: f64 = 3.0;

/// A point in the world, in consecutive frames.
#[derive(Debug, Clone)]
pub(crate) struct Lifted {
    pub first: usize,
    pub places: Vec<[f32; 3]>,
}

/// The pieces of a chain between jumps, in the world.
pub(crate) fn lift(strip: &Strip, chain: &Chain, config: &TrackConfig) -> Vec<Lifted> {
    let frames = || (chain.first..).zip(&chain.seen);
    let raw: Vec<f32> = frames().map(|(frame, at)| around(strip, frame, *at)).collect();
    let place = |frame: usize, at: &[f32; 2], disparity: f32| {
        strip.cameras[frame].unproject(f64::from(at[0]), f64::from(at[1]), 1.0 / f64::from(disparity))
    };
    let places: Vec<_> = frames().zip(&raw).map(|((frame, at), d)| place(frame, at, *d)).collect();
    let steps: Vec<f32> = places.windows(2).map(|p| (p[1] - p[0]).norm() as f32).collect();
    let median = quantile(&mut steps.clone(), 0.5).unwrap_or(0.0);
    let jumps = |k: usize| {
        let small = SMALL_STEP_PX / (f64::from(raw[k]) * strip.cameras[chain.first + k].intrinsics.fx);
        !steps[k].is_finite() || steps[k] > JUMP * median + small as f32
    };
    let mut out = Vec::new();
    let mut from = 0;
    for to in 1..=raw.len() {
        if to < raw.len() && !jumps(to - 1) {
            continue;
        }
        if to - from >= SHORTEST {
            let depth = smooth(&raw[from..to], config.smooth_frames);
            let piece = (chain.first + from..).zip(&chain.seen[from..to]).zip(&depth);
            let places: Vec<[f32; 3]> = piece
                .map(|((frame, at), d)| place(frame, at, *d))
                .map(|p| [p.x as f32, p.y as f32, p.z as f32])
                .collect();
            if places.as_flattened().iter().all(|v| v.is_finite()) {
                let first = chain.first + from;
                out.push(Lifted { first, places });
            }
        }
        from = to;
    }
    out
}

/// Median disparity of the moving ones of 3x3 pixels: what leans over the edge of a mask does not count.
pub(super) fn around(strip: &Strip, frame: usize, at: [f32; 2]) -> f32 {
    let (x, y) = nearest(at);
    let rows = y.saturating_sub(1)..(y + 2).min(strip.height);
    let pixels = rows.flat_map(|y| (x.saturating_sub(1)..(x + 2).min(strip.width)).map(move |x| (x, y)));
    let mut values: Vec<f32> = pixels.filter_map(|(x, y)| strip.moving[frame].get(x, y)).collect();
    quantile(&mut values, 0.5).unwrap_or(f32::NAN)
}

/// Disparity along a track, its logarithm smoothed by lines through the frames around each (weights of standard deviation
/// `sd` frames), so that what comes nearer steadily is not held back at the ends.
pub(crate) fn smooth(disparity: &[f32], sd: f32) -> Vec<f32> {
    if sd <= 0.0 {
        return disparity.to_vec();
    }
    let logs: Vec<f64> = disparity.iter().map(|d| f64::from(*d).ln()).collect();
    let reach = (3.0 * sd).ceil() as usize;
    (0..logs.len())
        .map(|i| {
            let (mut s, mut st, mut stt, mut sy, mut sty) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for j in i.saturating_sub(reach)..(i + reach + 1).min(logs.len()) {
                let t = j as f64 - i as f64;
                let w = (-0.5 * (t / f64::from(sd)).powi(2)).exp();
                s += w;
                st += w * t;
                stt += w * t * t;
                sy += w * logs[j];
                sty += w * t * logs[j];
            }
            let determinant = s * stt - st * st;
            let at_0 = if determinant > 1e-12 { (stt * sy - st * sty) / determinant } else { sy / s };
            at_0.exp() as f32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::smooth;

    #[test]
    fn a_steady_approach_is_not_held_back_at_the_ends() {
        let steady: Vec<f32> = (0..9).map(|t| 0.5 * 1.1f32.powi(t)).collect();
        for (got, want) in smooth(&steady, 2.0).iter().zip(&steady) {
            assert!((got / want - 1.0).abs() < 1e-5, "{got} {want}");
        }
        assert_eq!(smooth(&[0.5], 2.0), [0.5]);
    }
}
