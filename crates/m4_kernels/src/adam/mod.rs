//! Adam (Kingma and Ba 2015) on the rows that a frame touched (docs/spec/optimiser.md 3).
//!
//! ```text
//! count += 1                                    once a splat, not once a column
//! m = beta1 m + (1 - beta1) g,  v = beta2 v + (1 - beta2) g^2
//! x -= rate (m / (1 - beta1^count)) / (sqrt(v / (1 - beta2^count)) + epsilon)
//! ```
//!
//! Rows that are not touched keep parameter, moments and count as they are: a splat that is seen in
//! one frame of twenty is not dragged on by old momentum in the other nineteen. `count` is the
//! value *after* this step's increment. Rows whose count is [`FIXED`] are never stepped.

pub mod cpu;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod nodes;
pub mod reference;

/// In place of a count of steps: the splat is drawn, but keeps its parameters.
pub const FIXED: u32 = u32::MAX;

/// The constants of Adam.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdamParams {
    /// Decay of the first moment. 0.9 (Kingma and Ba; 3DGS).
    pub beta1: f64,
    /// Decay of the second moment. 0.999 (Kingma and Ba; 3DGS); docs/spec/optimiser.md 3
    /// recommends 0.99 for dynamic splats, which see some 220 steps.
    pub beta2: f64,
    /// Added to the root of the second moment. 1e-15 (3DGS): gradients of a splat are tiny.
    pub epsilon: f64,
}

impl Default for AdamParams {
    fn default() -> Self {
        Self {
            beta1: 0.9,
            beta2: 0.999,
            epsilon: 1e-15,
        }
    }
}
