//! The moment to freeze: where the moving parts are sharpest.

use m4_scene::{Capture, CaptureFrame};

/// Index of the frame with the greatest mean squared brightness gradient over what moves (over
/// everything where nothing does), away from the ends of the clip, where the scene is seen least.
pub(super) fn sharpest(capture: &Capture) -> usize {
    let n = capture.frames.len();
    let margin = n / 5;
    let inner = margin..n - margin;
    let score = |i: usize| sharpness(&capture.frames[i]);
    inner
        .map(|i| (score(i), i))
        .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))
        .map_or(0, |(_, i)| i)
}

fn sharpness(frame: &CaptureFrame) -> f64 {
    let (w, h) = frame.rgb.size();
    let brightness = |x: usize, y: usize| frame.rgb[(x, y)].iter().map(|&c| f64::from(c)).sum::<f64>();
    let moving = |x: usize, y: usize| {
        frame.mask.as_ref().is_none_or(|m| {
            let at = (x * m.width() / w, y * m.height() / h);
            m[at] != 0
        })
    };
    let (mut sum, mut count) = (0.0, 0usize);
    for y in (0..h.saturating_sub(1)).step_by(2) {
        for x in (0..w.saturating_sub(1)).step_by(2) {
            if moving(x, y) {
                let here = brightness(x, y);
                sum += (brightness(x + 1, y) - here).powi(2) + (brightness(x, y + 1) - here).powi(2);
                count += 1;
            }
        }
    }
    // A handful of moving pixels says nothing about the moment.
    if count * 200 < (w * h) / 4 {
        0.0
    } else {
        sum / count as f64
    }
}

#[cfg(test)]
mod tests {
    use super::sharpest;
    use m4_math::Se3;
    use m4_scene::{Camera, Capture, CaptureFrame, Intrinsics, Plane};

    #[test]
    fn the_frame_with_most_detail_where_it_moves_wins() {
        let frame = |i: usize| CaptureFrame {
            name: i.to_string(),
            camera: Camera {
                intrinsics: Intrinsics::centred(32, 24, 30.0),
                c2w: Se3::identity(),
            },
            t: i as f64,
            // Stripes to the left in frame 6, stronger ones to the right, where nothing moves, in frame 4.
            rgb: Plane::from_fn(32, 24, |x, _| {
                let striped = if i == 6 { x < 16 } else { i == 4 && x >= 16 };
                let strength = if i == 6 { 100 } else { 255 };
                [if striped && x % 2 == 0 { strength } else { 0 }; 3]
            }),
            depth: None,
            mask: Some(Plane::from_fn(32, 24, |x, _| if x < 16 { 255 } else { 0 })),
            camera_index: None,
        };
        let capture = Capture {
            frames: (0..10).map(frame).collect(),
            time_frames: 10,
            duration_s: None,
            metric: false,
        };
        assert_eq!(sharpest(&capture), 6);
    }
}
