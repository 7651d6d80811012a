//! Finds clips from files, folders and lists.

use crate::batch::error::BatchError;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Extensions of files in folders that are taken for videos; a file that is named itself may have any.
const VIDEOS: [&str; 15] = [
    "mp4", "mov", "m4v", "mkv", "webm", "avi", "mpg", "mpeg", "mts", "m2ts", "ts", "3gp", "wmv", "flv", "ogv",
];
/// Extensions of images: a folder of these is a clip.
const IMAGE_EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];
/// Lists of posed frames: a folder with one is a capture, and so a clip.
const CAPTURES: [&str; 2] = ["transforms_train.json", "transforms.json"];

/// The clips that a user named: files and folders, each once, with their whole paths.
///
/// # Errors
///
/// [`BatchError`] for what does not exist, holds nothing, or cannot be read.
pub(crate) fn inputs(given: &[String], recursive: bool) -> Result<Vec<PathBuf>, BatchError> {
    let mut paths = BTreeSet::new();
    for one in given {
        for path in expand(one)? {
            add(&path, recursive, &mut paths)?;
        }
    }
    Ok(paths.into_iter().collect())
}

/// Parses a list into its paths, without checking that they exist.
fn expand(given: &str) -> Result<Vec<PathBuf>, BatchError> {
    let Some(list) = given.strip_prefix('@') else {
        return match given.contains("://") {
            true => Err(BatchError::Input {
                given: given.to_owned(),
                reason: "is an address, not a path; mount the store as a folder, or download the clip first",
            }),
            false => Ok(vec![PathBuf::from(given)]),
        };
    };
    let path = Path::new(list);
    let text = fs::read_to_string(path).map_err(BatchError::read(path))?;
    let lines = text.lines().map(str::trim);
    let lines = lines.filter(|l| !l.is_empty() && !l.starts_with(['#', '@']));
    let mut all = Vec::new();
    for line in lines {
        all.extend(expand(line)?);
    }
    match all.is_empty() {
        true => Err(nothing(given, true)),
        false => Ok(all),
    }
}

fn nothing(given: &str, recursive: bool) -> BatchError {
    BatchError::Input {
        given: given.to_owned(),
        reason: match recursive {
            true => "holds no video",
            false => "holds no video; --recursive looks into folders in it",
        },
    }
}

fn add(path: &Path, recursive: bool, found: &mut BTreeSet<PathBuf>) -> Result<(), BatchError> {
    // `canonicalize` follows links, so that a clip that is named twice is one clip.
    let path = fs::canonicalize(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound | std::io::ErrorKind::NotADirectory => BatchError::Missing {
            path: path.to_path_buf(),
        },
        _ => BatchError::read(path)(e),
    })?;
    if !path.is_dir() {
        found.insert(path);
        return Ok(());
    }
    let clips = clips_of(&path, recursive)?;
    if clips.is_empty() {
        return Err(nothing(&path.display().to_string(), recursive));
    }
    found.extend(clips);
    Ok(())
}

/// The clips in a folder, or the folder itself where it is one.
fn clips_of(folder: &Path, recursive: bool) -> Result<Vec<PathBuf>, BatchError> {
    let (mut videos, mut folders, mut images) = (Vec::new(), Vec::new(), false);
    for entry in fs::read_dir(folder).map_err(BatchError::read(folder))? {
        let path = entry.map_err(BatchError::read(folder))?.path();
        let name = path
            .file_name()
            .map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        if name.starts_with('.') {
            continue;
        }
        if CAPTURES.contains(&name.as_str()) {
            return Ok(vec![folder.to_path_buf()]);
        }
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        if path.is_dir() {
            folders.push(path);
        } else if extension.as_deref().is_some_and(|e| VIDEOS.contains(&e)) {
            videos.push(fs::canonicalize(&path).map_err(BatchError::read(&path))?);
        } else {
            images |= extension.as_deref().is_some_and(|e| IMAGE_EXTENSIONS.contains(&e));
        }
    }
    if videos.is_empty() && images {
        return Ok(vec![folder.to_path_buf()]);
    }
    if recursive {
        for inner in folders {
            videos.extend(clips_of(&inner, recursive)?);
        }
    }
    Ok(videos)
}

#[cfg(test)]
mod tests {
    use super::inputs;
    use std::fs;
    use std::path::Path;

    fn touch(path: &Path) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "x").unwrap();
    }

    #[test]
    fn files_folders_and_lists_are_found_once() {
        let dir = tempfile::tempdir().unwrap();
        let root = fs::canonicalize(dir.path()).unwrap();
        let at = |name: &str| root.join(name).to_str().unwrap().to_owned();
        for name in [
            "v/b.mp4",
            "v/a.MOV",
            "v/notes.txt",
            "v/.c.mp4",
            "v/in/d.mkv",
            "v/pics/1.png",
            "v/cap/transforms.json",
        ] {
            touch(&root.join(name));
        }
        let found = |given: &[String], recursive: bool| -> Vec<String> {
            let all = inputs(given, recursive).unwrap();
            all.iter()
                .map(|p| p.strip_prefix(&root).unwrap().display().to_string().replace('\\', "/"))
                .collect()
        };
        assert_eq!(found(&[at("v")], false), ["v/a.MOV", "v/b.mp4"]);
        let all = ["v/a.MOV", "v/b.mp4", "v/cap", "v/in/d.mkv", "v/pics"];
        assert_eq!(found(&[at("v")], true), all);
        assert_eq!(found(&[at("v/pics")], false), ["v/pics"], "images are a clip");
        assert_eq!(found(&[at("v/b.mp4"), at("v/in/../b.mp4")], false), ["v/b.mp4"]);
        assert_eq!(
            found(&[at("v/notes.txt")], false),
            ["v/notes.txt"],
            "a named file is always a clip"
        );
        fs::write(
            root.join("list"),
            format!("# clips\n{}\n\n{}\n", at("v/b.mp4"), at("v/in")),
        )
        .unwrap();
        assert_eq!(found(&[format!("@{}", at("list"))], false), ["v/b.mp4", "v/in/d.mkv"]);

        let message = |given: &str| inputs(&[given.to_owned()], false).unwrap_err().to_string();
        assert!(message(&at("none.mp4")).contains("there is no"));
        fs::create_dir(root.join("empty")).unwrap();
        assert!(message(&at("empty")).contains("--recursive"));
    }

    #[test]
    fn urls_are_refused_as_inputs() {
        let message = inputs(&["s3://bucket/a.mp4".to_owned()], false).unwrap_err();
        assert!(message.to_string().contains("mount the store"), "{message}");
    }
}
