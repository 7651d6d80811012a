//! Publishing, without a run: folders that look like one.

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

/// Nothing is on its way in or out.
fn is_calm(root: &Path) -> bool {
    [".incoming", ".outgoing"].iter().all(|left| fs::read_dir(root.join(left)).map_or(0, Iterator::count) == 0)
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
        assert!(!target.join(".scene.safetensors.tmp-1").exists() && !layout.work("a").exists());
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
        assert!(matches!(&got, Published::Bad(message) if message.contains(words)), "{words}: {got:?}");
        assert!(!layout.result("a").exists() && !work.exists() && is_calm(dir.path()));
    };
    bad(&|| write_run(&work, "scene", "stopped"), "stopped");
    let same_size = || {
        fs::write(work.join("scene.safetensors"), "scenE").unwrap();
        assert!(check(&work, false).unwrap().is_ok(), "sizes alone do not tell");
    };
    bad(&same_size, "not as it was written");
    bad(&|| fs::remove_file(work.join("scene.safetensors")).unwrap(), "missing");
    bad(&|| fs::write(work.join("run.json"), "{").unwrap(), "run.json");

    write_run(&work, "scene", "finished");
    fs::create_dir(layout.result("a")).unwrap();
    fs::write(layout.result("a").join("thesis.tex"), "mine").unwrap();
    assert_eq!(publish(&layout, "a", "k", "here").unwrap(), Published::NotOurs);
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
        assert_eq!(present(&target, "k").unwrap(), wanted, "never a part of one");
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
        assert_eq!(present(&target, "k").unwrap(), Present::Same, "round {round}");
        assert!(check(&target, true).unwrap().is_ok());
    }
}
