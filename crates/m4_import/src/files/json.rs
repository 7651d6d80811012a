//! Files as bytes and as JSON.

use crate::core::{ReadSourceError, SourceFault};
use serde::de::DeserializeOwned;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Largest JSON file that is read: the pose of a frame takes under 2 kB, and a hundred thousand frames are no clip.
const MAX_JSON_BYTES: u64 = 256 << 20;

/// Longest part of a parser's message that is passed on, letters.
const MAX_SAID: usize = 200;

/// All bytes of a file of at most `limit_bytes`.
pub(crate) fn bytes(path: &Path, limit_bytes: u64) -> Result<Vec<u8>, ReadSourceError> {
    let io = |source| SourceFault::Io(source).at(path);
    let file = File::open(path).map_err(io)?;
    let needed_bytes = file.metadata().map_err(io)?.len();
    if needed_bytes > limit_bytes {
        let what = "the file".to_owned();
        return Err(SourceFault::TooLarge {
            what,
            needed_bytes,
            limit_bytes,
        }
        .at(path));
    }
    let mut bytes = Vec::new();
    file.take(limit_bytes).read_to_end(&mut bytes).map_err(io)?;
    Ok(bytes)
}

/// A JSON file.
pub(crate) fn json<T: DeserializeOwned>(path: &Path) -> Result<T, ReadSourceError> {
    parse_json(&bytes(path, MAX_JSON_BYTES)?, path)
}

/// JSON that was read from `path`.
pub(crate) fn parse_json<T: DeserializeOwned>(bytes: &[u8], path: &Path) -> Result<T, ReadSourceError> {
    serde_json::from_slice(bytes).map_err(|e| {
        let mut said = e.to_string();
        // it may quote the file at any length
        if said.chars().count() > MAX_SAID {
            said = said.chars().take(MAX_SAID).collect();
            said.push_str(&format!("... at line {} column {}", e.line(), e.column()));
        }
        let what = format!("it is not the JSON that was expected ({said})");
        SourceFault::bad(what, "export it again").at(path)
    })
}
