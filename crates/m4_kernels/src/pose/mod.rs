//! Carries bound splats to an instant with the nodes of their window, and gradients back
//! (docs/spec/scaffold.md 2; [`m4_core::Binding`]).
//!
//! ```text
//! m(t)   = A (mean + velocity dt) + b          Q(t) = q Q          rgb(t) = colour + trend dt          dt = t - time_mean
//! o(t)   = 1 - (1 - o)^f(t)
//! f(t)   = S((t - begin) / h) S((end - t) / h)
//! S(x)   = s^2 (3 - 2 s),  s = (1 + x) / 2 clamped to 0..1
//! ```
//!
//! `A`, `b` and `q` are the mean motion of the nodes, `h` is [`FADE`] times the time between keys.
//! Fading in optical depth, two coincident layers, one that ends where the other begins, are as
//! opaque as one. What is carried is drawn as a static splat is; the marginal of dynamic splats is
//! not used.

mod bake;
pub(crate) mod cpu;
#[cfg(feature = "gpu")]
pub mod gpu;
mod pieces;
pub mod reference;

pub use bake::{at, place, presence};
pub use pieces::{Pieces, pieces};

/// Half the time in which a splat fades in or out, as a share of the mean time between keys
/// (docs/decisions/0022).
pub const FADE: f32 = 0.6;
/// A splat that is present by at most this is left out of the frame.
pub const LEAST_PRESENCE: f32 = 1e-3;
