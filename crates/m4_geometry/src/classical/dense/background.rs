//! The usual colour of each pixel of a static camera.

use super::motion::{STATIC_VOTE, THRESHOLD};
use super::working::WorkingFrame;

/// Frames the background is the median of, spread over the clip.
const SAMPLES: usize = 25;
/// Least noise of a pixel, 0..255.
const NOISE: f32 = 4.0;

/// The usual colour of every pixel, `[height][width]`.
pub(super) struct Background {
    rgb: Vec<[u8; 3]>,
}

impl Background {
    /// Median over time, channel by channel. `frames` must not be empty.
    pub fn new(frames: &[WorkingFrame]) -> Self {
        let count = SAMPLES.min(frames.len());
        let chosen: Vec<&WorkingFrame> = (0..count).map(|k| &frames[k * frames.len() / count]).collect();
        let mut values = vec![0u8; count];
        let rgb = (0..frames[0].rgb.len())
            .map(|i| {
                std::array::from_fn(|c| {
                    for (v, frame) in values.iter_mut().zip(&chosen) {
                        *v = frame.rgb[i][c];
                    }
                    *values.select_nth_unstable(count / 2).1
                })
            })
            .collect();
        Self { rgb }
    }

    /// Evidence of motion a pixel, as that of the flow: the difference to the most similar background
    /// pixel nearby (a tripod shakes, too) in units of the noise.
    pub fn evidence(&self, frame: &WorkingFrame) -> Vec<f32> {
        let (w, h) = (frame.width, frame.height);
        let difference = |a: [u8; 3], b: [u8; 3]| a.iter().zip(&b).map(|(a, b)| a.abs_diff(*b)).fold(0, u8::max);
        let mut out: Vec<f32> = vec![0.0; w * h];
        for y in 0..h {
            for x in 0..w {
                let mut least = u8::MAX;
                for ny in y.saturating_sub(1)..(y + 2).min(h) {
                    for nx in x.saturating_sub(1)..(x + 2).min(w) {
                        least = least.min(difference(frame.rgb[y * w + x], self.rgb[ny * w + nx]));
                    }
                }
                out[y * w + x] = f32::from(least);
            }
        }
        let mut sorted = out.clone();
        let median = m4_core::quantile(&mut sorted, 0.5).unwrap_or(0.0);
        let noise = NOISE.max(2.0 * median);
        for v in &mut out {
            *v = (0.5 * (*v / noise - THRESHOLD)).clamp(-STATIC_VOTE, 1.0);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::Background;
    use crate::classical::dense::working::WorkingFrame;
    use m4_core::{Camera, Intrinsics, Plane, Se3};

    #[test]
    fn passing_objects_differ_from_the_background() {
        let camera = Camera { intrinsics: Intrinsics::centred(40, 32, 50.0), c2w: Se3::identity() };
        let frame = |k: usize| {
            let image = Plane::from_fn(40, 32, |x, y| {
                if (3 * k..3 * k + 4).contains(&x) && (10..20).contains(&y) { [250; 3] } else { [(x * 3) as u8; 3] }
            });
            WorkingFrame::new(&image, &camera, 40, 32)
        };
        let frames: Vec<WorkingFrame> = (0..11).map(frame).collect();
        let evidence = Background::new(&frames).evidence(&frames[5]);
        for (i, e) in evidence.iter().enumerate() {
            let (x, y) = (i % 40, i / 40);
            let inside = (15..19).contains(&x) && (10..20).contains(&y);
            assert_eq!(*e > 0.0, inside, "{x}, {y}: {e}");
        }
    }
}
