//! The list of our files in a folder, for each kind of results.

use crate::{WriteError, atomic, files};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Component, Path, PathBuf};

/// The list of our files.
pub(super) const LIST: &str = ".minute4d-files.json";
/// Longest list that is read, bytes: a million names.
const MAX_LIST_BYTES: u64 = 64 << 20;
/// How names of our own hidden files start.
pub(super) const HIDDEN: &str = ".minute4d-";
/// How the name of a folder with complete new results ends.
pub(super) const DONE: &str = "-done";

/// The kind of results; a folder may contain several.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Kind {
    /// A trained scene with what belongs to it.
    Run,
    /// A capture.
    Capture,
    /// Rendered images.
    Render,
    /// A PLY file per frame.
    PlySequence,
    /// A COLMAP model.
    Colmap,
    /// Reports over several runs.
    Report,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Run => "run",
            Self::Capture => "capture",
            Self::Render => "render",
            Self::PlySequence => "ply-sequence",
            Self::Colmap => "colmap",
            Self::Report => "report",
        }
    }

    pub(super) fn of_name(name: &str) -> Option<Self> {
        let all = [
            Self::Run,
            Self::Capture,
            Self::Render,
            Self::PlySequence,
            Self::Colmap,
            Self::Report,
        ];
        all.into_iter().find(|kind| kind.name() == name)
    }

    pub(super) fn next(self, folder: &Path) -> PathBuf {
        folder.join(format!("{HIDDEN}{}-next", self.name()))
    }

    pub(super) fn done(self, folder: &Path) -> PathBuf {
        folder.join(format!("{HIDDEN}{}{DONE}", self.name()))
    }
}

/// Relative names, with `/`. One that ends in `/` is a folder of results with a list of its own.
pub(super) type Files = BTreeSet<String>;

#[derive(Serialize, Deserialize)]
struct List {
    format: String,
    files: BTreeMap<Kind, Files>,
}

/// The list of a folder; empty where it is missing or damaged. Names that lead out of the folder
/// are no names of ours.
fn list(folder: &Path) -> BTreeMap<Kind, Files> {
    let list: Option<List> = files::read(&folder.join(LIST), MAX_LIST_BYTES)
        .ok()
        .and_then(|text| serde_json::from_slice(&text).ok());
    let mut kinds = list.map(|list| list.files).unwrap_or_default();
    let inside = |name: &String| {
        Path::new(name)
            .components()
            .all(|part| matches!(part, Component::Normal(_)))
    };
    kinds.values_mut().for_each(|files| files.retain(inside));
    kinds
}

pub(super) fn files_of(folder: &Path, kind: Kind) -> Files {
    list(folder).remove(&kind).unwrap_or_default()
}

pub(super) fn write_list(folder: &Path, kind: Kind, files: &Files) -> Result<(), WriteError> {
    let path = folder.join(LIST);
    let mut kinds = list(folder);
    kinds.insert(kind, files.clone());
    let list = List {
        format: "minute4d-files".to_owned(),
        files: kinds,
    };
    let text = serde_json::to_vec_pretty(&list).map_err(|e| WriteError::io(&path, e.into()))?;
    atomic::write(&path, &text).map_err(|e| WriteError::io(&path, e))
}

/// The names with those of nested folders of results and their lists.
pub(super) fn expanded(folder: &Path, files: &Files) -> Files {
    let mut all = Files::new();
    for name in files {
        let Some(nested) = name.strip_suffix('/') else {
            all.insert(name.clone());
            continue;
        };
        let kinds = list(&folder.join(nested));
        if !kinds.is_empty() {
            all.insert(format!("{nested}/{LIST}"));
        }
        for own in kinds.values() {
            all.extend(
                expanded(&folder.join(nested), own)
                    .into_iter()
                    .map(|file| format!("{nested}/{file}")),
            );
        }
    }
    all
}

/// The names, with those of a nested folder of results as one.
pub(super) fn with_nested(mut names: Files) -> Files {
    let ending = format!("/{LIST}");
    let nested: Vec<String> = names
        .iter()
        .filter_map(|name| name.strip_suffix(&ending))
        .map(str::to_owned)
        .collect();
    for folder in nested {
        names.retain(|name| !is_below(name, Some(&folder)));
        names.insert(folder + "/");
    }
    names
}

pub(super) fn is_below(name: &str, folder: Option<&str>) -> bool {
    folder.is_some_and(|folder| {
        name.strip_prefix(folder)
            .is_some_and(|rest| rest.starts_with('/'))
    })
}

/// Which hidden files count.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Hidden {
    Passed,
    /// Lists of nested folders.
    Ours,
}

/// The files below a folder, relative, with `/`; links are files.
pub(super) fn listed(folder: &Path, hidden: Hidden) -> Result<Vec<String>, WriteError> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(|e| WriteError::io(folder, e))? {
        let entry = entry.map_err(|e| WriteError::io(folder, e))?;
        let kind = entry
            .file_type()
            .map_err(|e| WriteError::io(&entry.path(), e))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if name.starts_with('.') && (hidden == Hidden::Passed || name != LIST) {
            continue;
        }
        if kind.is_dir() {
            names.extend(
                listed(&entry.path(), hidden)?
                    .into_iter()
                    .map(|file| format!("{name}/{file}")),
            );
        } else {
            names.push(name);
        }
    }
    names.sort();
    Ok(names)
}
