//! The metadata of a scene file.

use super::convert::Sources;
use m4_core::SplatLayout;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Key of the metadata of the safetensors file.
pub const KEY: &str = "minute4d_scene";
/// Version that is written, and newest that is read.
pub const VERSION: u32 = 1;

/// The JSON under [`KEY`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Header {
    pub version: u32,
    /// Hexadecimal, over [`checksum`]'s bytes.
    pub blake3: String,
    pub scene: Facts,
    /// The caller's own pairs.
    #[serde(default)]
    pub metadata: BTreeMap<String, String>,
}

/// The part of [`Header`] whose meaning a newer version may change.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Version {
    pub version: u32,
}

/// What is not an array.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Facts {
    pub isotropic: bool,
    pub sh_degree: usize,
    pub time_degree: usize,
    pub splats_static: usize,
    pub splats_dynamic: usize,
    pub background: [f32; 3],
    pub time_frames: usize,
    pub duration_s: Option<f64>,
    pub mip: bool,
    pub near: f32,
    /// Arrays `state.NAME` are there, though perhaps none.
    pub has_state: bool,
}

impl Facts {
    pub fn layout(&self) -> SplatLayout {
        SplatLayout {
            isotropic: self.isotropic,
            sh_degree: self.sh_degree,
            time_degree: self.time_degree,
        }
    }
}

/// Hash of everything that the file means: facts, metadata, and name, type, shape and values of each
/// array in the order of the names. Every part is preceded by its length.
pub fn checksum(
    facts: &Facts,
    metadata: &BTreeMap<String, String>,
    arrays: &Sources<'_>,
) -> Result<String, serde_json::Error> {
    let mut hasher = blake3::Hasher::new();
    part(&mut hasher, &serde_json::to_vec(facts)?);
    part(&mut hasher, &serde_json::to_vec(metadata)?);
    for (name, array) in arrays {
        part(&mut hasher, name.as_bytes());
        part(&mut hasher, array.describe().as_bytes());
        hasher.update(&(array.bytes() as u64).to_le_bytes());
        let Ok(()) = array.pieces(|piece| {
            hasher.update(piece);
            Ok::<(), std::convert::Infallible>(())
        });
    }
    Ok(hasher.finalize().to_hex().to_string())
}

fn part(hasher: &mut blake3::Hasher, bytes: &[u8]) {
    hasher.update(&(bytes.len() as u64).to_le_bytes());
    hasher.update(bytes);
}
