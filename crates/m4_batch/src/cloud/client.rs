//! A store by its URI, and waiting for what it does.

use super::CloudError;
use object_store::path::Path as ObjectPath;
use object_store::{ObjectMeta, ObjectStore, ObjectStoreScheme, parse_url_opts};
use std::error::Error;
use std::future::Future;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::{Builder, Handle};
use tokio::time::timeout;
use url::Url;

/// Settings of the client, before what the environment says. A clip may take hours, so only silence has a limit.
const CLIENT: [(&str, &str); 3] = [
    ("connect_timeout", "10 seconds"),
    ("read_timeout", "120 seconds"),
    ("timeout", "30 days"),
];
/// Variables that the stores' own tools read too.
const PREFIXES: [&str; 3] = ["AWS_", "GOOGLE_", "AZURE_"];
/// How often a transfer asks whether it is still wanted.
const LOOK: Duration = Duration::from_millis(200);

/// A place in a store.
#[derive(Debug)]
pub(super) struct Place {
    /// The store.
    pub(super) store: Arc<dyn ObjectStore>,
    /// The object, or the prefix.
    pub(super) path: ObjectPath,
    /// What the user named.
    pub(super) url: Url,
    /// False for plain HTTP servers, which hand out files by name and do no more.
    pub(super) is_bucket: bool,
}

impl Place {
    /// True for what is to be listed.
    pub(super) fn is_prefix(&self) -> bool {
        self.path.is_root() || self.url.path().ends_with('/')
    }
}

/// The place that a URI names. Nothing is asked of the store yet.
pub(super) fn open(uri: &str) -> Result<Place, CloudError> {
    let bad = |reason: String| CloudError::Uri {
        uri: uri.to_owned(),
        reason,
    };
    let url = Url::parse(uri).map_err(|e| bad(e.to_string()))?;
    if url.cannot_be_a_base() {
        return Err(bad("it has no path".to_owned()));
    }
    if url.query().is_some() || url.fragment().is_some() {
        let said = "a query or a fragment is no part of an object's name; write %3F for ? and %23 for #";
        return Err(bad(said.to_owned()));
    }
    let (scheme, _) = ObjectStoreScheme::parse(&url).map_err(|e| bad(e.to_string()))?;
    let is_bucket = scheme != ObjectStoreScheme::Http;
    if url.password().is_some() || !(is_bucket || url.username().is_empty()) {
        let said = "credentials belong into the environment, not into a manifest that others read";
        return Err(bad(said.to_owned()));
    }
    let (store, path) = parse_url_opts(&url, options(&url)).map_err(|e| failed(uri, e))?;
    Ok(Place {
        store: Arc::from(store),
        path,
        url,
        is_bucket,
    })
}

/// Ours first, so that variables come later and win.
fn options(url: &Url) -> Vec<(String, String)> {
    let mut options: Vec<_> = CLIENT
        .iter()
        .map(|(key, value)| ((*key).to_owned(), (*value).to_owned()))
        .collect();
    // Who writes http:// means it; the endpoint of a bucket needs AWS_ALLOW_HTTP.
    if url.scheme() == "http" {
        options.push(("allow_http".to_owned(), "true".to_owned()));
    }
    let variables =
        std::env::vars_os().filter_map(|(key, value)| Some((key.into_string().ok()?, value.into_string().ok()?)));
    options.extend(variables.filter(|(key, _)| PREFIXES.iter().any(|prefix| key.starts_with(prefix))));
    options
}

/// Runs what a store does to its end, in a runtime that lives for as long as that.
pub(super) fn block_on<T>(uri: &str, work: impl Future<Output = Result<T, CloudError>>) -> Result<T, CloudError> {
    let store = |reason: String| CloudError::Store {
        uri: uri.to_owned(),
        reason,
    };
    if Handle::try_current().is_ok() {
        let said = "this was called from an asynchronous task, which it would block; call it from a thread of its own";
        return Err(store(said.to_owned()));
    }
    let runtime = Builder::new_current_thread().enable_all().build();
    runtime.map_err(|e| store(e.to_string()))?.block_on(work)
}

/// Waits for `work`, unless `stop` says otherwise.
pub(super) async fn until<T>(
    uri: &str,
    stop: &dyn Fn() -> bool,
    work: impl Future<Output = T>,
) -> Result<T, CloudError> {
    let mut work = pin!(work);
    loop {
        if stop() {
            return Err(CloudError::Stopped { uri: uri.to_owned() });
        }
        if let Ok(done) = timeout(LOOK, work.as_mut()).await {
            return Ok(done);
        }
    }
}

/// What changes whenever the object does.
pub(super) fn mark(meta: &ObjectMeta) -> Option<&str> {
    meta.e_tag.as_deref().or(meta.version.as_deref())
}

/// From an error of the store, with all its causes, to ours.
pub(super) fn failed(uri: &str, error: object_store::Error) -> CloudError {
    let mut reason = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        let more = inner.to_string();
        if !reason.contains(&more) {
            reason = format!("{reason}: {more}");
        }
        cause = inner.source();
    }
    let uri = uri.to_owned();
    match error {
        object_store::Error::NotFound { .. } => CloudError::NotFound { uri },
        object_store::Error::Precondition { .. } => CloudError::Changed { uri, reason },
        object_store::Error::PermissionDenied { .. } | object_store::Error::Unauthenticated { .. } => {
            CloudError::Denied { uri, reason }
        }
        object_store::Error::InvalidPath { .. } => CloudError::Uri { uri, reason },
        _ => CloudError::Store { uri, reason },
    }
}
