//! What a program says that was built without object stores.

use super::{CloudError, Object, Wanted};
use std::path::Path;

fn refused<T>(uri: &str) -> Result<T, CloudError> {
    Err(CloudError::Without { uri: uri.to_owned() })
}

pub(crate) fn find(uri: &str, _: bool) -> Result<Vec<Object>, CloudError> {
    refused(uri)
}

pub(crate) fn fetch(wanted: Wanted<'_>, _: &Path, _: &Path, _: &dyn Fn() -> bool) -> Result<(), CloudError> {
    refused(wanted.uri)
}

pub(crate) fn check_upload(uri: &str) -> Result<(), CloudError> {
    refused(uri)
}

pub(crate) fn upload(_: &Path, uri: &str, _: &str, _: &dyn Fn() -> bool) -> Result<(), CloudError> {
    refused(uri)
}
