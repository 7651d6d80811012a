//! Flow fields between frames: which pairs, which of their pixels count, and where they are kept.
//!
//! ```text
//! pair_list -> flow both ways (caller) -> halved -> consistency_mask -> PairStore
//! ```
//!
//! docs/spec/front-end.md 1.7. A million pixels of flow a second pass through here for every second of
//! video, so a stored pixel has four bytes, and what exceeds a byte budget goes to a temporary file.

mod store;

use m4_core::Flow;
pub use store::{CompactFlow, MASKED, PairStore};
pub(super) use store::{LANES, stride};

/// Distances of the frames of a pair. MegaSaM: 1, 2, 4, 8, 15.
pub const STEPS: [usize; 5] = [1, 2, 4, 8, 15];

/// A flow field from one frame to another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct FramePair {
    /// The frame that the flow starts in.
    pub source: usize,
    /// The frame that it leads to.
    pub target: usize,
}

/// Every pair of frames [`STEPS`] apart, forwards in time, by step and then by source: `5 n - 30` pairs from 15 frames
/// on. Steps as long as the clip or longer have no pairs.
#[must_use]
pub fn pair_list(frames: usize) -> Vec<FramePair> {
    let of_step = |step: usize| (step..frames).map(move |target| FramePair { source: target - step, target });
    STEPS.into_iter().flat_map(of_step).collect()
}

/// Greatest forward-backward error of a pixel that counts, pixels at the working size. MegaSaM: 1.
pub const MAX_ROUND_TRIP_PX: f32 = 1.0;

/// The flow on an image of half the size (rounded down): bilinear at pixel centres, clamped at the edges, values scaled along.
#[must_use]
pub fn halved(flow: &Flow) -> Flow {
    let (width, height) = ((flow.width / 2).max(1), (flow.height / 2).max(1));
    let (sx, sy) = (flow.width as f32 / width as f32, flow.height as f32 / height as f32);
    let mut out = Flow { width, height, u: Vec::with_capacity(width * height), v: Vec::with_capacity(width * height) };
    for row in 0..height {
        let y = ((row as f32 + 0.5) * sy - 0.5).clamp(0.0, (flow.height - 1) as f32);
        for column in 0..width {
            let x = ((column as f32 + 0.5) * sx - 0.5).clamp(0.0, (flow.width - 1) as f32);
            out.u.push(sample(flow.width, flow.height, &flow.u, x, y) / sx);
            out.v.push(sample(flow.width, flow.height, &flow.v, x, y) / sy);
        }
    }
    out
}

/// Bilinear value at `(x, y)` in pixel-centre coordinates; pixels outside are 0.
fn sample(width: usize, height: usize, plane: &[f32], x: f32, y: f32) -> f32 {
    // also where x or y is NaN
    if !(x > -1.0 && y > -1.0 && x < width as f32 && y < height as f32) {
        return 0.0;
    }
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let (x0, y0) = (x0 as isize, y0 as isize);
    let tap = |x: isize, y: isize| {
        let inside = x >= 0 && y >= 0 && x < width as isize && y < height as isize;
        if inside { plane[y as usize * width + x as usize] } else { 0.0 }
    };
    let top = tap(x0, y0) * (1.0 - fx) + tap(x0 + 1, y0) * fx;
    let bottom = tap(x0, y0 + 1) * (1.0 - fx) + tap(x0 + 1, y0 + 1) * fx;
    top * (1.0 - fy) + bottom * fy
}

/// `[height][width]`: how far a pixel lands from where it started after going there and back, pixels; the way back is 0
/// outside the frame. A flow that is not finite gives infinity.
#[must_use]
pub fn round_trip_px(there: &Flow, back: &Flow) -> Vec<f32> {
    let (w, h) = (there.width, there.height);
    let mut out = Vec::with_capacity(w * h);
    for i in 0..w * h {
        let (u, v) = (there.u[i], there.v[i]);
        let (x, y) = ((i % w) as f32 + u, (i / w) as f32 + v);
        let error = (u + sample(back.width, back.height, &back.u, x, y))
            .hypot(v + sample(back.width, back.height, &back.v, x, y));
        out.push(if error.is_finite() { error } else { f32::INFINITY });
    }
    out
}

/// `[height][width]`: whether a pixel of `there` counts. It does if it returns to within [`MAX_ROUND_TRIP_PX`] and lands
/// inside the frame: a pixel that leaves meets a way back of 0, which a short way out would pass, and what is sampled
/// out there is no disparity.
#[must_use]
pub fn consistency_mask(there: &Flow, back: &Flow) -> Vec<bool> {
    let (w, h) = (there.width, there.height);
    let inside = |i: usize| {
        let (x, y) = ((i % w) as f32 + there.u[i], (i / w) as f32 + there.v[i]);
        x >= 0.0 && y >= 0.0 && x <= (w - 1) as f32 && y <= (h - 1) as f32
    };
    let errors = round_trip_px(there, back).into_iter().enumerate();
    errors.map(|(i, error)| error < MAX_ROUND_TRIP_PX && inside(i)).collect()
}

#[cfg(test)]
mod tests {
    use super::{FramePair, pair_list};

    #[test]
    fn a_long_clip_has_five_pairs_a_frame_less_thirty() {
        for n in [15, 16, 96, 1500] {
            assert_eq!(pair_list(n).len(), 5 * n - 30);
        }
        let pairs = pair_list(20);
        assert_eq!(pairs[0], FramePair { source: 0, target: 1 });
        assert_eq!(pairs[pairs.len() - 1], FramePair { source: 4, target: 19 });
        assert!(pairs.iter().all(|p| p.source < p.target && p.target < 20));
    }

    #[test]
    fn short_clips_have_fewer_pairs() {
        assert!(pair_list(0).is_empty() && pair_list(1).is_empty());
        assert_eq!(pair_list(2), [FramePair { source: 0, target: 1 }]);
        // 2 of step 1, 1 of step 2
        assert_eq!(pair_list(3).len(), 3);
        // 8 + 7 + 5 + 1
        assert_eq!(pair_list(9).len(), 21);
    }
}
