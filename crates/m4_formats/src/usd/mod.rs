//! OpenUSD as text (`.usda`): one `ParticleField3DGaussianSplat` with time samples, and the source camera.
//!
//! ```text
//! /scene/splats          positions.timeSamples    two, at the ends of the clip: splats move along lines,
//!                                                 and USD interpolates linearly ([`UsdPositions`])
//!                        opacities.timeSamples    0..1, every `step_frames`
//!                        orientations, scales     constant
//!                        radiance:sphericalHarmonicsCoefficients    constant (sampled where the scene has
//!                                                 harmonics of time), n x (degree + 1)^2
//! /scene/source_camera   a UsdGeomCamera with a pose a frame
//! ```
//!
//! What has time samples also has a value without time, that of the middle of the clip, for tools that read
//! still splats. Time codes are frames, `timeCodesPerSecond` is the speed of the clip. The stage has y up; a unit is
//! called a metre, which is true of captures with metric depth. Splats that no sample sees are left out.
//! Text is large; `usdcat scene.usda -o scene.usdc` packs it.
//!
//! What was written is read back at an instant ([`read()`]), so that an export can be drawn and compared; that is no
//! reader of USD at large.
//!
//! Source: `usdVol` of OpenUSD 26.03, where the schema appeared; names checked with `usd-core` 26.11.

mod camera;
mod error;
mod lexer;
mod moving;
mod number;
mod options;
mod read;
mod samples;
mod write;

pub use error::{ReadUsdError, WriteUsdError};
pub use options::{UsdOptions, UsdPositions};
pub use read::{parse, read};
pub use write::write;
