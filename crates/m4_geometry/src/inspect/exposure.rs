//! Brightness of the frames of a shot.

use super::quantile;
use super::timeline::Shown;

/// How the brightness of a clip changes, as logarithms of factors of pixel values.
#[derive(Debug, Clone, PartialEq)]
pub struct Exposure {
    /// Of each frame, from its surroundings of half a second.
    pub flicker: Vec<f32>,
    /// From the darkest to the brightest stretch of half a second.
    pub drift: f32,
}

/// Flicker is what is left of a frame after the median over this time, seconds.
const AROUND_S: f64 = 0.25;
/// Flicker of most frames that is worth a word.
const MIN_FLICKER: f32 = 0.025;
/// A drift that is worth a word: more than the sum of errors from frame to frame.
const MIN_DRIFT: f32 = 0.3;

impl Exposure {
    /// Of the frames of a shot.
    #[must_use]
    pub fn of(frames: &[Shown]) -> Self {
        let slow: Vec<f32> = frames
            .iter()
            .map(|frame| {
                let around: Vec<f32> = frames
                    .iter()
                    .filter(|other| (other.time_s - frame.time_s).abs() <= AROUND_S)
                    .map(|other| other.log_gain)
                    .collect();
                quantile(&around, 0.5)
            })
            .collect();
        let flicker = frames.iter().zip(&slow).map(|(f, slow)| f.log_gain - slow);
        let most = slow.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let least = slow.iter().copied().fold(f32::INFINITY, f32::min);
        Self {
            flicker: flicker.collect(),
            drift: (most - least).max(0.0),
        }
    }

    /// The flicker that a third of the frames exceeds, where it is more than noise.
    #[must_use]
    pub fn flickers(&self) -> Option<f32> {
        let sizes: Vec<f32> = self.flicker.iter().map(|v| v.abs()).collect();
        Some(quantile(&sizes, 2.0 / 3.0)).filter(|&v| v >= MIN_FLICKER)
    }

    /// The drift, where it is more than a matter of measurement.
    #[must_use]
    pub fn drifts(&self) -> Option<f32> {
        Some(self.drift).filter(|&v| v >= MIN_DRIFT)
    }
}
