//! Folders of results.

use super::list::{LIST, files_of, write_list};
use super::{Kind, ResultFolder, check_target, settle};
use crate::{ErrorKind, WriteFault};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

fn write(folder: &Path, name: &str, text: &str) {
    let path = folder.join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, text).unwrap();
}

/// The files in a folder that are not hidden, with their texts.
fn state(folder: &Path) -> Vec<(String, String)> {
    let mut all = Vec::new();
    let mut open = vec![PathBuf::new()];
    while let Some(at) = open.pop() {
        for entry in fs::read_dir(folder.join(&at)).unwrap() {
            let entry = entry.unwrap();
            let name = at.join(entry.file_name());
            if entry.file_name().to_string_lossy().starts_with('.') {
                continue;
            }
            if entry.file_type().unwrap().is_dir() {
                open.push(name);
            } else {
                all.push((
                    name.to_string_lossy().into_owned(),
                    fs::read_to_string(entry.path()).unwrap(),
                ));
            }
        }
    }
    all.sort();
    all
}

fn commit(folder: &Path, new: &[(&str, &str)]) {
    let mut results = ResultFolder::open(folder, Kind::Capture).unwrap();
    let next = results.begin().unwrap();
    new.iter().for_each(|(name, text)| write(&next, name, text));
    results.commit(None).unwrap();
}

fn owned(list: &[(&str, &str)]) -> Vec<(String, String)> {
    list.iter()
        .map(|(name, text)| ((*name).to_owned(), (*text).to_owned()))
        .collect()
}

const OLD: [(&str, &str); 3] = [("depth/0", "old"), ("list", "old"), ("train/0", "old")];
const NEW: [(&str, &str); 3] = [("list", "new"), ("train/0", "new"), ("train/1", "new")];

#[test]
fn commit_replaces_our_files_and_no_others() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), "depth/thesis.txt", "mine");
    commit(dir.path(), &OLD);
    write(dir.path(), "train/notes.txt", "mine");
    let all = [
        &OLD[..1],
        &[("depth/thesis.txt", "mine")],
        &OLD[1..],
        &[("train/notes.txt", "mine")],
    ]
    .concat();
    assert_eq!(state(dir.path()), owned(&all));
    commit(dir.path(), &NEW);
    let all = [
        &[("depth/thesis.txt", "mine")],
        &NEW[..],
        &[("train/notes.txt", "mine")],
    ]
    .concat();
    assert_eq!(state(dir.path()), owned(&all));
    // Other kinds of results are not touched, nor may they be replaced.
    let mut other = ResultFolder::open(dir.path(), Kind::Render).unwrap();
    let next = other.begin().unwrap();
    write(&next, "0.png", "image");
    other.commit(None).unwrap();
    assert_eq!(state(dir.path()).len(), 6);
    write(&other.begin().unwrap(), "list", "image");
    assert!(matches!(
        other.commit(None).unwrap_err().fault,
        WriteFault::Foreign
    ));
    drop(other);
    commit(dir.path(), &NEW);
    assert_eq!(state(dir.path()).len(), 6);
}

#[test]
fn foreign_files_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), "train/7", "mine");
    write(dir.path(), "list", "mine");
    let mut results = ResultFolder::open(dir.path(), Kind::Capture).unwrap();
    assert!(!results.is_empty());
    for (name, file) in [("train", "train/7"), ("list", "list")] {
        let error = results.check_free([name]).unwrap_err();
        assert!(
            error.kind() == ErrorKind::CannotWrite && error.path.ends_with(file),
            "{error}"
        );
        assert!(results.claim([name]).is_err());
    }
    results.check_free(["depth"]).unwrap();
    write(&results.begin().unwrap(), "train/7", "new");
    assert!(results.commit(None).unwrap_err().path.ends_with("train/7"));
    assert_eq!(fs::read(dir.path().join("train/7")).unwrap(), b"mine");
}

#[test]
fn replacements_that_were_interrupted_anywhere_are_completed() {
    let dir = tempfile::tempdir().unwrap();
    // As many steps of the last part as were done, with or without the list of old and new files.
    for moved in 0..=NEW.len() {
        for listed in [false, true] {
            let folder = dir.path().join(format!("{moved}-{listed}"));
            commit(&folder, &OLD);
            let mut results = ResultFolder::open(&folder, Kind::Capture).unwrap();
            let next = results.begin().unwrap();
            NEW.iter().for_each(|(name, text)| write(&next, name, text));
            // as a killed process leaves them
            results.keep();
            drop(results);
            // Until here the old results are whole, and opening the folder changes nothing.
            settle(&folder).unwrap();
            assert_eq!(state(&folder), owned(&OLD));
            let names: BTreeSet<String> = NEW.iter().map(|(name, _)| (*name).to_owned()).collect();
            write_list(&next, Kind::Capture, &names).unwrap();
            let done = Kind::Capture.done(&folder);
            fs::rename(&next, &done).unwrap();
            if moved > 0 || listed {
                let both = files_of(&folder, Kind::Capture)
                    .union(&names)
                    .cloned()
                    .collect();
                write_list(&folder, Kind::Capture, &both).unwrap();
            }
            for (name, _) in &NEW[..moved] {
                fs::create_dir_all(folder.join(name).parent().unwrap()).unwrap();
                fs::rename(done.join(name), folder.join(name)).unwrap();
            }
            settle(&folder).unwrap();
            assert_eq!(state(&folder), owned(&NEW), "{moved} {listed}");
            assert_eq!(files_of(&folder, Kind::Capture), names);
            assert!(!done.exists() && !folder.join("depth").exists());
        }
    }
}

