//! Publishes the result of a working folder: checked, complete, by one rename.
//!
//! The finished run is brought under a name of its own (`.incoming/ID/NONCE`) before it is checked,
//! so that no process that still writes into the working folder can change what was checked. It
//! appears under its final name by one rename. Of two processes that publish the same job one wins,
//! and the other finds it done.

use crate::batch::layout::{Layout, RESULT_FILE, short_hash};
use crate::batch::manifest::VERSION;
use crate::run::record::{FileRecord, RUN_FILE, RUN_FORMAT, Status};
use m4_io::atomic;
use minute4d::json::{read_json, write_json};
use minute4d::{Error, hash};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::Path;
use std::time::SystemTime;

/// `format` of [`RESULT_FILE`].
const FORMAT: &str = "minute4d-batch-result";

/// [`RESULT_FILE`]: what makes a folder a result of a batch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct ResultMark {
    format: String,
    version: u32,
    id: String,
    key: String,
    host: String,
}

/// What is read of `run.json`.
#[derive(Debug, Deserialize)]
struct Run {
    format: String,
    status: Status,
    files: BTreeMap<String, FileRecord>,
}

/// The outcome of publishing.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Published {
    /// The result is published.
    Yes,
    /// What was made is not what its record says; it was removed.
    Bad(String),
    /// Something that is no result of a batch is where it should go.
    NotOurs,
}

/// What is where a result should be.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Present {
    /// Nothing.
    None,
    /// A whole result of the same input and settings.
    Same,
    /// A result of other input or settings, or one that lacks files.
    Other,
    /// A folder that is not a result of a batch.
    NotOurs,
}

/// Checks the published result. File sizes are compared, not hashes: those were when it was
/// published.
pub(crate) fn present(folder: &Path, key: &str) -> Result<Present, Error> {
    if fs::symlink_metadata(folder).is_err_and(|e| e.kind() == ErrorKind::NotFound) {
        return Ok(Present::None);
    }
    let Some(mark) =
        read_json::<ResultMark>(&folder.join(RESULT_FILE))?.filter(|m| m.format == FORMAT)
    else {
        return Ok(Present::NotOurs);
    };
    let same = mark.version == VERSION && mark.key == key;
    Ok(if same && check(folder, false)?.is_ok() {
        Present::Same
    } else {
        Present::Other
    })
}

/// Whether a folder holds a finished run whose files are as recorded; what is wrong, where
/// something is.
fn check(folder: &Path, hashes: bool) -> Result<Result<(), String>, Error> {
    let Some(run) = read_json::<Run>(&folder.join(RUN_FILE))?.filter(|r| r.format == RUN_FORMAT)
    else {
        return Ok(Err(format!("it has no {RUN_FILE} that can be used")));
    };
    if run.status != Status::Finished || run.files.is_empty() {
        let count = run.files.len();
        return Ok(Err(format!(
            "its {RUN_FILE} says {:?}, with {count} files",
            run.status
        )));
    }
    for (name, file) in &run.files {
        let path = folder.join(name);
        let size = match fs::metadata(&path) {
            Ok(metadata) => metadata.len(),
            Err(e) if e.kind() == ErrorKind::NotFound => {
                return Ok(Err(format!("{name} is missing")));
            }
            Err(source) => return Err(Error::Read { path, source }),
        };
        if size != file.bytes {
            return Ok(Err(format!(
                "{name} has {size} bytes and should have {}",
                file.bytes
            )));
        }
        if hashes && hash::of_path(&path)? != file.blake3 {
            return Ok(Err(format!("{name} is not as it was written")));
        }
    }
    Ok(Ok(()))
}

/// Publishes the finished run in the working folder as the result of a job, instead of an older
/// one.
pub(crate) fn publish(
    layout: &Layout,
    id: &str,
    key: &str,
    host: &str,
) -> Result<Published, Error> {
    let (work, target) = (layout.work(id), layout.result(id));
    match present(&target, key)? {
        Present::NotOurs => return Ok(Published::NotOurs),
        Present::Same => {
            remove(&work)?;
            return Ok(Published::Yes);
        }
        Present::None | Present::Other => {}
    }
    let nonce = nonce(host);
    let incoming = layout.incoming(id).join(&nonce);
    bring(&work, &incoming).map_err(Error::write(&incoming))?;
    if let Err(reason) = check(&incoming, true)? {
        // The next attempt starts again.
        remove(&incoming)?;
        let _ = fs::remove_dir(layout.incoming(id));
        return Ok(Published::Bad(reason));
    }
    mark(&incoming, id, key, host)?;
    swap(layout, id, key, &nonce)?;
    // What stays of these costs room alone.
    let _ = remove(&incoming);
    let _ = remove(&layout.outgoing(id).join(&nonce));
    let _ = fs::remove_dir(layout.incoming(id));
    let _ = fs::remove_dir(layout.outgoing(id));
    Ok(Published::Yes)
}

