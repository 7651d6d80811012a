//! Pretrained networks by the weights that are installed.

mod segmenter;

pub(crate) use segmenter::{Resolved, resolve as resolve_segmenter};

use crate::Error;
use crate::error::{NetworkError, NetworkMethod};
#[cfg(feature = "nets")]
use crate::weights::{self, Entry, Store, WeightsError};
#[cfg(feature = "nets")]
use m4_nets::LoadError;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A network that took part, for the record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct UsedNetwork {
    /// The name of its weights in `minute4d weights list`.
    pub weights: String,
    /// Their licence.
    pub licence: String,
    /// False where that forbids commercial use.
    pub commercial: bool,
    /// BLAKE3 of the file.
    pub blake3: String,
}

/// The first of `names` whose weights are installed, and their file.
#[cfg(feature = "nets")]
fn installed(names: &[&str]) -> Option<(&'static Entry, PathBuf)> {
    let store = Store::of_user().ok()?;
    names
        .iter()
        .filter_map(|name| weights::find(name).ok())
        .find_map(|entry| Some((entry, store.require(entry).ok()?)))
}

/// Whether weights of one of `names` are installed.
pub(crate) fn is_installed(names: &[&str]) -> bool {
    #[cfg(feature = "nets")]
    return installed(names).is_some();
    #[cfg(not(feature = "nets"))]
    {
        let _ = names;
        false
    }
}

/// The first of `names`, best first, whose weights are installed, and their file. Where there are
/// none and they are `required`, fails with how to get the best.
#[cfg(feature = "nets")]
pub(crate) fn network(
    names: &[&str],
    required: bool,
    method: NetworkMethod,
) -> Result<Option<(UsedNetwork, PathBuf)>, Error> {
    let Some((entry, path)) = installed(names) else {
        let best = names.first().filter(|_| required);
        return best.map_or(Ok(None), |name| {
            let absent = weights::find(name).and_then(|entry| Store::of_user()?.require(entry));
            let source = absent.err().unwrap_or(WeightsError::NoFolder);
            Err(NetworkError::Weights { method, source }.into())
        });
    };
    let used = UsedNetwork {
        weights: entry.name.to_owned(),
        licence: entry.licence.to_owned(),
        commercial: entry.commercial,
        blake3: crate::hash::of_path(&path)?,
    };
    Ok(Some((used, path)))
}

/// None of `names`, which this build cannot load; fails where one is `required`.
#[cfg(not(feature = "nets"))]
pub(crate) fn network(
    names: &[&str],
    required: bool,
    method: NetworkMethod,
) -> Result<Option<(UsedNetwork, PathBuf)>, Error> {
    match required && !names.is_empty() {
        true => Err(NetworkError::NotBuilt { method }.into()),
        false => Ok(None),
    }
}

/// The error of weights of `method` that cannot be loaded.
#[cfg(feature = "nets")]
pub(crate) fn unusable(method: NetworkMethod) -> impl Fn(LoadError) -> Error {
    move |source| {
        NetworkError::Load {
            method,
            source: Box::new(source),
        }
        .into()
    }
}
