//! Fetches weights from where their authors publish them, and adds files of the user's.

use super::download::{Download, Served};
use super::network::Network;
use super::store::Source;
use super::{Condition, Entry, Origin, Record, Store, WeightsError};
use crate::{Category, Refusal};
use m4_core::Progress;
use m4_core::advice::LICENCE;
use m4_io::files;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Refuses weights that forbid commercial use unless the user accepted it.
///
/// # Errors
///
/// [`WeightsError::Refused`] then.
pub fn check_licence(entry: &Entry, accepted: bool) -> Result<(), WeightsError> {
    if entry.commercial || accepted {
        return Ok(());
    }
    let (name, licence) = (entry.name, entry.licence);
    Err(Refusal::usage(format!(
        "the licence of {name} ({licence}) does not allow commercial use; read it, and {LICENCE} if you agree"
    ))
    .into())
}

/// Downloads `entry`, compares it with what was published, and installs it; what is here already
/// and right is left as it is, without a network. Of two processes one waits for the other.
///
/// # Errors
///
/// [`WeightsError`] if its licence was not accepted, the network is switched off, the host refuses
/// or is not reached, the disk is full, what comes is not what was published, or `progress` is
/// cancelled. What was installed is then as it was, and what has arrived is kept for the next call
/// unless it is wrong.
pub fn fetch(
    entry: &Entry,
    store: &Store,
    network: &Network,
    accept_licence: bool,
    progress: &dyn Progress,
) -> Result<Record, WeightsError> {
    check_licence(entry, accept_licence)?;
    if let Some(record) = intact(entry, store) {
        return Ok(record);
    }
    if network.offline {
        let (name, megabytes, url) = (entry.name, entry.megabytes, network.url(&entry.origin));
        let message = format!(
            "HF_HUB_OFFLINE switches the network off; without it {name} (about {megabytes} MB) would come from {url}"
        );
        return Err(Refusal::new(Category::NoInput, message).into());
    }
    let scratch = store.scratch(entry, progress)?;
    // another process may have installed it meanwhile
    if let Some(record) = intact(entry, store) {
        return Ok(record);
    }
    let download = Download {
        entry,
        network,
        folder: scratch.folder(),
        progress,
    };
    let outcome = download
        .run()
        .and_then(|served| install(entry, store, &download, served));
    if matches!(&outcome, Ok(_) | Err(WeightsError::Damaged(_))) {
        scratch.remove();
    }
    outcome
}

/// The record of `entry` where its file is as it was published or recorded.
fn intact(entry: &Entry, store: &Store) -> Option<Record> {
    let condition = store.verify(entry).ok()?;
    store
        .record(entry)
        .filter(|_| matches!(condition, Condition::Published | Condition::AsAdded))
}

fn install(
    entry: &Entry,
    store: &Store,
    download: &Download<'_>,
    served: Served,
) -> Result<Record, WeightsError> {
    let source = Source {
        description: entry.origin.description(),
        commit: served.commit,
        sha256: served.sha256,
    };
    match entry.origin {
        Origin::Archive { member, .. } => {
            take_member(entry, store, &download.part(), member, source)
        }
        Origin::HuggingFace { .. } | Origin::GitHub { .. } => {
            store.adopt(entry, &download.part(), source)
        }
    }
}

/// Installs the file `member` of the zip archive at `path`.
fn take_member(
    entry: &Entry,
    store: &Store,
    path: &Path,
    member: &str,
    source: Source,
) -> Result<Record, WeightsError> {
    let damaged = |reason: String| {
        WeightsError::Damaged(format!(
            "the archive {} cannot be used for {}: {reason}; nothing was installed, try again",
            source.description, entry.name
        ))
    };
    let file = File::open(path).map_err(|error| damaged(error.to_string()))?;
    let mut archive =
        zip::ZipArchive::new(BufReader::new(file)).map_err(|error| damaged(error.to_string()))?;
    let names: Vec<String> = archive
        .file_names()
        .filter_map(|name| Some(name.ok()?.into_owned()))
        .filter(|name| name.rsplit('/').next() == Some(member))
        .collect();
    let [name] = names.as_slice() else {
        let n = names.len();
        return Err(damaged(format!(
            "{n} files in it are named {member}, not one"
        )));
    };
    let contents = archive
        .by_name(name)
        .map_err(|error| damaged(error.to_string()))?;
    let result = store.take(entry, contents, &source.description, &source);
    result.map_err(|error| match error {
        // of the archive, not of a file of the user's
        WeightsError::Read { source, .. } => damaged(source.to_string()),
        other => other,
    })
}

/// Copies the file at `path` into the store as `entry`.
///
/// # Errors
///
/// [`WeightsError`] if its licence was not accepted, the file cannot be read, or is not what was
/// published.
pub fn add(
    entry: &Entry,
    store: &Store,
    path: &Path,
    accept_licence: bool,
) -> Result<Record, WeightsError> {
    check_licence(entry, accept_licence)?;
    let file = files::open(path).map_err(WeightsError::read(path))?;
    let source = Source {
        description: "a file of the user's".to_owned(),
        ..Source::default()
    };
    store.take(entry, file, &path.display().to_string(), &source)
}
