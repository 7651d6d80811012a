//! A planned object to a file.

use super::client::{self, failed, mark, until};
use super::{CloudError, Wanted};
use crate::error::FileError;
use crate::publish::hash;
use crate::record::{read_json, write_json};
use futures_util::StreamExt;
use m4_io::atomic::{AtomicFile, is_temporary_of};
use object_store::path::Path as ObjectPath;
use object_store::{ObjectStore, ObjectStoreExt};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io::{ErrorKind, Write};
use std::path::Path;

/// What is in a fetched file, beside it: a worker that goes on where another stopped need not fetch it again.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Note {
    uri: String,
    etag: String,
    bytes: u64,
    blake3: String,
}

/// Fetches an object to the file `to`, unless it is there, by the word of `note` and its hash.
///
/// # Errors
///
/// [`CloudError::Changed`] where size or ETag are not those of the plan, [`CloudError::Stopped`] soon after `stop` says so.
pub(crate) fn fetch(wanted: Wanted<'_>, to: &Path, note: &Path, stop: &dyn Fn() -> bool) -> Result<(), CloudError> {
    if is_here(wanted, to, note)? {
        return Ok(());
    }
    remove_temporary(to).map_err(FileError::write(to))?;
    let place = client::open(wanted.uri)?;
    let work = get(place.store.as_ref(), &place.path, wanted, to, note, stop);
    client::block_on(wanted.uri, work)
}

fn is_here(wanted: Wanted<'_>, to: &Path, note: &Path) -> Result<bool, FileError> {
    let note = read_json::<Note>(note)?
        .filter(|n| (n.uri.as_str(), n.etag.as_str(), n.bytes) == (wanted.uri, wanted.etag, wanted.bytes));
    let size = fs::metadata(to).map(|m| m.len()).ok();
    match note {
        Some(note) if size == Some(wanted.bytes) => Ok(hash(to)? == note.blake3),
        _ => Ok(false),
    }
}

/// Parts of the file that workers which died left.
fn remove_temporary(to: &Path) -> std::io::Result<()> {
    let (Some(folder), Some(name)) = (to.parent(), to.file_name().and_then(|n| n.to_str())) else {
        return Ok(());
    };
    let entries = match fs::read_dir(folder) {
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let entry = entry?;
        if entry.file_name().to_str().is_some_and(|n| is_temporary_of(n, name)) {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

pub(super) async fn get(
    store: &dyn ObjectStore,
    path: &ObjectPath,
    wanted: Wanted<'_>,
    to: &Path,
    note: &Path,
    stop: &dyn Fn() -> bool,
) -> Result<(), CloudError> {
    let uri = wanted.uri;
    let changed = |reason: String| CloudError::Changed {
        uri: uri.to_owned(),
        reason,
    };
    let got = until(uri, stop, store.get(path)).await?.map_err(|e| failed(uri, e))?;
    if got.meta.size != wanted.bytes {
        return Err(changed(format!("{} bytes, planned {}", got.meta.size, wanted.bytes)));
    }
    // Azure quotes them in answers and not in lists.
    let bare = |etag: &str| etag.trim_matches('"').to_owned();
    let found = mark(&got.meta).unwrap_or("none");
    if bare(found) != bare(wanted.etag) {
        return Err(changed(format!("ETag {found}, planned {}", wanted.etag)));
    }
    let failed_to_write = |source| FileError::Write {
        path: to.to_path_buf(),
        source,
    };
    let mut file = AtomicFile::create(to).map_err(failed_to_write)?;
    let (mut hasher, mut bytes) = (blake3::Hasher::new(), 0);
    let mut stream = got.into_stream();
    while let Some(piece) = until(uri, stop, stream.next()).await? {
        let piece = piece.map_err(|e| failed(uri, e))?;
        bytes += piece.len() as u64;
        hasher.update(&piece);
        file.write_all(&piece).map_err(failed_to_write)?;
    }
    if bytes != wanted.bytes {
        return Err(CloudError::Store {
            uri: uri.to_owned(),
            reason: format!("{bytes} bytes came, and {} were announced", wanted.bytes),
        });
    }
    file.commit().map_err(failed_to_write)?;
    let content = Note {
        uri: uri.to_owned(),
        etag: wanted.etag.to_owned(),
        bytes,
        blake3: hasher.finalize().to_hex().to_string(),
    };
    Ok(write_json(note, &content)?)
}
