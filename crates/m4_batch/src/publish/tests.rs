//! Publishing, without a run: folders that look like one.

use super::{Present, Published, check, present, publish};
use crate::layout::Layout;
use crate::lease::{Holder, Lease, Taken, take};
use std::fs;
use std::path::Path;
use std::time::Duration;

fn lease(layout: &Layout, nonce: &str) -> Lease {
    let me = Holder {
        nonce: nonce.to_owned(),
        host: "here".to_owned(),
        pid: 1,
        since_s: 0,
        released: false,
    };
    match take(&layout.leases("a"), Duration::from_secs(60), &me).unwrap() {
        Taken::Mine { lease, .. } => lease,
        Taken::Held(seen) => panic!("held: {seen:?}"),
    }
}

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

#[test]
fn a_result_appears_whole_and_replaces_an_older_one() {
    let dir = tempfile::tempdir().unwrap();
    let scratch = dir.path().join("scratch");
    for scratch in [None, Some(scratch.as_path())] {
        let root = dir.path().join(format!("results{}", scratch.is_some()));
        let layout = Layout::new(&root, scratch);
        let target = layout.result("a");
        assert_eq!(present(&target, "k1").unwrap(), Present::None);
        for (scene, key) in [("one", "k1"), ("two", "k2")] {
            write_run(&layout.work("a"), scene, "finished");
            let held = lease(&layout, key);
            assert_eq!(publish(&layout, "a", key, "here", &held).unwrap(), Published::Yes);
            held.release().unwrap();
            assert_eq!(read(&target), scene);
            assert!(target.join("capture/transforms_train.json").is_file());
            assert!(!target.join(".scene.safetensors.tmp-1").exists() && !layout.work("a").exists());
            assert_eq!(present(&target, key).unwrap(), Present::Same);
            assert_eq!(present(&target, "k3").unwrap(), Present::Other);
        }
        for left in [".incoming", ".outgoing"] {
            let count = fs::read_dir(root.join(left)).map_or(0, Iterator::count);
            assert_eq!(count, 0, "{left}");
        }
        fs::write(target.join("scene.safetensors"), "longer than it was").unwrap();
        assert_eq!(
            present(&target, "k2").unwrap(),
            Present::Other,
            "damaged, so it is made again"
        );
    }
}

#[test]
fn nothing_is_published_that_is_not_finished_whole_or_ours() {
    let dir = tempfile::tempdir().unwrap();
    let layout = Layout::new(dir.path(), None);
    let (work, held) = (layout.work("a"), lease(&layout, "n"));
    let bad = |words: &str| {
        let got = publish(&layout, "a", "k", "here", &held).unwrap();
        assert!(
            matches!(&got, Published::Bad(said) if said.contains(words)),
            "{words}: {got:?}"
        );
        assert!(!layout.result("a").exists());
    };
    write_run(&work, "scene", "stopped");
    bad("stopped");
    write_run(&work, "scene", "finished");
    fs::write(work.join("scene.safetensors"), "scenE").unwrap();
    bad("not as it was written");
    assert!(check(&work, false).unwrap().is_ok(), "sizes alone do not tell");
    fs::remove_file(work.join("scene.safetensors")).unwrap();
    bad("missing");
    fs::write(work.join("run.json"), "{").unwrap();
    bad("run.json");

    write_run(&work, "scene", "finished");
    fs::create_dir(layout.result("a")).unwrap();
    fs::write(layout.result("a").join("thesis.tex"), "mine").unwrap();
    assert_eq!(publish(&layout, "a", "k", "here", &held).unwrap(), Published::Foreign);
    assert!(layout.result("a").join("thesis.tex").is_file());
}

#[test]
fn who_lost_the_lease_publishes_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let layout = Layout::new(dir.path(), None);
    write_run(&layout.work("a"), "scene", "finished");
    let old = lease(&layout, "old");
    fs::write(layout.leases("a").join("000002.json"), "{}").unwrap();
    assert_eq!(publish(&layout, "a", "k", "here", &old).unwrap(), Published::Lost);
    assert!(!layout.result("a").exists() && layout.work("a").exists());
}
