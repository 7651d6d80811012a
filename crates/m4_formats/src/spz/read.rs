//! An SPZ file to splats.

use super::decode::decode;
use super::error::ReadSpzError;
use super::layout::{HEADER_BYTES, Header, MAGIC, MAX_DEGREE};
use super::options::SpzAxes;
use crate::file::load;
use crate::rub::turn_splats;
use flate2::read::GzDecoder;
use m4_scene::Splats;
use std::io::Read;
use std::path::Path;

/// Real splats shrink to a half; more than this many bytes a byte are a bomb, unless they are few.
const MAX_RATIO: u64 = 64;
/// Bytes that a file of any size may unpack to: three million equal splats.
const FREE_BYTES: u64 = 64 << 20;

/// Reads the splats of a file (version 2 or 3), static all of them, in our axes (right, down, forward)
/// given those of the file.
///
/// # Errors
///
/// [`ReadSpzError`], which names the file and what is wrong with it.
pub fn read(path: &Path, axes: SpzAxes) -> Result<Splats, ReadSpzError> {
    let io = |source| ReadSpzError::Io {
        path: path.to_path_buf(),
        source,
    };
    let not_spz = |reason: String| ReadSpzError::NotSpz {
        path: path.to_path_buf(),
        reason,
    };
    let damaged = |reason: String| ReadSpzError::Damaged {
        path: path.to_path_buf(),
        reason,
    };
    let unsupported = |what: String| ReadSpzError::Unsupported {
        path: path.to_path_buf(),
        what,
    };
    let file = load(path).map_err(io)?;
    if file.starts_with(&MAGIC.to_le_bytes()) {
        return Err(unsupported("version 4 or later".into()));
    }
    if !file.starts_with(&[0x1f, 0x8b]) {
        return Err(not_spz("it does not begin as a gzip stream".into()));
    }
    let mut stream = GzDecoder::new(file.as_slice());
    let mut head = [0; HEADER_BYTES];
    stream
        .read_exact(&mut head)
        .map_err(|e| damaged(format!("the header of {HEADER_BYTES} bytes cannot be unpacked ({e})")))?;
    let (magic, header) = Header::from_bytes(&head);
    if magic != MAGIC {
        return Err(not_spz(format!(
            "inside the gzip stream it begins with {magic:#010x}, not {MAGIC:#010x}"
        )));
    }
    if !(2..=3).contains(&header.version) {
        return Err(unsupported(format!("version {}", header.version)));
    }
    if header.sh_degree > MAX_DEGREE {
        return Err(unsupported(format!("harmonics of degree {}", header.sh_degree)));
    }
    if header.fractional_bits > 23 {
        let bits = header.fractional_bits;
        return Err(damaged(format!("fractional_bits = {bits}; 0 to 23 was expected")));
    }
    let needed = header.payload_bytes();
    if needed > (MAX_RATIO * file.len() as u64).max(FREE_BYTES) {
        let (n, len) = (header.splats, file.len());
        return Err(damaged(format!(
            "the header counts {n} splats, which {len} bytes cannot hold"
        )));
    }
    // grows with what is there, not with what the header says
    let mut payload = Vec::new();
    stream.by_ref().take(needed).read_to_end(&mut payload).map_err(|e| {
        damaged(format!(
            "byte {} cannot be unpacked ({e})",
            HEADER_BYTES + payload.len()
        ))
    })?;
    if (payload.len() as u64) < needed {
        return Err(damaged(format!(
            "it ends after {} bytes of splats where {} splats take {needed}",
            payload.len(),
            header.splats
        )));
    }
    // extensions may follow; the checksum is behind them
    let after = std::io::copy(&mut stream.take(FREE_BYTES), &mut std::io::sink())
        .map_err(|e| damaged(format!("what follows the splats cannot be unpacked ({e})")))?;
    if after == FREE_BYTES {
        return Err(damaged(format!("more than {FREE_BYTES} bytes follow the splats")));
    }
    let mut splats = decode(&header, &payload);
    if axes == SpzAxes::Rub {
        turn_splats(&mut splats);
    }
    Ok(splats)
}
