//! Depth: what MegaSaM takes for unknown, and how it is written.

use half::f16;

/// MegaSaM takes depth below this for unknown before it tracks.
pub(super) const LEAST_DEPTH: f64 = 1e-2;
/// Least and largest depth of the clipped form.
pub(super) const CLIP: (f64, f64) = (1e-3, 1e2);
/// MegaSaM adds this to depth before it takes the inverse.
pub(super) const DISPARITY_EPSILON: f64 = 1e-6;

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
        Stored::Clipped => (value, CLIP.0 * 1.001),
        Stored::Disparity => (1.0 / value - DISPARITY_EPSILON, LEAST_DEPTH),
    };
    // `z < least` would let what is no number pass; the inverse of a tiny disparity is finite, but not as 32 bits
    let known = z >= least && (z as f32).is_finite();
    if known { z as f32 } else { 0.0 }
}

/// The bytes of a depth, 0 where unknown, as MegaSaM stores it.
pub(super) fn write(stored: Stored, z: f32, out: &mut Vec<u8>) {
    let z = if z.is_finite() && z > 0.0 { f64::from(z) } else { 0.0 };
    match stored {
        // what MegaSaM's 1 / (1 / (0 + epsilon)) makes of unknown
        Stored::Depth => out.extend((z.max(DISPARITY_EPSILON) as f32).to_le_bytes()),
        Stored::Clipped => out.extend(f16::from_f64(z.clamp(CLIP.0, CLIP.1)).to_le_bytes()),
        Stored::Disparity => out.extend(((1.0 / (z + DISPARITY_EPSILON)) as f32).to_le_bytes()),
    }
}

#[cfg(test)]
mod tests {
    use super::{Stored, depth, write};

    #[test]
    fn depth_comes_back_and_unknown_stays_unknown() {
        let read = |stored, bytes: &[u8]| match stored {
            Stored::Clipped => half::f16::from_le_bytes([bytes[0], bytes[1]]).to_f64(),
            _ => f64::from(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
        };
        for (stored, within) in [(Stored::Depth, 0.0), (Stored::Clipped, 5e-4), (Stored::Disparity, 2e-5)] {
            for z in [0.0, f32::NAN, -1.0, f32::INFINITY, 0.011, 0.5, 3.25, 99.0] {
                let mut bytes = Vec::new();
                write(stored, z, &mut bytes);
                let got = depth(stored, read(stored, &bytes));
                let expected = if z.is_finite() && z > 0.0 { z } else { 0.0 };
                assert!(
                    (got - expected).abs() <= within * expected,
                    "{stored:?}: {z} became {got}"
                );
            }
        }
        // what numpy's clip of MegaSaM leaves of no number and of infinity
        assert_eq!(depth(Stored::Clipped, f64::NAN), 0.0);
        assert_eq!(depth(Stored::Clipped, 100.0), 100.0);
        assert_eq!(depth(Stored::Disparity, 0.0), 0.0);
        assert_eq!(depth(Stored::Disparity, 1e-40), 0.0);
        assert_eq!(depth(Stored::Depth, 1e300), 0.0);
        assert_eq!(depth(Stored::Depth, 1e-6), 0.0);
    }
}
