//! Fixed-size vectors, matrices, quaternions, rotors, SE(3) and their derivatives, generic over
//! f32 and f64.
//!
//! Vectors and matrices are those of [`nalgebra`], which is re-exported so that every crate uses
//! the same release. What is ours is what splatting needs beside them: the scalar trait [`Real`],
//! rigid motions with a left retraction ([`Se3`]), quaternions with their vector-Jacobian products
//! ([`quat`]), rotor pairs for 4D rotations ([`rotor`]), and a counter-based random generator whose
//! numbers depend on a key and not on the order in which they are drawn ([`CounterRng`]).
//!
//! Conventions: OpenCV camera axes (x right, y down, z forward); a pose named `c2w` maps camera
//! coordinates to world coordinates; quaternions are stored `(w, x, y, z)`.
#![forbid(unsafe_code)]

pub mod quat;
pub mod rotor;

mod real;
mod rng;
mod se3;
mod se3_group;
mod sim3;

pub use nalgebra;
pub use real::Real;
pub use rng::CounterRng;
pub use se3::{Se3, exp_so3, hat, log_so3};
pub use sim3::Sim3;
