//! Names of the files of results, and what may happen to those that exist.

use crate::Error;
use m4_io::capture::{Split, TRACKS_FILE};
use m4_io::results::{self, Kind, ResultFolder};
use std::fs;
use std::io::ErrorKind;
use std::path::Path;

/// The trained scene.
pub const SCENE_FILE: &str = "scene.safetensors";
/// The metrics of training, one JSON object per line.
pub const METRICS_FILE: &str = "metrics.jsonl";
/// Source, re-render and frozen time side by side.
pub const PREVIEW_FILE: &str = "preview.mp4";
/// The page that shows the scene in a browser.
pub const VIEWER_FILE: &str = "viewer.html";
/// Scores over the held-out views.
pub const EVAL_FILE: &str = "eval.json";
/// A frame and its re-render, for overviews.
pub const POSTER_FILE: &str = "poster.jpg";
/// The record of how a capture was made.
pub const GEOMETRY_FILE: &str = "geometry.json";
/// The objects of a capture, beside its list of frames.
pub const OBJECTS_FILE: &str = "instances.json";
/// Published masks of co-visibility in a capture.
pub const COVISIBLE_FOLDER: &str = "covisible";
/// The capture that `run` makes of a video.
pub const CAPTURE_FOLDER: &str = "capture";
/// Scenes saved during training.
pub const CHECKPOINT_FOLDER: &str = "checkpoints";

/// What to do with a folder that is not empty.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Existing {
    /// Leave the folder unchanged and fail.
    #[default]
    Refuse,
    /// Resume an earlier run.
    Resume,
    /// Replace the results of an earlier run once the new ones are complete; other files are kept.
    Force,
}

/// Ends a replacement of results that was interrupted where `path` is a folder of results, or a
/// file in one; for who reads it.
pub fn settle(path: &Path) -> Result<(), Error> {
    let folder = if path.is_dir() {
        Some(path)
    } else {
        path.parent()
    };
    Ok(folder.map_or(Ok(()), results::settle)?)
}

/// Lets files of these names be written: refuses those that are not ours.
pub fn claim(folder: &Path, kind: Kind, names: &[&str]) -> Result<(), Error> {
    Ok(ResultFolder::open(folder, kind)?.claim(names.iter().copied())?)
}

/// True for a folder with a list of posed frames, or such a list itself.
#[must_use]
pub fn is_capture(path: &Path) -> bool {
    let listed = ["transforms_train.json", "transforms.json"];
    listed.iter().any(|name| path.join(name).is_file())
        || path.extension().is_some_and(|e| e == "json")
}

/// The names that a capture may use in its folder: its record, and those of the splits that are
/// written.
pub fn capture_names() -> impl Iterator<Item = &'static str> + Clone {
    let of = |split: Split| split.folders().into_iter().chain([split.file_name()]);
    [GEOMETRY_FILE, TRACKS_FILE, OBJECTS_FILE, COVISIBLE_FOLDER]
        .into_iter()
        .chain(of(Split::Train))
        .chain(of(Split::Test))
}

/// Removes a file that may be missing.
pub fn remove_file(path: &Path) -> Result<(), Error> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(Error::write(path)(error)),
        _ => Ok(()),
    }
}
