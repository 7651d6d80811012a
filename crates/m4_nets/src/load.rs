//! Loads checkpoints, strictly.

use burn_store::{
    ApplyResult, KeyRemapper, ModuleSnapshot, ModuleStore, PyTorchToBurnAdapter, PytorchStore,
    SafetensorsStore,
};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Why a network could not be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// There is no such file.
    #[error("there is no file {}", path.display())]
    Missing {
        /// The path that was searched.
        path: PathBuf,
    },
    /// The file is no checkpoint that can be read.
    #[error("{} cannot be read as a checkpoint of {network}: {reason}; compare its checksum with the published one", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What was to be loaded.
        network: &'static str,
        /// What the reader says.
        reason: String,
    },
    /// The file is a checkpoint of something else.
    #[error("{} is not a checkpoint of {network}: {}", path.display(), differences(missing, unused, wrong))]
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

impl LoadError {
    /// [`LoadError::OtherNetwork`] of a file that lacks tensors or has wrong ones.
    pub(crate) fn misfit(
        network: &'static str,
        path: &Path,
        missing: &[&str],
        wrong: &[String],
    ) -> Self {
        Self::OtherNetwork {
            path: path.to_owned(),
            network,
            missing: missing.iter().map(|&name| name.to_owned()).collect(),
            unused: Vec::new(),
            wrong: wrong.to_vec(),
        }
    }
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

enum Store {
    Safetensors(Box<SafetensorsStore>),
    PyTorch(Box<PytorchStore>),
}

impl Store {
    /// The checkpoint at `path` under other names: safetensors where it begins as one, whatever its
    /// name, else PyTorch's.
    fn open(
        network: &'static str,
        path: &Path,
        renames: &[(&str, &str)],
    ) -> Result<Self, LoadError> {
        if !path.is_file() {
            return Err(LoadError::Missing {
                path: path.to_owned(),
            });
        }
        let names = KeyRemapper::from_patterns(renames.to_vec())
            .map_err(|error| unreadable(network, path, error.to_string()))?;
        let safetensors =
            is_safetensors(path).map_err(|error| unreadable(network, path, error.to_string()))?;
        Ok(if safetensors {
            let store = SafetensorsStore::from_file(path)
                .with_from_adapter(PyTorchToBurnAdapter)
                .remap(names)
                .map_indices_contiguous(false)
                .allow_partial(true)
                .validate(false);
            Self::Safetensors(Box::new(store))
        } else {
            let store = PytorchStore::from_file(path)
                .remap(names)
                .map_indices_contiguous(false)
                .allow_partial(true)
                .validate(false);
            Self::PyTorch(Box::new(store))
        })
    }
}

/// Whether the file begins as safetensors do, with the length of a JSON object of at most 100 MB.
fn is_safetensors(path: &Path) -> std::io::Result<bool> {
    let mut bytes = Vec::new();
    File::open(path)?.take(9).read_to_end(&mut bytes)?;
    let length = bytes
        .first_chunk()
        .map(|&length| u64::from_le_bytes(length));
    Ok(length.is_some_and(|n| n <= 100_000_000) && bytes.last() == Some(&b'{') && bytes.len() == 9)
}

fn unreadable(network: &'static str, path: &Path, reason: String) -> LoadError {
    LoadError::Unreadable {
        path: path.to_owned(),
        network,
        reason,
    }
}

pub(crate) type Shapes = BTreeMap<String, Vec<usize>>;

/// The shapes of the tensors of the checkpoint at `path`, by their names after `renames` (as
/// [`fill`] has them), without reading the numbers.
pub(crate) fn shapes(
    network: &'static str,
    path: &Path,
    renames: &[(&str, &str)],
) -> Result<Shapes, LoadError> {
    let tensors = |tensors: &BTreeMap<String, burn_store::burn_pack::Tensor>| -> Shapes {
        let shape = |t: &burn_store::burn_pack::Tensor| t.shape.to_vec();
        tensors
            .iter()
            .map(|(name, t)| (name.clone(), shape(t)))
            .collect()
    };
    match &mut Store::open(network, path, renames)? {
        Store::Safetensors(store) => store
            .get_all_tensors()
            .map(tensors)
            .map_err(|e| e.to_string()),
        Store::PyTorch(store) => store
            .get_all_tensors()
            .map(tensors)
            .map_err(|e| e.to_string()),
    }
    .map_err(|reason| unreadable(network, path, reason))
}

/// Fills `module` from the checkpoint at `path`, each tensor once and all of them: safetensors or
/// PyTorch's. `renames` are pairs of a regular expression and what it becomes, from the
/// checkpoint's names to the fields'; `unneeded` tells which tensors may be there without a field
/// (by the new names).
pub(crate) fn fill<M: ModuleSnapshot>(
    module: &mut M,
    network: &'static str,
    path: &Path,
    renames: &[(&str, &str)],
    unneeded: impl Fn(&str) -> bool,
) -> Result<(), LoadError> {
    let result = match &mut Store::open(network, path, renames)? {
        Store::Safetensors(store) => store.apply_to(module).map_err(|error| error.to_string()),
        Store::PyTorch(store) => store.apply_to(module).map_err(|error| error.to_string()),
    }
    .map_err(|reason| unreadable(network, path, reason))?;
    complete(result, network, path, unneeded)
}

/// Fills `module` with `tensors` of the file at `path`, whose names are the fields', each once and
/// all of them.
pub(crate) fn fill_with<M: ModuleSnapshot>(
    module: &mut M,
    network: &'static str,
    path: &Path,
    tensors: Vec<burn_store::burn_pack::Tensor>,
) -> Result<(), LoadError> {
    complete(
        module.apply(tensors, None, None, false),
        network,
        path,
        |_| false,
    )
}

/// Whether every field has its tensor and every tensor, but what is `unneeded`, its field.
fn complete(
    result: ApplyResult,
    network: &'static str,
    path: &Path,
    unneeded: impl Fn(&str) -> bool,
) -> Result<(), LoadError> {
    let unused: Vec<String> = result
        .unused
        .into_iter()
        .filter(|name| !unneeded(name))
        .collect();
    if result.missing.is_empty()
        && unused.is_empty()
        && result.errors.is_empty()
        && result.skipped.is_empty()
    {
        return Ok(());
    }
    Err(LoadError::OtherNetwork {
        path: path.to_owned(),
        network,
        missing: result.missing.into_iter().map(|(name, _)| name).collect(),
        unused,
        wrong: result.errors.iter().map(ToString::to_string).collect(),
    })
}
