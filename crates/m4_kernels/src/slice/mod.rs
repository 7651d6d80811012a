//! Slices a 4D splat at one instant.
//!
//! Specification: docs/spec/optimiser.md 1.3 to 1.5. With `dt = t - time_mean` in frames and
//! `w = exp(2 log_time_sd)`:
//!
//! ```text
//! m(t) = mean + velocity dt        world units
//! S    = Q diag(exp(2 log_scale)) Q^T        (isotropic: exp(2 log_scale) I), world units squared
//! p(t) = exp(-dt^2 / (2 w))        peak 1, not a density; exactly 1 for static splats
//! ```
//!
//! A splat whose `p` is at most [`MARGINAL_MIN`] is left out of the frame. Quaternions are
//! normalised on use; their length has no gradient.
//!
//! The gradient of a symmetric matrix is symmetric everywhere in this crate: `dL = <G, dS>`, so a
//! scalar that sits at both `(0, 1)` and `(1, 0)` receives `2 G_01`.
//!
//! [`mod@reference`] also slices the rotor-pair form (docs/spec/optimiser.md 1.2), which has no
//! twin: it is there to prove that the velocity form is the same model.

pub(crate) mod cpu;
#[cfg(feature = "gpu")]
pub mod gpu;
pub mod reference;

/// Splats whose temporal marginal is at most this are left out of a frame: `|dt| > 2.448 sd`
/// (docs/spec/optimiser.md 1.3).
pub const MARGINAL_MIN: f64 = 0.05;