#[test]
fn results_that_are_not_completed_leave_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("out");
    let mut results = ResultFolder::open(&folder, Kind::Render).unwrap();
    write(&results.begin().unwrap(), "0.png", "image");
    drop(results);
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    commit(&folder, &OLD);
    let mut results = ResultFolder::open(&folder, Kind::Capture).unwrap();
    let next = results.begin().unwrap();
    write(&next, "list", "new");
    drop(results);
    assert!(!next.exists() && state(&folder) == owned(&OLD));
}

#[test]
fn nested_results_go_and_stay_with_the_folder() {
    let dir = tempfile::tempdir().unwrap();
    let mut run = ResultFolder::open(dir.path(), Kind::Run).unwrap();
    run.claim(["scene", "capture/"]).unwrap();
    write(dir.path(), "scene", "old");
    commit(&dir.path().join("capture"), &OLD);
    write(dir.path(), "capture/mine", "mine");
    run.check_free(["scene", "capture/"]).unwrap();
    // The old files are the first new ones, until others replace them.
    let next = run.begin_with_old().unwrap();
    assert_eq!(fs::read(next.join("capture/train/0")).unwrap(), b"old");
    commit(&next.join("capture"), &NEW);
    assert_eq!(
        fs::read(dir.path().join("capture/train/0")).unwrap(),
        b"old"
    );
    run.commit(None).unwrap();
    assert_eq!(
        fs::read(dir.path().join("capture/train/1")).unwrap(),
        b"new"
    );
    assert!(!dir.path().join("capture/depth").exists() && run.names("capture/"));
    // The folder of an input keeps its files.
    write(&run.begin().unwrap(), "scene", "new");
    run.commit(Some("capture")).unwrap();
    assert_eq!(state(dir.path()).len(), 5);
    write(&run.begin().unwrap(), "scene", "newer");
    run.commit(None).unwrap();
    assert_eq!(
        state(dir.path()),
        owned(&[("capture/mine", "mine"), ("scene", "newer")])
    );
}

#[cfg(unix)]
#[test]
fn inputs_and_links_are_not_replaced() {
    use std::os::unix::fs::symlink;
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    write(dir.path(), "images/0", "mine");
    commit(&at("cap"), &OLD);
    let results = ResultFolder::open(&at("cap"), Kind::Capture).unwrap();
    symlink(at("cap"), at("alias")).unwrap();
    for input in ["cap/train", "cap/train/0", "alias/train", "cap/../cap/list"] {
        let error = results
            .check_inputs(["train", "list"], &[&at(input)])
            .unwrap_err();
        assert!(matches!(error.fault, WriteFault::Input), "{input}");
    }
    assert!(results.check_not_itself(&[&at("alias")]).is_err());
    results
        .check_inputs(["train", "list"], &[&at("images"), &at("cap/depth")])
        .unwrap();
    drop(results);
    // A folder of ours that became a link: nothing behind it is touched.
    fs::rename(at("cap/depth"), at("elsewhere")).unwrap();
    symlink(at("elsewhere"), at("cap/depth")).unwrap();
    commit(&at("cap"), &NEW);
    assert_eq!(fs::read(at("elsewhere/0")).unwrap(), b"old");
    let mut results = ResultFolder::open(&at("cap"), Kind::Capture).unwrap();
    write(&results.begin().unwrap(), "depth/0", "new");
    assert!(results.commit(None).is_err());
    assert_eq!(fs::read(at("elsewhere/0")).unwrap(), b"old");

    symlink(at("images/0"), at("image")).unwrap();
    assert!(check_target(&at("image"), &[&at("images/0")]).is_err());
    symlink("/dev/null", at("device")).unwrap();
    symlink("nothing", at("dangling")).unwrap();
    for target in [
        Path::new("/dev/full"),
        &at("device"),
        &at("images"),
        &at("dangling"),
    ] {
        assert!(check_target(target, &[]).is_err(), "{}", target.display());
    }
    // A link to a file is followed: the file gets the new contents.
    crate::atomic::write(&at("image"), b"new").unwrap();
    assert!(fs::symlink_metadata(at("image")).unwrap().is_symlink());
    assert_eq!(fs::read(at("images/0")).unwrap(), b"new");
}

#[test]
fn lists_that_name_files_elsewhere_are_not_followed() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), "private", "mine");
    let text =
        r#"{"format": "minute4d-files", "files": {"capture": ["../private", "/etc/passwd", "a"]}}"#;
    write(&dir.path().join("cap"), LIST, text);
    assert_eq!(
        files_of(&dir.path().join("cap"), Kind::Capture),
        BTreeSet::from(["a".to_owned()])
    );
    commit(&dir.path().join("cap"), &NEW);
    assert_eq!(fs::read(dir.path().join("private")).unwrap(), b"mine");
}

#[test]
fn only_one_process_has_a_folder() {
    let dir = tempfile::tempdir().unwrap();
    let _first = ResultFolder::open(dir.path(), Kind::Run).unwrap();
    let error = ResultFolder::open(dir.path(), Kind::Run).unwrap_err();
    assert!(cfg!(windows) || error.kind() == ErrorKind::Busy);
}
