//! Workers with a shell script in place of the program.

use super::{JobEnd, Listener, Summary, Tools, WorkOptions, work};
use crate::manifest::{Arguments, Job, Manifest};
use crate::share::Share;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::time::{Duration, SystemTime};

/// A batch in a folder that is removed with the test.
struct Batch {
    dir: tempfile::TempDir,
    manifest: Manifest,
}

fn hash(path: &Path) -> Result<String, String> {
    let bytes = fs::read(path).map_err(|e| e.to_string())?;
    Ok(blake3::hash(&bytes).to_hex().to_string())
}

/// Makes a program of a script. By another process: one that is forked here meanwhile would hold it open for writing.
fn install(script: &str, program: &Path) {
    let text = program.with_extension("txt");
    fs::write(&text, script).unwrap();
    let status = Command::new("install")
        .args(["-m", "755"])
        .args([&text, program])
        .status()
        .unwrap();
    assert!(status.success());
}

/// Keeps what ended.
#[derive(Default)]
struct Ends(Mutex<Vec<String>>);

impl Listener for Ends {
    fn stop(&self) -> bool {
        false
    }
    fn progress(&self, _: &str, _: &str, _: usize, _: usize, _: &str) {}
    fn ended(&self, id: &str, _: &JobEnd) {
        self.0.lock().unwrap().push(id.to_owned());
    }
}