fn mark(folder: &Path, id: &str, key: &str, host: &str) -> Result<(), Error> {
    let mark = ResultMark {
        format: FORMAT.to_owned(),
        version: VERSION,
        id: id.to_owned(),
        key: key.to_owned(),
        host: host.to_owned(),
    };
    write_json(&folder.join(RESULT_FILE), &mark)
}

/// Moves the incoming result into place, after moving an older one away.
fn swap(layout: &Layout, id: &str, key: &str, nonce: &str) -> Result<(), Error> {
    let (target, old) = (layout.result(id), layout.outgoing(id).join(nonce));
    let replaces = target.exists();
    if replaces {
        fs::create_dir_all(layout.outgoing(id))
            .and_then(|()| fs::rename(&target, &old))
            .map_err(Error::write(&target))?;
    }
    if let Err(error) = fs::rename(layout.incoming(id).join(nonce), &target) {
        if present(&target, key)? == Present::Same {
            // Another process was faster, and has the same result.
            return Ok(());
        }
        if replaces {
            // The older result is better than none.
            let _ = fs::rename(&old, &target);
        }
        return Err(Error::write(&target)(error));
    }
    sync_folder(layout.root());
    Ok(())
}

/// Clears up after a process that was killed while it published: a whole result is the working
/// folder again.
pub(crate) fn recover(layout: &Layout, id: &str) -> Result<(), Error> {
    remove(&layout.outgoing(id))?;
    let (folder, work) = (layout.incoming(id), layout.work(id));
    let entries = match fs::read_dir(&folder) {
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(Error::read(&folder))?,
    };
    for entry in entries {
        let left = entry.map_err(Error::read(&folder))?.path();
        if !work.exists() && check(&left, true)?.is_ok() {
            bring(&left, &work).map_err(Error::write(&work))?;
        } else {
            remove(&left)?;
        }
    }
    Ok(())
}

/// Moves a folder, without what a killed run was writing.
fn bring(from: &Path, to: &Path) -> io::Result<()> {
    if let Some(parent) = to.parent() {
        fs::create_dir_all(parent)?;
    }
    fs::rename(from, to)?;
    atomic::remove_temporary(to, true, &atomic::is_temporary)
}

fn nonce(host: &str) -> String {
    let text = format!("{host} {} {:?}", std::process::id(), SystemTime::now());
    short_hash(&text, 16)
}

pub(crate) fn remove(folder: &Path) -> Result<(), Error> {
    match fs::remove_dir_all(folder) {
        Err(e) if e.kind() != ErrorKind::NotFound => Err(Error::write(folder)(e)),
        _ => Ok(()),
    }
}

/// Not every system lets a folder be opened, and the files are safe by now.
fn sync_folder(folder: &Path) {
    if let Ok(folder) = File::open(folder) {
        let _ = folder.sync_all();
    }
}

#[cfg(test)]
mod tests {
    use super::{Present, Published, bring, check, mark, present, publish, recover, swap};
    use crate::batch::layout::Layout;
    use std::path::Path;
    use std::sync::Barrier;
    use std::{fs, thread};

    fn write_run(folder: &Path, scene: &str, status: &str) {
        fs::create_dir_all(folder.join("capture")).unwrap();
        fs::write(folder.join("capture/transforms_train.json"), "{}").unwrap();
        fs::write(folder.join("scene.safetensors"), scene).unwrap();
        fs::write(folder.join(".scene.safetensors.tmp-1"), "half").unwrap();
        let hash = blake3::hash(scene.as_bytes()).to_hex().to_string();
        let run = serde_json::json!({
            "format": "minute4d-run", "status": status,
            "files": {"scene.safetensors": {"bytes": scene.len(), "blake3": hash}},
        });
        fs::write(folder.join("run.json"), run.to_string()).unwrap();
    }

    fn read(folder: &Path) -> String {
        fs::read_to_string(folder.join("scene.safetensors")).unwrap()
    }

    fn is_calm(root: &Path) -> bool {
        [".incoming", ".outgoing"]
            .iter()
            .all(|left| fs::read_dir(root.join(left)).map_or(0, Iterator::count) == 0)
    }

    #[test]
    fn a_result_appears_whole_and_replaces_an_older_one() {
        let dir = tempfile::tempdir().unwrap();
        let layout = Layout::new(dir.path());
        let target = layout.result("a");
        assert_eq!(present(&target, "k1").unwrap(), Present::None);
        for (scene, key) in [("one", "k1"), ("two", "k2")] {
            write_run(&layout.work("a"), scene, "finished");
            assert_eq!(publish(&layout, "a", key, "here").unwrap(), Published::Yes);
            assert_eq!(read(&target), scene);
            assert!(target.join("capture/transforms_train.json").is_file());
            assert!(
                !target.join(".scene.safetensors.tmp-1").exists() && !layout.work("a").exists()
            );
            assert_eq!(present(&target, key).unwrap(), Present::Same);
            assert_eq!(present(&target, "k3").unwrap(), Present::Other);
        }
        assert!(is_calm(dir.path()));
        fs::write(target.join("scene.safetensors"), "longer than it was").unwrap();
        let damaged = present(&target, "k2").unwrap();
        assert_eq!(damaged, Present::Other, "so it is made again");
    }

