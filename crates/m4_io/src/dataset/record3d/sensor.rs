//! Depth of the sensor.

use crate::dataset::SourceErrorCause;
use crate::dataset::files::Members;
use crate::dataset::side::depth::{kept_where, known};
use lzfse_rust::LzfseRingDecoder;
use m4_core::{CompactDepth, Plane};
use std::io::Read;

const HINT: &str = "export the recording again as .r3d";

/// z-depth of frame `n`, metres, 0 where it is unknown or of no confidence.
pub(super) fn depth(members: &Members, n: usize, dw: usize, dh: usize) -> Result<CompactDepth, SourceErrorCause> {
    let bytes = unpacked(members, &format!("rgbd/{n}.depth"), dw * dh * 4)?;
    let bytes = bytes.ok_or_else(|| SourceErrorCause::missing(format!("rgbd/{n}.depth"), HINT))?;
    let values = bytes.as_chunks::<4>().0;
    let map = Plane::from_fn(dw, dh, |x, y| known(f32::from_le_bytes(values[y * dw + x])));
    let map = CompactDepth::from(map);
    match unpacked(members, &format!("rgbd/{n}.conf"), dw * dh)? {
        Some(bytes) => {
            let confidence = Plane::from_fn(dw, dh, |x, y| bytes[y * dw + x]);
            kept_where(&map, &confidence)
        }
        None => Ok(map),
    }
}

/// The `expected` bytes of a member that is packed with LZFSE, or plain.
fn unpacked(members: &Members, name: &str, expected: usize) -> Result<Option<Vec<u8>>, SourceErrorCause> {
    // LZFSE stores what it cannot pack, with some bytes around each block
    let most = 2 * expected as u64 + 4096;
    let Some(packed) = members.read(name, most)? else {
        return Ok(None);
    };
    if packed.len() == expected {
        return Ok(Some(packed));
    }
    let mut out = Vec::new();
    let mut decoder = LzfseRingDecoder::default();
    // one byte more than there may be
    let read = decoder
        .reader_bytes(&packed)
        .take(expected as u64 + 1)
        .read_to_end(&mut out);
    if let Err(e) = read {
        return Err(SourceErrorCause::bad(format!("{name} cannot be unpacked ({e})"), HINT));
    }
    if out.len() != expected {
        let what = format!("{name} does not unpack to the {expected} bytes that metadata says");
        return Err(SourceErrorCause::bad(what, HINT));
    }
    Ok(Some(out))
}
