//! JSON files: written whole, read if they are what they should be.

use crate::Error;
use m4_io::{atomic, files};
use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;
use std::io::ErrorKind;
use std::path::Path;

/// Largest record that is read, bytes: those of long runs have some hundred kilobytes.
pub const MAX_RECORD_BYTES: u64 = 64 << 20;

/// Converts a value to JSON in which 32-bit numbers keep their short form.
///
/// # Errors
///
/// [`Error::Internal`] if the value cannot be written as JSON.
pub fn plain_json(value: &impl Serialize) -> Result<Value, Error> {
    // Through text: `to_value` would widen 0.1f32 to 0.10000000149011612.
    serde_json::from_str(&serde_json::to_string(value).map_err(Error::internal)?)
        .map_err(Error::internal)
}

/// Writes `value` as indented JSON, atomically.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<(), Error> {
    let text = serde_json::to_string_pretty(value).map_err(Error::internal)? + "\n";
    atomic::write(path, text.as_bytes()).map_err(Error::write(path))
}

/// Reads JSON; `None` if there is no file or it has other contents.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, Error> {
    match files::read(path, MAX_RECORD_BYTES) {
        Ok(bytes) => Ok(serde_json::from_slice(&bytes).ok()),
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            Ok(None)
        }
        Err(source) => Err(Error::read(path)(source)),
    }
}

#[cfg(test)]
mod tests {
    use super::plain_json;

    #[test]
    fn short_numbers_stay_short() {
        assert_eq!(plain_json(&0.1f32).unwrap().to_string(), "0.1");
    }
}