    #[test]
    fn only_finished_and_complete_results_are_published() {
        let dir = tempfile::tempdir().unwrap();
        let layout = Layout::new(dir.path());
        let work = layout.work("a");
        let bad = |spoil: &dyn Fn(), words: &str| {
            write_run(&work, "scene", "finished");
            spoil();
            let got = publish(&layout, "a", "k", "here").unwrap();
            assert!(
                matches!(&got, Published::Bad(message) if message.contains(words)),
                "{words}: {got:?}"
            );
            assert!(!layout.result("a").exists() && !work.exists() && is_calm(dir.path()));
        };
        bad(&|| write_run(&work, "scene", "stopped"), "Stopped");
        let same_size = || {
            fs::write(work.join("scene.safetensors"), "scenE").unwrap();
            assert!(
                check(&work, false).unwrap().is_ok(),
                "sizes alone do not tell"
            );
        };
        bad(&same_size, "not as it was written");
        bad(
            &|| fs::remove_file(work.join("scene.safetensors")).unwrap(),
            "missing",
        );
        bad(
            &|| fs::write(work.join("run.json"), "{").unwrap(),
            "run.json",
        );

        write_run(&work, "scene", "finished");
        fs::create_dir(layout.result("a")).unwrap();
        fs::write(layout.result("a").join("thesis.tex"), "mine").unwrap();
        assert_eq!(
            publish(&layout, "a", "k", "here").unwrap(),
            Published::NotOurs
        );
        assert!(layout.result("a").join("thesis.tex").is_file());
    }

    #[test]
    fn an_interrupted_publication_is_completed() {
        let dir = tempfile::tempdir().unwrap();
        let layout = Layout::new(dir.path());
        let (work, target) = (layout.work("a"), layout.result("a"));
        write_run(&work, "old", "finished");
        assert_eq!(publish(&layout, "a", "k0", "here").unwrap(), Published::Yes);
        // before the older result was out of the way, and between the two renames
        for moved in [false, true] {
            write_run(&work, "new", "finished");
            bring(&work, &layout.incoming("a").join("killed")).unwrap();
            if moved {
                bring(&target, &layout.outgoing("a").join("killed")).unwrap();
            }
            let wanted = if moved { Present::None } else { Present::Other };
            assert_eq!(
                present(&target, "k").unwrap(),
                wanted,
                "never a part of one"
            );
            recover(&layout, "a").unwrap();
            assert!(work.is_dir());
            assert_eq!(publish(&layout, "a", "k", "here").unwrap(), Published::Yes);
            assert!(read(&target) == "new" && is_calm(dir.path()));
            fs::remove_dir_all(&target).unwrap();
            write_run(&work, "old", "finished");
            assert_eq!(publish(&layout, "a", "k0", "here").unwrap(), Published::Yes);
        }
        // what is not whole
        let part = layout.incoming("a").join("part");
        write_run(&part, "new", "finished");
        fs::write(part.join("scene.safetensors"), "n").unwrap();
        recover(&layout, "a").unwrap();
        assert!(!part.exists() && !work.exists() && read(&target) == "old");
    }

    #[test]
    fn concurrent_publishing_leaves_one_result() {
        let dir = tempfile::tempdir().unwrap();
        let layout = Layout::new(dir.path());
        for round in 0..20 {
            let (id, barrier) = (round.to_string(), Barrier::new(2));
            // As where no lock keeps two runs apart: each has checked its own.
            for who in ["one", "two"] {
                let incoming = layout.incoming(&id).join(who);
                write_run(&incoming, "scene", "finished");
                mark(&incoming, &id, "k", who).unwrap();
            }
            let ends = thread::scope(|scope| {
                let ends = ["one", "two"].map(|who| {
                    let (layout, id, barrier) = (&layout, &id, &barrier);
                    scope.spawn(move || {
                        barrier.wait();
                        swap(layout, id, "k", who).is_ok()
                    })
                });
                ends.map(|end| end.join().unwrap())
            });
            // Who is overtaken may also fail, and finds it done when it tries again.
            assert!(ends.contains(&true), "round {round}");
            let target = layout.result(&id);
            assert_eq!(
                present(&target, "k").unwrap(),
                Present::Same,
                "round {round}"
            );
            assert!(check(&target, true).unwrap().is_ok());
        }
    }
}
