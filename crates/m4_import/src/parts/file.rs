//! Whole files.

use crate::core::{ReadSourceError, SourceFault};
use serde::de::DeserializeOwned;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Longest list of frames that is read, bytes: a frame takes some kilobytes, and a hundred thousand frames are no clip.
pub(crate) const MAX_TEXT_BYTES: u64 = 256 << 20;

/// The bytes of a regular file of at most `limit_bytes`: devices and pipes, which may never end, are refused.
pub(crate) fn bytes(path: &Path, limit_bytes: u64) -> Result<Vec<u8>, SourceFault> {
    let file = File::open(path)?;
    let facts = file.metadata()?;
    if !facts.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "it is not a regular file").into());
    }
    if facts.len() > limit_bytes {
        return Err(SourceFault::TooLarge {
            what: "the file".into(),
            needed_bytes: facts.len(),
            limit_bytes,
        });
    }
    let mut bytes = Vec::new();
    file.take(facts.len()).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The fault with the file that it is of, for frames, which name the source and themselves.
pub(crate) fn named(path: &Path, fault: SourceFault) -> SourceFault {
    let of = |what: String| format!("{}: {what}", path.display());
    match fault {
        SourceFault::Io(e) => SourceFault::Io(io::Error::new(e.kind(), of(e.to_string()))),
        SourceFault::Missing { what, remedy } => SourceFault::Missing { what: of(what), remedy },
        SourceFault::Bad { what, remedy } => SourceFault::Bad { what: of(what), remedy },
        SourceFault::Unsupported { what, remedy } => SourceFault::Unsupported { what: of(what), remedy },
        other => other,
    }
}

/// A text file.
pub(crate) fn text(path: &Path) -> Result<String, ReadSourceError> {
    let bytes = bytes(path, MAX_TEXT_BYTES).map_err(|fault| fault.at(path))?;
    String::from_utf8(bytes).map_err(|e| {
        let place = format!("byte {}", e.utf8_error().valid_up_to());
        SourceFault::bad("it is no text (UTF-8)", "give the text file that the tool wrote").within(path, place)
    })
}

/// A JSON file.
pub(crate) fn json<T: DeserializeOwned>(path: &Path) -> Result<T, ReadSourceError> {
    let text = text(path)?;
    serde_json::from_str(&text).map_err(|e| {
        let line = e
            .line()
            .checked_sub(1)
            .and_then(|n| text.lines().nth(n))
            .unwrap_or_default();
        let remedy = if line.contains("NaN") || line.contains("Infinity") {
            "JSON has neither NaN nor Infinity; drop the frames whose pose was not found"
        } else {
            "write the file again with the tool that made it"
        };
        SourceFault::bad(format!("it is not the JSON that was expected: {e}"), remedy).at(path)
    })
}