impl Batch {
    fn new(clips: &[&str]) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let results = dir.path().join("results");
        let jobs = clips.iter().map(|id| {
            let input = dir.path().join(id);
            fs::write(&input, id).unwrap();
            Job {
                id: (*id).to_owned(),
                input: input.to_str().unwrap().to_owned(),
                bytes: id.len() as u64,
                blake3: hash(&input).unwrap(),
                output: results.join(id).to_str().unwrap().to_owned(),
                estimate_s: None,
                estimate_of: None,
            }
        });
        let manifest = Manifest {
            results: results.to_str().unwrap().to_owned(),
            run: Arguments {
                settings: "a = 1\n".to_owned(),
                arguments: Vec::new(),
            },
            jobs: jobs.collect(),
        };
        Self { dir, manifest }
    }

    /// Runs a worker whose program does what `body` says with `$clip` and `$out`; it may call `finish`.
    fn work(&self, body: &str, change: impl FnOnce(&mut WorkOptions)) -> (Summary, Vec<String>) {
        let program = self.path("program");
        let run = format!(
            r#"{{"format":"minute4d-run","status":"finished","files":{{"scene.safetensors":{{"bytes":5,"blake3":"{}"}}}}}}"#,
            blake3::hash(b"scene").to_hex()
        );
        let script = format!(
            "#!/bin/sh\nwhile [ $# -gt 1 ]; do [ \"$1\" = --out ] && out=$2; shift; done\nclip=$(basename \"$1\")\n\
             echo \"$clip\" >> {}\nfinish() {{ mkdir -p \"$out\"; printf scene > \"$out/scene.safetensors\"; \
             echo '{run}' > \"$out/run.json\"; }}\n{body}\n",
            self.path("calls").display()
        );
        install(&script, &program);
        let mut options = WorkOptions {
            share: Share::All,
            scratch: None,
            lease: Duration::from_secs(60),
            attempts: 3,
            retry_failed: false,
            wait: false,
        };
        change(&mut options);
        let tools = Tools {
            program,
            arguments: Vec::new(),
            hash: &hash,
            host: "here".to_owned(),
        };
        let ends = Ends::default();
        let summary = work(&self.manifest, &options, &tools, &ends).unwrap();
        (summary, ends.0.into_inner().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// How often the program was called.
    fn calls(&self) -> usize {
        fs::read_to_string(self.path("calls")).map_or(0, |text| text.lines().count())
    }

    fn state(&self, id: &str) -> serde_json::Value {
        let text = fs::read(self.path("results/.state").join(format!("{id}.json"))).unwrap();
        serde_json::from_slice(&text).unwrap()
    }
}

#[test]
fn each_end_of_a_run_has_its_verdict() {
    let batch = Batch::new(&["good", "bad", "shut"]);
    let body = "case $clip in good) finish;; bad) exit 65;; shut) exit 74;; esac";
    let (summary, ends) = batch.work(body, |_| {});
    assert_eq!((summary.done, summary.poison, summary.again), (1, 1, 1), "{summary:?}");
    assert_eq!(ends, ["good", "bad", "shut"]);
    assert_eq!(
        (&batch.state("bad")["verdict"], &batch.state("shut")["verdict"]),
        (&"poison".into(), &"interrupted".into())
    );
    assert_eq!(batch.calls(), 3);
    let (summary, _) = batch.work("finish", |_| {});
    assert_eq!(
        (summary.done, summary.done_before, summary.poison),
        (1, 1, 1),
        "poison stays"
    );
    assert_eq!(batch.calls(), 4);
    let (summary, _) = batch.work("finish", |o| o.retry_failed = true);
    assert_eq!((summary.done, summary.done_before), (1, 2), "unless it is asked for");
}

#[test]
fn a_machine_that_cannot_leaves_the_rest_to_others() {
    let batch = Batch::new(&["a", "b", "c"]);
    let (summary, ends) = batch.work("exit 69", |_| {});
    assert_eq!((summary.again, ends.len(), batch.calls()), (3, 1, 1), "{summary:?}");
    let (summary, _) = batch.work("finish", |_| {});
    assert_eq!(summary.done, 3, "its lease was given back");
}

#[test]
fn a_disk_that_cannot_be_used_is_recorded_and_no_fault_of_the_clip() {
    let batch = Batch::new(&["a", "b"]);
    let scratch = batch.path("scratch");
    fs::write(&scratch, "no folder").unwrap();
    let (summary, ends) = batch.work("finish", |o| o.scratch = Some(scratch.clone()));
    assert_eq!((summary.again, ends.len(), batch.calls()), (2, 1, 0), "{summary:?}");
    let state = batch.state("a");
    assert_eq!((&state["verdict"], &state["code"]), (&"interrupted".into(), &73.into()));
    fs::remove_file(&scratch).unwrap();
    let (summary, _) = batch.work("finish", |o| o.scratch = Some(scratch));
    assert_eq!(summary.done, 2, "its lease was given back");
}

#[test]
fn crashes_and_lies_are_counted_and_given_up() {
    let batch = Batch::new(&["a"]);
    // A success without a result is none.
    for (body, words) in [
        ("kill -SEGV $$", "signal"),
        ("exit 0", "run.json"),
        ("exit 1", "3 attempts"),
    ] {
        let before = batch.calls();
        let (summary, _) = batch.work(body, |o| o.retry_failed = true);
        assert_eq!((summary.poison, batch.calls() - before), (1, 3), "{body}: {summary:?}");
        assert!(summary.reasons[0].1.contains(words), "{body}: {summary:?}");
        assert_eq!(batch.state("a")["attempts"], 3);
    }
    let (summary, _) = batch.work("[ $(wc -l < $(dirname $0)/calls) -lt 11 ] && exit 1; finish", |o| {
        o.retry_failed = true
    });
    assert_eq!(summary.done, 1, "the second attempt works");
}

#[test]
fn a_clip_over_which_workers_vanish_is_given_up() {
    let batch = Batch::new(&["a"]);
    let leases = batch.path("results/.lease/a");
    fs::create_dir_all(&leases).unwrap();
    let holder = r#"{"nonce":"n","host":"gone","pid":1,"since_s":0,"released":false}"#;
    let vanish = |number: usize| {
        let path = leases.join(format!("{number:06}.json"));
        fs::write(&path, holder).unwrap();
        let old = SystemTime::now() - Duration::from_secs(3600);
        fs::OpenOptions::new()
            .write(true)
            .open(path)
            .unwrap()
            .set_modified(old)
            .unwrap();
    };
    // Every other lease is of the worker of this test, which gives it back.
    for round in 0..3 {
        let newest = fs::read_dir(&leases).unwrap().count();
        vanish(newest + 1);
        let (summary, _) = batch.work("exit 75", |o| o.attempts = 1);
        let expected = if round < 2 { (1, 0) } else { (0, 1) };
        assert_eq!((summary.again, summary.poison), expected, "round {round}: {summary:?}");
        assert_eq!(batch.state("a")["vanished"], round + 1);
    }
    assert_eq!(batch.calls(), 2, "the last time nothing was run");
}

#[test]
fn jobs_of_others_changed_inputs_and_folders_in_the_way_are_left_alone() {
    let batch = Batch::new(&["held", "changed", "gone", "foreign", "free"]);
    fs::create_dir_all(batch.path("results/.lease/held")).unwrap();
    fs::write(batch.path("results/.lease/held/000001.json"), "{}").unwrap();
    fs::write(batch.path("changed"), "another").unwrap();
    fs::remove_file(batch.path("gone")).unwrap();
    fs::create_dir_all(batch.path("results/foreign")).unwrap();
    let (summary, _) = batch.work("finish", |_| {});
    assert_eq!((summary.again, summary.poison, summary.done), (1, 3, 1), "{summary:?}");
    assert_eq!(batch.calls(), 1);
    assert_eq!(
        (&batch.state("gone")["code"], &batch.state("changed")["code"]),
        (&66.into(), &65.into())
    );
    assert!(!batch.path("results/held").exists());
}
