//! Plans a manifest from the files and folders that a user names.

use crate::batch::layout::{self, Layout};
use crate::batch::manifest::{Arguments, Job, Manifest};
use crate::batch::not_ours;
use crate::batch::publish::{Present, present};
use m4_core::Progress;
use m4_io::files;
use minute4d::{Category, Error, Refusal, hash};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::{fs, io};

/// Lists the clips among the files and folders `given`, and in folders of these if `recursive`,
/// with their hashes and in the order of their ids; `run` is what every run is started with. Makes
/// the folder of `results`.
///
/// # Errors
///
/// [`Error::Read`], [`Error::Write`]; [`Error::Refused`] for what is no clip; [`Error::Stopped`].
pub fn plan(
    given: &[String],
    recursive: bool,
    results: &Path,
    run: Arguments,
    watch: &dyn Progress,
) -> Result<Manifest, Error> {
    let paths = inputs(given, recursive)?;
    let mut named = Vec::with_capacity(paths.len());
    for path in &paths {
        named.push((name(path), text(path)?));
    }
    let ids = layout::ids(&named);
    let layout = Layout::new(results);
    for id in &ids {
        let result = layout.result(id);
        if present(&result, "")? == Present::NotOurs {
            return Err(not_ours(&result).into());
        }
    }
    let mut jobs = Vec::with_capacity(named.len());
    for (((_, input), id), path) in named.into_iter().zip(ids).zip(paths) {
        jobs.push(Job {
            output: text(&layout.result(&id))?,
            id,
            input,
            blake3: hash::of_input(&path, None, watch)?,
        });
    }
    jobs.sort_by(|a, b| a.id.cmp(&b.id));
    let states = layout.states();
    fs::create_dir_all(&states).map_err(Error::write(&states))?;
    Ok(Manifest {
        results: text(results)?,
        run,
        jobs,
    })
}

fn text(path: &Path) -> Result<String, Refusal> {
    path.to_str().map(str::to_owned).ok_or_else(|| {
        Refusal::bad_input(format!(
            "{} is not UTF-8, which a manifest cannot hold; rename it",
            path.display()
        ))
    })
}

/// The name of a clip: that of its file without the extension, or of its folder.
fn name(path: &Path) -> String {
    let name = if path.is_dir() {
        path.file_name()
    } else {
        path.file_stem()
    };
    name.map_or_else(String::new, |n| n.to_string_lossy().into_owned())
}

/// Extensions of files in folders that are taken for videos; a file that is named itself may have
/// any.
const VIDEOS: [&str; 15] = [
    "mp4", "mov", "m4v", "mkv", "webm", "avi", "mpg", "mpeg", "mts", "m2ts", "ts", "3gp", "wmv",
    "flv", "ogv",
];
/// Extensions of images: a folder of these is a clip.
const IMAGE_EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];
/// Lists of posed frames: a folder with one is a capture, and so a clip.
const CAPTURES: [&str; 2] = ["transforms_train.json", "transforms.json"];

/// The clips that a user named: files and folders, each once, with their whole paths.
pub(crate) fn inputs(arguments: &[String], recursive: bool) -> Result<Vec<PathBuf>, Error> {
    let mut paths = BTreeSet::new();
    for one in arguments {
        if one.contains("://") {
            let what = "is an address, not a path; mount the store as a folder, or download the clip first";
            return Err(Refusal::bad_input(format!("{one} {what}")).into());
        }
        add(Path::new(one), recursive, &mut paths)?;
    }
    Ok(paths.into_iter().collect())
}

fn nothing(argument: &str, recursive: bool) -> Refusal {
    let hint = if recursive {
        ""
    } else {
        "; --recursive looks into folders in it"
    };
    Refusal::bad_input(format!("{argument} holds no video{hint}"))
}

fn add(path: &Path, recursive: bool, files: &mut BTreeSet<PathBuf>) -> Result<(), Error> {
    // `canonicalize` follows links, so that a clip that is named twice is one clip.
    let path = fs::canonicalize(path).map_err(|e| match e.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => {
            let message = format!("there is no video or folder at {}", path.display());
            Refusal::new(Category::NoInput, message).into()
        }
        _ => Error::read(path)(e),
    })?;
    if !path.is_dir() {
        files::check(&path).map_err(Error::read(&path))?;
        files.insert(path);
        return Ok(());
    }
    let clips = clips_of(&path, recursive)?;
    if clips.is_empty() {
        return Err(nothing(&path.display().to_string(), recursive).into());
    }
    files.extend(clips);
    Ok(())
}

/// The clips in a folder, or the folder itself where it is one.
fn clips_of(folder: &Path, recursive: bool) -> Result<Vec<PathBuf>, Error> {
    let (mut videos, mut folders, mut images) = (Vec::new(), Vec::new(), false);
    for entry in fs::read_dir(folder).map_err(Error::read(folder))? {
        let path = entry.map_err(Error::read(folder))?.path();
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
            files::check(&path).map_err(Error::read(&path))?;
            videos.push(fs::canonicalize(&path).map_err(Error::read(&path))?);
        } else {
            images |= extension
                .as_deref()
                .is_some_and(|e| IMAGE_EXTENSIONS.contains(&e));
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
    fn files_and_folders_are_found_once() {
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
        let names = |arguments: &[String], recursive: bool| -> Vec<String> {
            let all = inputs(arguments, recursive).unwrap();
            all.iter()
                .map(|p| {
                    p.strip_prefix(&root)
                        .unwrap()
                        .display()
                        .to_string()
                        .replace('\\', "/")
                })
                .collect()
        };
        assert_eq!(names(&[at("v")], false), ["v/a.MOV", "v/b.mp4"]);
        let all = ["v/a.MOV", "v/b.mp4", "v/cap", "v/in/d.mkv", "v/pics"];
        assert_eq!(names(&[at("v")], true), all);
        assert_eq!(
            names(&[at("v/pics")], false),
            ["v/pics"],
            "images are a clip"
        );
        assert_eq!(
            names(&[at("v/b.mp4"), at("v/in/../b.mp4")], false),
            ["v/b.mp4"]
        );
        assert_eq!(
            names(&[at("v/notes.txt")], false),
            ["v/notes.txt"],
            "a named file is always a clip"
        );
        assert_eq!(
            names(&[at("v/b.mp4"), at("v/in")], false),
            ["v/b.mp4", "v/in/d.mkv"]
        );

        let message = |argument: &str| {
            inputs(&[argument.to_owned()], false)
                .unwrap_err()
                .to_string()
        };
        assert!(message(&at("none.mp4")).contains("there is no"));
        fs::create_dir(root.join("empty")).unwrap();
        assert!(message(&at("empty")).contains("--recursive"));
    }
}
