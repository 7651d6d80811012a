//! Portable float maps: `Pf`, width, height, scale as text, then 32-bit floats, rows from the bottom; a scale below 0 says that
//! the bytes are least significant first.

use super::known;
use crate::dataset::SourceErrorCause;
use m4_core::{DepthMap, Plane};

/// Longest token of the head.
const MAX_TOKEN: usize = 32;

/// A map of one channel, rows from the top.
///
/// # Errors
///
/// [`SourceErrorCause`]: three channels, a scale other than 1 or -1, or not as many numbers as the head says.
pub fn decode_pfm(bytes: &[u8]) -> Result<DepthMap, SourceErrorCause> {
    let bad = |what: String| SourceErrorCause::bad(what, "export the map again, as one channel with scale -1");
    let mut rest = bytes;
    let mut token = || -> Option<&str> {
        let start = rest.iter().position(|b| !b.is_ascii_whitespace())?;
        rest = &rest[start..];
        let end = rest.iter().take(MAX_TOKEN).position(u8::is_ascii_whitespace)?;
        let (word, after) = rest.split_at(end);
        // one white space ends it: after the last token the numbers begin
        rest = &after[1..];
        std::str::from_utf8(word).ok()
    };
    let kind = token().unwrap_or_default().to_owned();
    if kind != "Pf" {
        return Err(bad(format!("a PFM file of kind {kind:?}; Pf was expected")));
    }
    let sides = [
        token().and_then(|t| t.parse::<usize>().ok()),
        token().and_then(|t| t.parse().ok()),
    ];
    let scale = token().and_then(|t| t.parse::<f64>().ok());
    let ([Some(width), Some(height)], Some(scale)) = (sides, scale) else {
        return Err(bad("its head is not understood".into()));
    };
    if scale.abs() != 1.0 {
        return Err(bad(format!("its scale is {scale}; 1 or -1 was expected")));
    }
    let needed = width.checked_mul(height).and_then(|n| n.checked_mul(4));
    if needed != Some(rest.len()) || rest.is_empty() {
        return Err(bad(format!(
            "{width} x {height} pixels of 4 bytes were expected and {} bytes are there",
            rest.len()
        )));
    }
    let value = |b: &[u8; 4]| {
        if scale < 0.0 {
            f32::from_le_bytes(*b)
        } else {
            f32::from_be_bytes(*b)
        }
    };
    let values = rest.as_chunks::<4>().0;
    Ok(Plane::from_fn(width, height, |x, y| {
        known(value(&values[(height - 1 - y) * width + x]))
    }))
}
