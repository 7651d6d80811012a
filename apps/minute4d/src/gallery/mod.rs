//! A page of many scenes: a preview of each and a link to its viewer.
//!
//! The page lies in the folder of the scenes and refers to their files by relative addresses, so
//! that the folder can be opened from a disk or copied to any web host as it is.

use crate::run::record::RUN_FILE;
use m4_viewer::html::{address, escape, fill};
use minute4d::json::read_json;
use minute4d::layout::{PREVIEW_FILE, VIEWER_FILE};
use minute4d::{Error, Refusal};
use serde::Serialize;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Name of the page.
pub const PAGE_FILE: &str = "index.html";
/// Folders within folders that are searched: what `batch` and people make.
const DEPTH: usize = 3;

/// A scene of the gallery.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Entry {
    /// The folders from that of the page to that of the scene.
    pub folders: Vec<String>,
    /// Whether the scene has a preview.
    pub preview: bool,
    /// Number of splats, by the record of the run.
    pub splats: Option<u64>,
    /// Size of the viewer page, bytes.
    pub viewer_bytes: u64,
}

/// Lists the scenes in `root`, each folder with a viewer page, in the order of their names.
///
/// # Errors
///
/// A folder or record that cannot be read; no scene.
pub fn list(root: &Path) -> Result<Vec<Entry>, Error> {
    let mut entries = Vec::new();
    search(root, &mut Vec::new(), &mut entries)?;
    if entries.is_empty() {
        return Err(Refusal::bad_input(format!(
            "{} has no scenes: a folder with {VIEWER_FILE} is one, as `minute4d run` writes it",
            root.display()
        ))
        .into());
    }
    Ok(entries)
}

fn search(folder: &Path, names: &mut Vec<String>, entries: &mut Vec<Entry>) -> Result<(), Error> {
    let mut inner = Vec::new();
    for item in fs::read_dir(folder).map_err(Error::read(folder))? {
        let item = item.map_err(Error::read(folder))?;
        // A name that is no Unicode has no address.
        let name = item.file_name().into_string().ok();
        if let Some(name) = name.filter(|name| !name.starts_with('.'))
            && item.path().is_dir()
        {
            inner.push(name);
        }
    }
    inner.sort();
    for name in inner {
        let path = folder.join(&name);
        names.push(name);
        if let Ok(viewer) = fs::metadata(path.join(VIEWER_FILE)) {
            entries.push(entry(&path, names, viewer.len())?);
        } else if names.len() < DEPTH {
            search(&path, names, entries)?;
        }
        names.pop();
    }
    Ok(())
}

fn entry(path: &Path, names: &[String], viewer_bytes: u64) -> Result<Entry, Error> {
    let record = read_json::<Value>(&path.join(RUN_FILE))?.unwrap_or_default();
    let count = |kind: &str| record["splats"][kind].as_u64();
    Ok(Entry {
        folders: names.to_vec(),
        preview: path.join(PREVIEW_FILE).is_file(),
        splats: count("static").zip(count("dynamic")).map(|(a, b)| a + b),
        viewer_bytes,
    })
}

/// Returns the page of `entries`.
pub fn page(entries: &[Entry], title: &str) -> String {
    let count = match entries.len() {
        1 => "1 scene".to_owned(),
        n => format!("{n} scenes"),
    };
    fill(include_str!("page.html"), |name| match name {
        "title" => escape(title),
        "count" => count.clone(),
        "scenes" => entries.iter().map(card).collect(),
        _ => String::new(),
    })
}

fn card(entry: &Entry) -> String {
    let file = |name| address(entry.folders.iter().map(String::as_str).chain([name]));
    let preview = match entry.preview {
        true => format!(
            "<video src=\"{}\" muted loop playsinline preload=\"metadata\"></video>",
            file(PREVIEW_FILE)
        ),
        false => "<div class=\"none\"></div>".to_owned(),
    };
    let splats = entry
        .splats
        .map_or_else(String::new, |n| format!("{n} splats, "));
    format!(
        "<a href=\"{}\">{preview}<h2>{}</h2><p>{splats}{:.1} MB</p></a>\n",
        file(VIEWER_FILE),
        escape(&entry.folders.join(" / ")),
        entry.viewer_bytes as f64 / 1e6
    )
}
