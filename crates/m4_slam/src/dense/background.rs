//! What a camera that stands still sees most of the time.

use super::config::MotionConfig;
use super::working::WorkingFrame;

/// Frames the background is the median of, spread over the clip.
const SAMPLES: usize = 25;
/// Least noise of a pixel, 0..255.
const NOISE: f32 = 4.0;

/// The usual colour of every pixel, `[height][width]`.
pub(super) struct Background {
    rgb: Vec<[f32; 3]>,
}

impl Background {
    /// Median over time, channel by channel. `frames` must not be empty.
    pub fn new(frames: &[WorkingFrame]) -> Self {
        let count = SAMPLES.min(frames.len());
        let chosen: Vec<&WorkingFrame> = (0..count).map(|k| &frames[k * frames.len() / count]).collect();
        let mut values = vec![0.0f32; count];
        let rgb = (0..frames[0].rgb.len())
            .map(|i| {
                std::array::from_fn(|c| {
                    for (v, frame) in values.iter_mut().zip(&chosen) {
                        *v = frame.rgb[i][c];
                    }
                    *values.select_nth_unstable_by(count / 2, f32::total_cmp).1
                })
            })
            .collect();
        Self { rgb }
    }

    /// Evidence of motion a pixel, as that of the flow: the difference to the most similar background
    /// pixel nearby (a tripod shakes, too) in units of the noise.
    pub fn evidence(&self, frame: &WorkingFrame, config: &MotionConfig) -> Vec<f32> {
        let (w, h) = (frame.width, frame.height);
        let difference = |a: [f32; 3], b: [f32; 3]| a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        let mut out: Vec<f32> = vec![0.0; w * h];
        for y in 0..h {
            for x in 0..w {
                let mut least = f32::INFINITY;
                for ny in y.saturating_sub(1)..(y + 2).min(h) {
                    for nx in x.saturating_sub(1)..(x + 2).min(w) {
                        least = least.min(difference(frame.rgb[y * w + x], self.rgb[ny * w + nx]));
                    }
                }
                out[y * w + x] = least;
            }
        }
        let mut sorted = out.clone();
        let median = super::shot::quantile(&mut sorted, 0.5).unwrap_or(0.0);
        let noise = NOISE.max(2.0 * median);
        for v in &mut out {
            *v = (0.5 * (*v / noise - config.threshold)).clamp(-config.static_vote, 1.0);
        }
        out
    }
}
