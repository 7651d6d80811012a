//! Clips under a prefix, or the one object that is named.

use super::client::{self, Place, failed, mark};
use super::{CloudError, Object};
use crate::plan::is_video;
use futures_util::TryStreamExt;
use object_store::{ObjectMeta, ObjectStore, ObjectStoreExt};

/// The object that `uri` names, or the videos under it where it ends with `/`; with `recursive`, also those under prefixes
/// in it.
///
/// # Errors
///
/// [`CloudError`].
pub(crate) fn find(uri: &str, recursive: bool) -> Result<Vec<Object>, CloudError> {
    let place = client::open(uri)?;
    client::block_on(uri, objects(&place, recursive))
}

pub(super) async fn objects(place: &Place, recursive: bool) -> Result<Vec<Object>, CloudError> {
    let uri = place.url.as_str();
    if !place.is_prefix() {
        let meta = place.store.head(&place.path).await.map_err(|e| failed(uri, e))?;
        return Ok(vec![object(uri.to_owned(), &meta)?]);
    }
    if !place.is_bucket {
        return Err(CloudError::Uri {
            uri: uri.to_owned(),
            reason: "web servers list nothing; name each file".to_owned(),
        });
    }
    let prefix = (!place.path.is_root()).then_some(&place.path);
    let all = if recursive {
        place.store.list(prefix).try_collect::<Vec<_>>().await
    } else {
        place
            .store
            .list_with_delimiter(prefix)
            .await
            .map(|listed| listed.objects)
    };
    let mut found = Vec::new();
    for meta in all.map_err(|e| failed(uri, e))? {
        let Some(inner) = meta.location.prefix_match(&place.path) else {
            continue;
        };
        let parts: Vec<String> = inner.map(|part| part.as_ref().to_owned()).collect();
        let extension = meta.location.extension().map(str::to_lowercase);
        let hidden = parts.iter().any(|part| part.starts_with('.'));
        if hidden || parts.is_empty() || !extension.is_some_and(|e| is_video(&e)) {
            continue;
        }
        found.push(object(inside(place, &parts), &meta)?);
    }
    if found.is_empty() {
        return Err(CloudError::Nothing {
            uri: uri.to_owned(),
            recursive,
        });
    }
    Ok(found)
}

/// The URI of an object under a prefix.
fn inside(place: &Place, parts: &[String]) -> String {
    let mut url = place.url.clone();
    // Opening the place made sure that it has a path.
    if let Ok(mut segments) = url.path_segments_mut() {
        segments.pop_if_empty().extend(parts);
    }
    url.into()
}

fn object(uri: String, meta: &ObjectMeta) -> Result<Object, CloudError> {
    let Some(etag) = mark(meta) else {
        return Err(CloudError::NoEtag { uri });
    };
    let file = meta.location.filename().unwrap_or_default();
    let name = match file.rsplit_once('.') {
        Some((stem, _)) if !stem.is_empty() => stem,
        _ => file,
    };
    Ok(Object {
        name: name.to_owned(),
        bytes: meta.size,
        etag: etag.to_owned(),
        uri,
    })
}
