//! The cameras of a scene for other reconstruction tools: COLMAP ([`colmap`]) and nerfstudio
//! ([`nerfstudio`]).
//!
//! Both are in the scene's own world (right, down, forward of the first frame), so that what another tool
//! makes of them lies where the splats of our other files lie before these are turned.

pub mod colmap;
pub mod nerfstudio;

mod names;

pub use names::BadName;
