//! Depth in MegaSaM's files, and the values that mean unknown.

/// MegaSaM takes depth below this for unknown before it tracks.
const LEAST_DEPTH: f64 = 1e-2;
/// Least depth of the clipped form.
const LEAST_CLIPPED: f64 = 1e-3;
/// MegaSaM adds this to depth before it takes the inverse.
const DISPARITY_EPSILON: f64 = 1e-6;

/// How depth is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stored {
    /// As it is.
    Depth,
    /// Clipped, with unknown at the lower end.
    Clipped,
    /// As disparity.
    Disparity,
}

/// Depth of a stored number; 0 where unknown.
pub(super) fn depth(stored: Stored, value: f64) -> f32 {
    let (z, least) = match stored {
        Stored::Depth => (value, LEAST_DEPTH),
        // half rounds the bound to 1.00040e-3
        Stored::Clipped => (value, LEAST_CLIPPED * 1.001),
        Stored::Disparity => (1.0 / value - DISPARITY_EPSILON, LEAST_DEPTH),
    };
    // `z < least` would let NaN pass; the inverse of a tiny disparity is finite, but not as 32 bits
    let known = z >= least && (z as f32).is_finite();
    if known { z as f32 } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::{Stored, depth};

    #[test]
    fn unknown_depth_stays_unknown() {
        for stored in [Stored::Depth, Stored::Clipped] {
            assert_eq!(depth(stored, 3.25), 3.25);
        }
        assert!((depth(Stored::Disparity, 1.0 / 3.25) - 3.25).abs() < 1e-5);
        // what numpy's clip of MegaSaM leaves of NaN and of infinity
        assert_eq!(depth(Stored::Clipped, f64::NAN), 0.0);
        assert_eq!(depth(Stored::Clipped, 1e-3), 0.0);
        assert_eq!(depth(Stored::Clipped, 100.0), 100.0);
        assert_eq!(depth(Stored::Disparity, 0.0), 0.0);
        assert_eq!(depth(Stored::Disparity, 1e-40), 0.0);
        assert_eq!(depth(Stored::Depth, 1e300), 0.0);
        assert_eq!(depth(Stored::Depth, 1e-6), 0.0);
    }
}
