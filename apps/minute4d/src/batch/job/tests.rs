//! Jobs with a shell script instead of the program.

use super::{JobEnd, Tools, index_of_environment, run_job};
use crate::batch::layout::Outcome;
use crate::batch::manifest::{Arguments, Job, Manifest};
use m4_core::Silent;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{fs, thread};

/// A batch in a folder that is removed with the test.
struct Batch {
    dir: tempfile::TempDir,
    manifest: Manifest,
}

/// Makes a program of a script. By another process: one that is forked here meanwhile would hold it
/// open for writing.
fn install(script: &str, program: &Path) {
    let text = program.with_extension("txt");
    fs::write(&text, script).unwrap();
    let mut command = Command::new("install");
    assert!(
        command
            .args(["-m", "755"])
            .args([&text, program])
            .status()
            .unwrap()
            .success()
    );
}

impl Batch {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let (results, input) = (dir.path().join("results"), dir.path().join("clip.mp4"));
        fs::write(&input, "frames").unwrap();
        fs::create_dir_all(results.join(".state")).unwrap();
        let job = Job {
            id: "clip".to_owned(),
            input: input.to_str().unwrap().to_owned(),
            blake3: minute4d::hash::of_path(&input).unwrap(),
            output: results.join("clip").to_str().unwrap().to_owned(),
        };
        let manifest = Manifest {
            results: results.to_str().unwrap().to_owned(),
            run: Arguments {
                settings: "a = 1\n".to_owned(),
                arguments: Vec::new(),
            },
            jobs: vec![job],
        };
        Self { dir, manifest }
    }

    /// Makes the program: it does what `body` says with `$clip` and `$out`, and may call `begin`
    /// and `finish`.
    fn program(&self, body: &str) {
        let record = |status: &str| {
            format!(
                r#"{{"format":"minute4d-run","status":"{status}","files":{{"scene.safetensors":{{"bytes":5,"blake3":"{}"}}}}}}"#,
                blake3::hash(b"scene").to_hex()
            )
        };
        let script = format!(
            "#!/bin/sh\nwhile [ $# -gt 1 ]; do [ \"$1\" = --out ] && out=$2; shift; done\nclip=$1\necho x >> {}\n\
             begin() {{ mkdir -p \"$out\"; echo '{}' > \"$out/run.json\"; }}\n\
             finish() {{ begin; printf scene > \"$out/scene.safetensors\"; echo '{}' > \"$out/run.json\"; }}\n{body}\n",
            self.path("calls").display(),
            record("running"),
            record("finished"),
        );
        install(&script, &self.path("program"));
    }

    fn again(&self, retry_failed: bool) -> JobEnd {
        let tools = Tools {
            program: self.path("program"),
            arguments: Vec::new(),
            host: "here".to_owned(),
        };
        run_job(&self.manifest, 0, retry_failed, &tools, &Silent).unwrap()
    }

    fn run(&self, body: &str) -> JobEnd {
        self.program(body);
        self.again(false)
    }

    fn retry_failed(&self, body: &str) -> JobEnd {
        self.program(body);
        self.again(true)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn calls(&self) -> usize {
        fs::read_to_string(self.path("calls")).map_or(0, |text| text.lines().count())
    }
}

#[test]
fn only_bad_input_is_a_permanent_failure() {
    let batch = Batch::new();
    let retryable = [
        "1", "2", "66", "69", "73", "74", "75", "78", "101", "130", "143",
    ]
    .map(|code| format!("exit {code}"));
    let killed = ["KILL", "SEGV", "ABRT"].map(|signal| format!("kill -{signal} $$"));
    // A success without a result is none either.
    for body in retryable
        .iter()
        .chain(&killed)
        .map(String::as_str)
        .chain(["exit 0"])
    {
        let end = batch.run(body);
        assert_eq!(end.outcome, Outcome::Retryable, "{body}: {end:?}");
        assert!(!end.reason.is_empty() && !batch.path("results/clip").exists());
    }
    let calls = batch.calls();
    assert_eq!(
        calls, 15,
        "each was run: nothing stands in the way of the next attempt"
    );

    assert_eq!(batch.run("exit 65").outcome, Outcome::Failed);
    let again = batch.run("finish");
    assert_eq!((again.outcome, again.seconds), (Outcome::Failed, None));
    assert_eq!(batch.calls(), calls + 1, "it is not run again");
    assert_eq!(
        batch.retry_failed("finish").outcome,
        Outcome::Done,
        "unless that is asked for"
    );
    let again = batch.retry_failed("exit 65");
    assert_eq!(
        (again.outcome, again.seconds),
        (Outcome::Done, None),
        "what is done stays"
    );
    assert_eq!(batch.calls(), calls + 2);
}

