//! Dynamic splats as 4D Gaussians with one 4x4 covariance, and the exact way to and from the columns
//! of [`crate::Splats`] (docs/spec/optimiser.md 1.2, 1.3, 1.4).
//!
//! The two forms are the same model. With `S` the covariance that an instant sees, `v` the velocity
//! and `w` the variance in time:
//!
//! ```text
//! covariance = [[S + w v v^T, w v], [w v^T, w]]        order x, y, z, t
//! w = covariance[t][t],  v = covariance[xyz][t] / w,  S = covariance[xyz][xyz] - w v v^T
//! ```
//!
//! Files of other programs hold this form, or the rotor pair from which [`Covariance4::from_rotor`]
//! builds it.

mod joint;
mod velocity;

#[cfg(test)]
mod tests;

pub use joint::{Covariance4, Covariance4Error, Slice3};
pub use velocity::VelocityForm;
