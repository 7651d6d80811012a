//! Chooses the time to freeze: the frame in which dynamic regions are sharpest.

use m4_core::{Capture, CaptureFrame};

/// Stride of the sampled pixels, columns and rows.
const STEP: usize = 2;

/// Area and sharpness of the dynamic regions of a frame.
#[derive(Debug, Clone, Copy)]
struct RegionDetail {
    /// Pixels of the dynamic regions; all where there is no mask.
    count: usize,
    /// Mean squared brightness gradient over them.
    sharpness: f64,
}

/// Index of the frame in which the dynamic regions are sharpest (everything, where nothing moves). It is
/// one that shows at least three quarters of what the middle frame by that measure shows, away from
/// the ends of the clip, where the scene is seen least.
pub(super) fn sharpest(capture: &Capture) -> usize {
    let n = capture.frames.len();
    let inner: Vec<usize> = (n / 5..n - n / 5).collect();
    let all = looks(capture, &inner, true);
    let moves = all.iter().any(|look| look.count > 0);
    let looks = if moves { all } else { looks(capture, &inner, false) };
    let mut counts: Vec<usize> = looks.iter().map(|look| look.count).collect();
    counts.sort_unstable();
    let enough = counts.get(counts.len() / 2).map_or(0, |median| median * 3 / 4);
    let candidates = inner.iter().zip(&looks).filter(|(_, look)| look.count >= enough);
    // The first of equals: the choice must not depend on chance.
    let best = candidates.max_by(|(i, a), (j, b)| a.sharpness.total_cmp(&b.sharpness).then(j.cmp(i)));
    best.map_or(0, |(&i, _)| i)
}

fn looks(capture: &Capture, frames: &[usize], masked: bool) -> Vec<RegionDetail> {
    frames.iter().map(|&i| look(&capture.frames[i], masked)).collect()
}

fn look(frame: &CaptureFrame, masked: bool) -> RegionDetail {
    let (w, h) = frame.rgb.size();
    let brightness = |x: usize, y: usize| frame.rgb[(x, y)].iter().map(|&c| f64::from(c)).sum::<f64>();
    let counts = |x: usize, y: usize| match frame.mask.as_ref().filter(|_| masked) {
        Some(mask) => mask.at(x * mask.size().0 / w, y * mask.size().1 / h),
        None => true,
    };
    let (mut sum, mut count) = (0.0, 0usize);
    for y in (0..h.saturating_sub(1)).step_by(STEP) {
        for x in (0..w.saturating_sub(1)).step_by(STEP) {
            if counts(x, y) {
                let here = brightness(x, y);
                sum += (brightness(x + 1, y) - here).powi(2) + (brightness(x, y + 1) - here).powi(2);
                count += 1;
            }
        }
    }
    let sharpness = sum / count.max(1) as f64;
    RegionDetail { count, sharpness }
}

#[cfg(test)]
mod tests {
    use super::sharpest;
    use m4_core::{Camera, Capture, CaptureFrame, CompactMask, Intrinsics, Plane, Se3};

    #[test]
    fn frame_with_most_dynamic_detail_wins() {
        let frame = |i: usize| CaptureFrame {
            name: i.to_string(),
            camera: Camera {
                intrinsics: Intrinsics::centred(32, 24, 30.0),
                c2w: Se3::identity(),
            },
            t: i as f64,
            // Stripes to the left in frame 6; stronger ones to the right, where nothing moves, in frame 4; and
            // in frame 3, where next to nothing is masked.
            rgb: Plane::from_fn(32, 24, |x, _| {
                let striped = if i == 6 { x < 16 } else { i == 3 || i == 4 && x >= 16 };
                let strength = if i == 6 { 100 } else { 255 };
                [if striped && x % 2 == 0 { strength } else { 0 }; 3]
            }),
            depth: None,
            mask: Some(CompactMask::from_fn(32, 24, |x, _| x < if i == 3 { 2 } else { 16 })),
            motion: None,
            instances: None,
            camera_index: None,
        };
        let capture = Capture {
            frames: (0..10).map(frame).collect(),
            time_frames: 10,
            duration_s: None,
            metric: false,
            tracks: None,
        };
        assert_eq!(sharpest(&capture), 6);
    }
}
