//! What one cue says about the scale of a part.

use m4_core::quantile;

/// Median absolute deviations in a standard deviation.
const DEVIATIONS: f64 = 1.48;

/// A scale, and how sure it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Vote {
    /// Factor on disparities.
    pub factor: f64,
    /// Standard deviation of its logarithm.
    pub sigma: f64,
}

impl Vote {
    /// The median of what frames say; their spread adds to the deviation `sigma` that they have in
    /// common.
    pub fn of_frames(factors: &mut [f32], sigma: f64) -> Option<Self> {
        let factor = f64::from(quantile(factors, 0.5)?);
        let mut off: Vec<f64> = factors
            .iter()
            .map(|f| (f64::from(*f) / factor).ln().abs())
            .collect();
        let spread = DEVIATIONS * quantile(&mut off, 0.5)?;
        Some(Self {
            factor,
            sigma: sigma.hypot(spread),
        })
    }

    /// The mean of two that agree to within a deviation of their difference, by precision.
    pub fn agreed(self, other: Self) -> Option<Self> {
        let difference = (self.factor / other.factor).ln().abs();
        let [a, b] = [self, other].map(|vote| vote.sigma.powi(-2));
        let mean = (a * self.factor.ln() + b * other.factor.ln()) / (a + b);
        (difference < self.sigma.hypot(other.sigma)).then(|| Self {
            factor: mean.exp(),
            sigma: (a + b).sqrt().recip(),
        })
    }
}
