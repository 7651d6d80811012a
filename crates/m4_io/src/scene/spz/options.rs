//! What an SPZ file holds of a scene.

use serde::{Deserialize, Serialize};

/// Which way the world's axes point in an SPZ file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SpzAxes {
    /// Right, up, back: what the format's README says.
    #[default]
    Rub,
    /// Right, down, forward, as in a PLY: what tools expect that treat SPZ and PLY alike
    /// (`splat-transform` 3.7).
    Rdf,
}

/// Settings of [`super::write()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SpzOptions {
    /// The instant, frames. Default 0.
    pub t: f64,
    /// Axes of the world. Default: right, up, back, the convention of the format.
    pub axes: SpzAxes,
    /// Bits behind the point of a coordinate, 0..=22. Default: as many as the farthest splat leaves. The
    /// reference encoder takes 12, steps of 1/4096 of a unit: files are a sixth smaller, and fine for
    /// scenes in metres.
    pub fractional_bits: Option<u8>,
    /// Bits that are kept of a harmonic of degree 1, 1..=8. Default 5, that of the reference encoder.
    pub sh1_bits: u8,
    /// Bits that are kept of harmonics of degree 2 and 3, 1..=8. Default 4, that of the reference encoder.
    pub sh_rest_bits: u8,
    /// Effort of gzip, 0..=9. Default 6, that of zlib.
    pub gzip_level: u32,
}

impl Default for SpzOptions {
    fn default() -> Self {
        Self {
            t: 0.0,
            axes: SpzAxes::Rub,
            fractional_bits: None,
            sh1_bits: 5,
            sh_rest_bits: 4,
            gzip_level: 6,
        }
    }
}
