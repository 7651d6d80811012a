//! Reads JSON.

use super::text;
use crate::dataset::{ReadSourceError, SourceErrorCause};
use serde::de::DeserializeOwned;
use std::path::Path;

/// A JSON file.
pub(crate) fn json<T: DeserializeOwned>(path: &Path) -> Result<T, ReadSourceError> {
    parse_json(&text(path)?, path)
}

/// JSON that was read from `path`.
pub(crate) fn parse_json<T: DeserializeOwned>(text: &str, path: &Path) -> Result<T, ReadSourceError> {
    serde_json::from_str(text).map_err(|e| {
        let line = e.line().checked_sub(1).and_then(|n| text.lines().nth(n));
        let has = |word: &str| line.is_some_and(|line| line.contains(word));
        let hint = if has("NaN") || has("Infinity") {
            "JSON has neither NaN nor Infinity; drop the frames whose pose was not found"
        } else {
            "write the file again with the tool that made it"
        };
        SourceErrorCause::bad(format!("it is not the JSON that was expected ({e})"), hint).at(path)
    })
}
