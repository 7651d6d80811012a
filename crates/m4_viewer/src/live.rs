//! A scene for an open page: the response to a request for `live.scene` of the manifest.
//!
//! | bytes | what |
//! |---|---|
//! | 4 | u32, little endian: length of the manifest |
//! | that many | a [`Manifest`] as JSON, describing this scene |
//! | the rest | the payload, without gzip |

use crate::manifest::Manifest;

/// The answer as bytes.
///
/// # Errors
///
/// The failure to write the manifest as JSON.
pub fn answer(manifest: &Manifest, payload: &[u8]) -> Result<Vec<u8>, serde_json::Error> {
    let json = serde_json::to_vec(manifest)?;
    let mut out = Vec::with_capacity(4 + json.len() + payload.len());
    out.extend_from_slice(&(json.len() as u32).to_le_bytes());
    out.extend_from_slice(&json);
    out.extend_from_slice(payload);
    Ok(out)
}
