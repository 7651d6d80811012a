//! Reads whole files.

use crate::dataset::{ReadSourceError, SourceErrorCause};
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Longest list of frames that is read, bytes: a frame takes some kilobytes, and a hundred thousand frames are no clip.
const MAX_TEXT_BYTES: u64 = 256 << 20;

/// The bytes of a regular file of at most `limit_bytes`: devices and pipes, which may never end, are refused.
pub(crate) fn bytes(path: &Path, limit_bytes: u64) -> Result<Vec<u8>, SourceErrorCause> {
    let file = File::open(path)?;
    let facts = file.metadata()?;
    if !facts.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "it is not a regular file").into());
    }
    if facts.len() > limit_bytes {
        return Err(SourceErrorCause::TooLarge {
            what: "the file".into(),
            needed_bytes: facts.len(),
            limit_bytes,
        });
    }
    let mut bytes = Vec::new();
    file.take(facts.len()).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// A text file.
pub(crate) fn text(path: &Path) -> Result<String, ReadSourceError> {
    let bytes = bytes(path, MAX_TEXT_BYTES).map_err(|e| e.at(path))?;
    String::from_utf8(bytes).map_err(|e| {
        let place = format!("byte {}", e.utf8_error().valid_up_to());
        SourceErrorCause::bad("it is not text (UTF-8)", "give the text file that the tool wrote").within(path, place)
    })
}
