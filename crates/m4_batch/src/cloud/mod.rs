//! Clips in object stores, and copies of results there.
//!
//! A store holds inputs and copies of results and nothing else: leases, records and the results themselves need what a
//! file system promises (`docs/batch.md`). All of it is behind the feature `cloud`; without it every function here refuses.

mod error;

#[cfg(feature = "cloud")]
mod client;
#[cfg(feature = "cloud")]
mod fetch;
#[cfg(feature = "cloud")]
mod list;
#[cfg(feature = "cloud")]
mod upload;
#[cfg(not(feature = "cloud"))]
mod without;

pub use error::CloudError;

#[cfg(not(feature = "cloud"))]
pub(crate) use without::{check_upload, fetch, find, upload};
#[cfg(feature = "cloud")]
pub(crate) use {
    fetch::fetch,
    list::find,
    upload::{check_upload, upload},
};

/// Schemes of stores.
const SCHEMES: [&str; 5] = ["s3", "gs", "az", "http", "https"];
/// Longest extension of a clip that is kept.
const LONGEST_EXTENSION: usize = 8;

/// An object that is a clip.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Object {
    /// Where it is.
    pub(crate) uri: String,
    /// Its name without folders and extension.
    pub(crate) name: String,
    /// Its size.
    pub(crate) bytes: u64,
    /// What the store changes whenever the object changes: its ETag, or its version where it has no ETag.
    pub(crate) etag: String,
}

/// An object that was planned.
#[derive(Debug, Clone, Copy)]
#[cfg_attr(not(feature = "cloud"), expect(dead_code, reason = "its URI alone is refused"))]
pub(crate) struct Wanted<'a> {
    /// Where it is.
    pub(crate) uri: &'a str,
    /// Its size.
    pub(crate) bytes: u64,
    /// Its ETag or version.
    pub(crate) etag: &'a str,
}

/// True for `s3://bucket/clip.mp4` and the like.
pub(crate) fn is_uri(text: &str) -> bool {
    text.split_once("://")
        .is_some_and(|(scheme, _)| SCHEMES.contains(&scheme))
}

/// The extension of the object: decoders look at it. `video` where it has none that could be one.
pub(crate) fn extension(uri: &str) -> &str {
    let name = uri.rsplit('/').next().unwrap_or_default();
    match name.rsplit_once('.') {
        Some((stem, extension))
            if !stem.is_empty()
                && (1..=LONGEST_EXTENSION).contains(&extension.len())
                && extension.chars().all(|c| c.is_ascii_alphanumeric()) =>
        {
            extension
        }
        _ => "video",
    }
}

#[cfg(test)]
#[cfg(feature = "cloud")]
pub(crate) mod tests;
