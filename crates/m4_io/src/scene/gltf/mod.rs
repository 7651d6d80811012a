//! Binary glTF (`.glb`) with `KHR_gaussian_splatting`: one instant, 60 bytes per splat and 12 for each
//! harmonic, in f32.
//!
//! The splats are the vertices of one primitive of points:
//!
//! ```text
//! POSITION                                  vec3 f32   right, up, back
//! KHR_gaussian_splatting:ROTATION           vec4 f32   x y z w
//! KHR_gaussian_splatting:SCALE              vec3 f32   standard deviations
//! KHR_gaussian_splatting:OPACITY            f32        0..1
//! KHR_gaussian_splatting:SH_DEGREE_l_COEF_n vec3 f32   as in a PLY of 3D Gaussian splatting
//! COLOR_0                                   vec4 u8    colour and opacity of the point, for players that
//!                                                      do not know the extension
//! ```
//!
//! Status of the extension: Release Candidate in the specification's snapshot of July 2026
//! ([`EXTENSION_STATUS`], which is also in the file). An earlier draft had the logarithm of the scale;
//! the readers of today (three r187 and fourdgs 0.6 were checked) take it as it is written here.
//!
//! Source: `extensions/2.0/Khronos/KHR_gaussian_splatting` of `KhronosGroup/glTF`.

mod document;
mod section;
mod write;

pub use write::write;

/// How far the extension is on its way to a standard, said in the file too.
pub const EXTENSION_STATUS: &str = "KHR_gaussian_splatting, Release Candidate (specification of July 2026)";

/// Name of the extension.
const EXTENSION: &str = "KHR_gaussian_splatting";
/// "glTF", little-endian.
const MAGIC: u32 = 0x4654_6c67;
/// "JSON".
const JSON_CHUNK: u32 = 0x4e4f_534a;
/// "BIN\0".
const BIN_CHUNK: u32 = 0x004e_4942;
/// Component type of f32.
const FLOAT: u32 = 5126;
/// Component type of u8.
const UNSIGNED_BYTE: u32 = 5121;

/// Attributes of the harmonics of a degree, in the order of a splat's coefficients.
fn harmonic_names(sh_degree: usize) -> impl Iterator<Item = String> {
    (0..=sh_degree).flat_map(|l| (0..=2 * l).map(move |n| format!("{EXTENSION}:SH_DEGREE_{l}_COEF_{n}")))
}
