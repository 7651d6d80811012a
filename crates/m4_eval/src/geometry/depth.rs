//! Scores depth after one scale factor, and masks.

use super::report::{DepthError, MaskScore, median_of_sorted};
use m4_core::{CaptureFrame, CompactMask};

/// Pixels used for the common factor and for the error: every one of these columns and rows.
const STRIDE_PX: usize = 2;

/// Error sums of one region.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    abs_rel: f64,
    within: usize,
    count: usize,
    truth: usize,
}

impl Sum {
    /// Counts a pixel of the truth `z`; `e` is 0 where the estimate has no depth.
    fn add(&mut self, e: f64, z: f64) {
        self.truth += 1;
        if e > 0.0 {
            self.count += 1;
            self.abs_rel += (e - z).abs() / z;
            self.within += usize::from((e / z).max(z / e) < 1.25);
        }
    }

    fn score(&self) -> Option<(f64, f64, f64)> {
        let share = |part: usize, whole: usize| part as f64 / whole as f64;
        (self.count > 0).then(|| {
            (
                self.abs_rel / self.count as f64,
                share(self.within, self.count),
                share(self.count, self.truth),
            )
        })
    }
}

pub(super) fn usable(z: f32) -> bool {
    z.is_finite() && z > 0.0
}

/// The pixel of a plane of size `to` that covers the centre of pixel `(x, y)` of one of size
/// `from`.
pub(super) fn covering(
    (x, y): (usize, usize),
    from: (usize, usize),
    to: (usize, usize),
) -> Option<(usize, usize)> {
    let at = |i: usize, n: usize, m: usize| (2 * i + 1) * m / (2 * n);
    let (x, y) = (at(x, from.0, to.0), at(y, from.1, to.1));
    (x < to.0 && y < to.1).then_some((x, y))
}

/// Whether a mask of any size is set at pixel `at` of `size`.
pub(super) fn is_set(mask: &CompactMask, at: (usize, usize), size: (usize, usize)) -> bool {
    covering(at, size, mask.size()).is_some_and(|(x, y)| mask.at(x, y))
}

/// Where a pixel of the truth lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Region {
    Static,
    /// Static, but in the mask of the estimate, where depth is that of a dynamic object.
    StaticInMask,
    Dynamic,
}

/// Visits `(estimate, truth, region)` wherever the truth knows a depth.
fn visit((estimate, truth): (&CaptureFrame, &CaptureFrame), mut f: impl FnMut(f64, f64, Region)) {
    let masks = [&truth.mask, &estimate.mask];
    let Some((estimate, truth)) = estimate.depth.as_ref().zip(truth.depth.as_ref()) else {
        return;
    };
    let size = truth.size();
    for y in (0..size.1).step_by(STRIDE_PX) {
        for x in (0..size.0).step_by(STRIDE_PX) {
            let z = truth.at(x, y);
            if usable(z) {
                let region = match masks
                    .map(|mask| mask.as_ref().is_some_and(|m| is_set(m, (x, y), size)))
                {
                    [true, _] => Region::Dynamic,
                    [false, true] => Region::StaticInMask,
                    [false, false] => Region::Static,
                };
                let e = covering((x, y), size, estimate.size())
                    .map(|(x, y)| estimate.at(x, y))
                    .filter(|&e| usable(e))
                    .unwrap_or(0.0);
                f(f64::from(e), f64::from(z), region);
            }
        }
    }
}

/// `None` if no pair of frames has depth on both sides.
pub(super) fn depth_error(pairs: &[(&CaptureFrame, &CaptureFrame)]) -> Option<DepthError> {
    let pairs: Vec<_> = pairs
        .iter()
        .copied()
        .filter(|(e, t)| e.depth.is_some() && t.depth.is_some())
        .collect();
    let mut ratios: Vec<f64> = Vec::new();
    let mut any = Vec::new();
    for &pair in &pairs {
        visit(pair, |e, z, region| {
            if e > 0.0 {
                (if region == Region::Dynamic {
                    &mut any
                } else {
                    &mut ratios
                })
                .push(z / e);
            }
        });
    }
    if ratios.is_empty() {
        ratios = any;
    }
    if ratios.is_empty() {
        return None;
    }
    ratios.sort_by(f64::total_cmp);
    let scale = median_of_sorted(&ratios);
    let [mut outside, mut fixed, mut dynamic] = [Sum::default(); 3];
    for &pair in &pairs {
        visit(pair, |e, z, region| match region {
            Region::Static => {
                outside.add(scale * e, z);
                fixed.add(scale * e, z);
            }
            Region::StaticInMask => fixed.add(scale * e, z),
            Region::Dynamic => dynamic.add(scale * e, z),
        });
    }
    let [outside, fixed, dynamic] = [outside, fixed, dynamic].map(|s| s.score());
    Some(DepthError {
        frames: pairs.len(),
        scale,
        static_abs_rel: fixed.map(|s| s.0),
        static_outside_masks_abs_rel: outside.map(|s| s.0),
        static_within_25_percent: fixed.map(|s| s.1),
        static_coverage: fixed.map(|s| s.2),
        moving_abs_rel: dynamic.map(|s| s.0),
        moving_within_25_percent: dynamic.map(|s| s.1),
        moving_coverage: dynamic.map(|s| s.2),
    })
}

/// `None` if no pair of frames has masks on both sides.
pub(super) fn mask_score(pairs: &[(&CaptureFrame, &CaptureFrame)]) -> Option<MaskScore> {
    let (mut both, mut estimated, mut truth, mut frames) = (0usize, 0usize, 0usize, 0usize);
    let mut per_frame = Vec::new();
    for (e, t) in pairs {
        let (Some(e), Some(t)) = (&e.mask, &t.mask) else {
            continue;
        };
        let (mut b, mut n_e, mut n_t) = (0usize, 0usize, 0usize);
        for y in 0..t.size().1 {
            for x in 0..t.size().0 {
                let dynamic = t.at(x, y);
                let in_estimate = is_set(e, (x, y), t.size());
                b += usize::from(dynamic && in_estimate);
                n_e += usize::from(in_estimate);
                n_t += usize::from(dynamic);
            }
        }
        frames += 1;
        both += b;
        estimated += n_e;
        truth += n_t;
        if n_e + n_t > b {
            per_frame.push(b as f64 / (n_e + n_t - b) as f64);
        } else {
            per_frame.push(1.0);
        }
    }
    if frames == 0 {
        return None;
    }
    let share = |part: usize, whole: usize| {
        if whole == 0 {
            1.0
        } else {
            part as f64 / whole as f64
        }
    };
    Some(MaskScore {
        frames,
        iou: share(both, estimated + truth - both),
        mean_frame_iou: per_frame.iter().sum::<f64>() / frames as f64,
        precision: share(both, estimated),
        recall: share(both, truth),
    })
}