#[test]
fn bad_input_needs_a_run_that_used_nothing_older_and_the_bytes_that_were_planned() {
    let batch = Batch::new();
    assert_eq!(
        batch.run("begin; kill -KILL $$").outcome,
        Outcome::Retryable
    );
    let end = batch.run("[ -e \"$out/run.json\" ] && exit 65; finish");
    assert_eq!(
        (end.outcome, batch.calls()),
        (Outcome::Done, 3),
        "what was left was bad: {end:?}"
    );

    let batch = Batch::new();
    let end = batch.run("mv \"$clip\" \"$clip.away\"; exit 65");
    assert_eq!(end.outcome, Outcome::Retryable, "{end:?}");
    let end = batch.run("finish");
    assert_eq!(
        (end.outcome, batch.calls()),
        (Outcome::Retryable, 1),
        "there is no input: {end:?}"
    );
    fs::remove_dir_all(batch.path("results")).unwrap();
    let end = batch.run("finish");
    assert!(
        end.outcome == Outcome::Retryable && end.reason.contains("not mounted"),
        "{end:?}"
    );
    assert!(
        !batch.path("results").exists(),
        "nothing is written where disks are not mounted"
    );
    fs::create_dir_all(batch.path("results/.state")).unwrap();
    fs::write(batch.path("clip.mp4"), "others").unwrap();
    let end = batch.run("finish");
    assert!(
        end.outcome == Outcome::Retryable && end.reason.contains("not what was planned"),
        "{end:?}"
    );
    fs::rename(batch.path("clip.mp4.away"), batch.path("clip.mp4")).unwrap();
    assert_eq!(batch.run("finish").outcome, Outcome::Done);
}

#[test]
fn disk_failures_and_foreign_folders_are_not_counted_against_the_clip() {
    let batch = Batch::new();
    fs::create_dir_all(batch.path("results/clip")).unwrap();
    let end = batch.run("finish");
    assert!(
        end.outcome == Outcome::Retryable && end.reason.contains("was not created by"),
        "{end:?}"
    );
    fs::remove_dir(batch.path("results/clip")).unwrap();
    let place = batch.path("results/.work");
    fs::write(&place, "no folder").unwrap();
    let end = batch.again(false);
    assert!(
        end.outcome == Outcome::Retryable && batch.calls() == 0,
        "{end:?}"
    );
    fs::remove_file(&place).unwrap();
    assert_eq!(batch.again(false).outcome, Outcome::Done);
    assert_eq!(fs::read_dir(&place).unwrap().count(), 0);
    assert!(batch.path("results/clip/scene.safetensors").is_file());
}

#[test]
fn second_process_of_a_job_finds_it_done() {
    let batch = Batch::new();
    batch.program("sleep 0.5; finish");
    let run = || batch.again(false);
    let ends =
        thread::scope(|scope| [scope.spawn(run), scope.spawn(run)].map(|end| end.join().unwrap()));
    assert!(
        ends.iter().all(|end| end.outcome == Outcome::Done),
        "{ends:?}"
    );
    assert_eq!(batch.calls(), 1, "{ends:?}");
}

#[test]
fn first_set_variable_counts() {
    let kubernetes = |name: &str| (name == "JOB_COMPLETION_INDEX").then(|| "7".to_owned());
    assert_eq!(index_of_environment(kubernetes).unwrap(), Some(7));
    assert_eq!(index_of_environment(|_| None).unwrap(), None);
    let message = index_of_environment(|_| Some("x".to_owned()))
        .unwrap_err()
        .to_string();
    assert!(message.contains("SLURM_ARRAY_TASK_ID"), "{message}");
}
