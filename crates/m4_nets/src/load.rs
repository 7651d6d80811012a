//! Checkpoints, read strictly.

use burn_store::{KeyRemapper, ModuleSnapshot, ModuleStore, PyTorchToBurnAdapter, PytorchStore, SafetensorsStore};
use std::path::{Path, PathBuf};

/// Why a network could not be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// There is no such file.
    #[error("there is no file {}; `minute4d weights list` says where weights come from", path.display())]
    Missing {
        /// Where it was looked for.
        path: PathBuf,
    },
    /// The file is no checkpoint that can be read.
    #[error("{} cannot be read as a checkpoint of {network}: {reason}; `minute4d weights verify` compares it with what was published", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What was to be loaded.
        network: &'static str,
        /// What the reader says.
        reason: String,
    },
    /// The file is a checkpoint of something else.
    #[error("{} is no checkpoint of {network}: {}", path.display(), differences(missing, unused, wrong))]
    OtherNetwork {
        /// The file.
        path: PathBuf,
        /// What was to be loaded.
        network: &'static str,
        /// Tensors that it lacks.
        missing: Vec<String>,
        /// Tensors that the network has no place for.
        unused: Vec<String>,
        /// Tensors of another shape or type.
        wrong: Vec<String>,
    },
}

fn differences(missing: &[String], unused: &[String], wrong: &[String]) -> String {
    let named = |what: &str, names: &[String]| {
        let first = names.iter().take(3).cloned().collect::<Vec<_>>().join(", ");
        let more = if names.len() > 3 { ", ..." } else { "" };
        (!names.is_empty()).then(|| format!("{} {what} ({first}{more})", names.len()))
    };
    [
        named("tensors are missing", missing),
        named("tensors are not known", unused),
        named("tensors do not fit", wrong),
    ]
    .into_iter()
    .flatten()
    .collect::<Vec<_>>()
    .join(", ")
}

/// Fills `module` from the checkpoint at `path`, each tensor once and all of them: safetensors where the name ends so, else
/// PyTorch's. `renames` are pairs of a regular expression and what it becomes, from the checkpoint's names to the fields'.
///
/// # Errors
///
/// [`LoadError`] if the file cannot be read or its tensors are not exactly those of `module`.
pub(crate) fn fill<M: ModuleSnapshot>(
    module: &mut M,
    network: &'static str,
    path: &Path,
    renames: &[(&str, &str)],
) -> Result<(), LoadError> {
    if !path.is_file() {
        return Err(LoadError::Missing { path: path.to_owned() });
    }
    let unreadable = |reason: String| LoadError::Unreadable {
        path: path.to_owned(),
        network,
        reason,
    };
    let names = KeyRemapper::from_patterns(renames.to_vec()).map_err(|error| unreadable(error.to_string()))?;
    let result = if path.extension().is_some_and(|end| end == "safetensors") {
        let mut store = SafetensorsStore::from_file(path)
            .with_from_adapter(PyTorchToBurnAdapter)
            .remap(names)
            .map_indices_contiguous(false)
            .allow_partial(true)
            .validate(false);
        store.apply_to(module).map_err(|error| unreadable(error.to_string()))?
    } else {
        let mut store = PytorchStore::from_file(path)
            .remap(names)
            .map_indices_contiguous(false)
            .allow_partial(true)
            .validate(false);
        store.apply_to(module).map_err(|error| unreadable(error.to_string()))?
    };
    if result.missing.is_empty() && result.unused.is_empty() && result.errors.is_empty() && result.skipped.is_empty() {
        return Ok(());
    }
    Err(LoadError::OtherNetwork {
        path: path.to_owned(),
        network,
        missing: result.missing.into_iter().map(|(name, _)| name).collect(),
        unused: result.unused,
        wrong: result.errors.iter().map(ToString::to_string).collect(),
    })
}
