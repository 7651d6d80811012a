//! A copy of a published result in a store.

use super::CloudError;
use super::client::{self, Place, failed, until};
use crate::error::FileError;
use crate::layout::RUN_FILE;
use object_store::path::Path as ObjectPath;
use object_store::{ObjectStoreExt, WriteMultipart};
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::time::timeout;

/// Larger files go in parts of this size: S3 takes 10 000 parts of 5 MiB or more.
const PART_BYTES: usize = 8 << 20;
/// Parts under way at once.
const PARTS_AT_ONCE: usize = 2;
/// How long to tell the store that an upload is given up.
const ABORT: Duration = Duration::from_secs(10);

/// A file of a result.
struct Part {
    /// Its path in the result, with `/`.
    name: String,
    path: PathBuf,
    bytes: u64,
}

/// Whether results can be uploaded to `uri`, as far as that is known without asking the store.
///
/// # Errors
///
/// [`CloudError`].
pub(crate) fn check_upload(uri: &str) -> Result<(), CloudError> {
    bucket(uri).map(|_| ())
}

fn bucket(uri: &str) -> Result<Place, CloudError> {
    let place = client::open(uri)?;
    if !place.is_bucket {
        return Err(CloudError::Uri {
            uri: uri.to_owned(),
            reason: "results are uploaded to s3://, gs:// and az://, not to web servers".to_owned(),
        });
    }
    Ok(place)
}

/// Copies the result in `folder` to `uri/id/`, `run.json` last, and asks for the size of every object: who finds `run.json`
/// there finds all the rest.
///
/// # Errors
///
/// [`CloudError`]; [`CloudError::Stopped`] soon after `stop` says so.
pub(crate) fn upload(folder: &Path, uri: &str, id: &str, stop: &dyn Fn() -> bool) -> Result<(), CloudError> {
    let place = bucket(uri)?;
    client::block_on(uri, send(&place, folder, id, stop))
}

pub(super) async fn send(place: &Place, folder: &Path, id: &str, stop: &dyn Fn() -> bool) -> Result<(), CloudError> {
    let uri = place.url.as_str();
    let mut parts = Vec::new();
    list(folder, "", &mut parts).map_err(FileError::read(folder))?;
    parts.sort_by(|a, b| a.name.cmp(&b.name));
    let (last, first): (Vec<_>, Vec<_>) = parts.into_iter().partition(|part| part.name == RUN_FILE);
    let at = |name: &str| {
        let path = format!("{}/{id}/{name}", place.path);
        ObjectPath::parse(path.trim_start_matches('/')).map_err(|e| failed(uri, e.into()))
    };
    // That of an older result would speak for files that are being replaced.
    let run = at(RUN_FILE)?;
    match until(uri, stop, place.store.head(&run)).await? {
        Ok(_) => until(uri, stop, place.store.delete(&run))
            .await?
            .map_err(|e| failed(uri, e))?,
        Err(object_store::Error::NotFound { .. }) => {}
        Err(error) => return Err(failed(uri, error)),
    }
    for parts in [first, last] {
        for part in &parts {
            put(place, &at(&part.name)?, part, stop).await?;
        }
        for part in &parts {
            let path = at(&part.name)?;
            let meta = until(uri, stop, place.store.head(&path)).await?;
            let found = meta.map_err(|e| failed(uri, e))?.size;
            if found != part.bytes {
                return Err(CloudError::Store {
                    uri: uri.to_owned(),
                    reason: format!("{path} has {found} bytes there, and {} here", part.bytes),
                });
            }
        }
    }
    Ok(())
}

/// All files in a folder.
fn list(folder: &Path, prefix: &str, parts: &mut Vec<Part>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let path = entry.path();
        let name = entry.file_name();
        let Some(name) = name.to_str().map(|name| format!("{prefix}{name}")) else {
            let said = format!("the name {} is not UTF-8", path.display());
            return Err(io::Error::new(io::ErrorKind::InvalidData, said));
        };
        if path.is_dir() {
            list(&path, &format!("{name}/"), parts)?;
        } else {
            let bytes = fs::metadata(&path)?.len();
            parts.push(Part { name, path, bytes });
        }
    }
    Ok(())
}

async fn put(place: &Place, to: &ObjectPath, part: &Part, stop: &dyn Fn() -> bool) -> Result<(), CloudError> {
    let uri = place.url.as_str();
    let refused = |e| failed(uri, e);
    if part.bytes <= PART_BYTES as u64 {
        let content = fs::read(&part.path).map_err(FileError::read(&part.path))?;
        until(uri, stop, place.store.put(to, content.into()))
            .await?
            .map_err(refused)?;
        return Ok(());
    }
    let begun = until(uri, stop, place.store.put_multipart(to)).await?;
    let mut writer = WriteMultipart::new_with_chunk_size(begun.map_err(refused)?, PART_BYTES);
    if let Err(error) = write(uri, &mut writer, &part.path, stop).await {
        // Parts that stay cost room until the bucket's rules remove them.
        let _ = timeout(ABORT, writer.abort()).await;
        return Err(error);
    }
    until(uri, stop, writer.finish()).await?.map_err(refused)?;
    Ok(())
}

async fn write(uri: &str, writer: &mut WriteMultipart, from: &Path, stop: &dyn Fn() -> bool) -> Result<(), CloudError> {
    let mut file = File::open(from).map_err(FileError::read(from))?;
    let mut buffer = vec![0; PART_BYTES];
    loop {
        let n = match file.read(&mut buffer) {
            Err(e) if e.kind() == io::ErrorKind::Interrupted => continue,
            n => n.map_err(FileError::read(from))?,
        };
        if n == 0 {
            return Ok(());
        }
        until(uri, stop, writer.wait_for_capacity(PARTS_AT_ONCE))
            .await?
            .map_err(|e| failed(uri, e))?;
        writer.write(&buffer[..n]);
    }
}
