//! Robust weights: what a residual counts for.

use m4_core::Real;

/// A weight that falls with the length of the residual (iteratively reweighted least squares).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Robust {
    /// Every residual counts in full: the published solver, whose confidences come from a network.
    #[default]
    None,
    /// `1 / (1 + s^2)`, `s` being the length of the residual over the scale.
    Cauchy {
        /// Pixels of the grid.
        scale_px: f64,
    },
    /// `1 / (1 + s^2)^2`: what is far off counts for nothing.
    GemanMcClure {
        /// Pixels of the grid.
        scale_px: f64,
    },
}

impl Robust {
    /// The factor for a residual of squared length `squared_px2`, in (0, 1].
    #[must_use]
    pub fn weight<T: Real>(self, squared_px2: T) -> T {
        let (inverse, power) = self.constants();
        let w = T::one() / (T::one() + squared_px2 * T::of(inverse));
        if power == 2 { w * w } else { w }
    }

    /// `(1 / scale^2, exponent)`: the weight is `(1 + s^2)^-exponent`. With [`Robust::None`] the first is 0, which
    /// makes the weight 1 exactly.
    pub(crate) fn constants(self) -> (f64, u32) {
        match self {
            Self::None => (0.0, 1),
            Self::Cauchy { scale_px } => (1.0 / (scale_px * scale_px), 1),
            Self::GemanMcClure { scale_px } => (1.0 / (scale_px * scale_px), 2),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Robust;

    #[test]
    fn weights_fall_with_the_residual() {
        assert_eq!(Robust::None.weight(100.0_f32), 1.0);
        assert_eq!(Robust::Cauchy { scale_px: 2.0 }.weight(4.0_f64), 0.5);
        assert_eq!(Robust::GemanMcClure { scale_px: 2.0 }.weight(4.0_f64), 0.25);
    }
}
