//! Many clips: planned, done by one or several workers, killed, taken over, looked at.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{Ended, Scratch, call, program, refused, succeed, write_capture};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

/// So many captures `clip1`..., in the folder `clips`.
fn write_clips(dir: &Scratch, n: usize) {
    for i in 1..=n {
        write_capture(&dir.path(&format!("clips/clip{i}")), false);
        // Clips of the same bytes would be one clip to the eye that looks at hashes.
        fs::write(dir.path(&format!("clips/clip{i}/name.txt")), i.to_string()).unwrap();
    }
}

/// Plans everything in `clips`; gives the arguments that name the manifest.
fn plan(dir: &Scratch, more: &[&str]) -> [String; 2] {
    let (clips, manifest, out) = (dir.at("clips"), dir.at("jobs.jsonl"), dir.at("results"));
    let args = ["batch", "plan", &clips, "--recursive", "-o", &manifest, "--out", &out];
    succeed(&args.iter().chain(more).copied().collect::<Vec<_>>());
    ["--manifest".to_owned(), manifest]
}

/// `batch run` with the manifest and more.
fn worker(manifest: &[String; 2], more: &[&str]) -> Command {
    let mut command = program();
    for name in [
        "SLURM_ARRAY_TASK_ID",
        "JOB_COMPLETION_INDEX",
        "AWS_BATCH_JOB_ARRAY_INDEX",
        "HQ_TASK_ID",
    ] {
        command.env_remove(name);
    }
    command.args(["batch", "run", "--json"]).args(manifest).args(more);
    command
}

fn ended(mut command: Command) -> Ended {
    Ended::of(command.output().unwrap())
}

fn status(manifest: &[String; 2], more: &[&str]) -> Value {
    let args = ["batch", "status", "--json", &manifest[0], &manifest[1]];
    succeed(&args.iter().chain(more).copied().collect::<Vec<_>>()).result()
}

fn clip<'a>(report: &'a Value, id: &str) -> &'a Value {
    let clips = report["clips"].as_array().unwrap();
    clips
        .iter()
        .find(|c| c["id"] == id)
        .unwrap_or_else(|| panic!("no {id} in {report}"))
}

/// A worker that is killed and reaped when a test ends early.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended long ago.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn start(mut command: Command) -> Running {
    Running(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap())
}

/// Names of the checkpoints of a clip at work.
fn checkpoints(work: &Path) -> Vec<std::ffi::OsString> {
    let entries = fs::read_dir(work.join("checkpoints")).into_iter().flatten();
    entries.filter_map(|entry| Some(entry.ok()?.file_name())).collect()
}

/// Starts a worker and waits until its run has saved so often that so many checkpoints are new: it is at work by then.
fn start_until_saved(command: Command, work: &Path, n: usize) -> Running {
    let before = checkpoints(work);
    let mut running = start(command);
    while checkpoints(work).iter().filter(|name| !before.contains(name)).count() < n {
        assert!(
            running.0.try_wait().unwrap().is_none(),
            "the worker ended before it could be stopped"
        );
        sleep(Duration::from_millis(2));
    }
    running
}

#[test]
fn good_clips_are_done_and_a_bad_one_is_given_up_once() {
    let dir = Scratch::new();
    write_clips(&dir, 2);
    dir.write("clips/bad.mp4", "no video at all");
    let manifest = plan(&dir, &["--iterations", "20"]);
    let first = ended(worker(&manifest, &[]));
    assert_eq!(first.code, 0, "poison is no failure of the batch: {}", first.stderr);
    let result = first.result();
    assert_eq!(
        (&result["done"], &result["poison"], &result["again"]),
        (&2.into(), &1.into(), &0.into())
    );

    let report = status(&manifest, &["--html", &dir.at("sheet.html")]);
    assert_eq!(
        (&report["counts"]["done"], &report["counts"]["poison"]),
        (&2.into(), &1.into())
    );
    let counts = report["counts"].as_object().unwrap();
    assert_eq!(
        counts.values().filter_map(Value::as_u64).sum::<u64>(),
        report["jobs"].as_u64().unwrap()
    );
    let good = clip(&report, "clip1");
    assert!(
        good["psnr_db"].as_f64().unwrap() > 5.0 && good["splats"].as_u64().unwrap() > 0,
        "{good}"
    );
    assert!(
        good["seconds"].as_f64().unwrap() > 0.0 && good["host"].is_string(),
        "{good}"
    );
    let bad = clip(&report, "bad");
    assert_eq!(bad["code"], 65, "{bad}");
    assert!(bad["reason"].as_str().unwrap().contains("bad.mp4"), "{bad}");
    for file in [
        "run.json",
        "scene.safetensors",
        "preview.mp4",
        "poster.jpg",
        "batch.json",
    ] {
        assert!(dir.path("results/clip2").join(file).is_file(), "{file}");
    }
    assert!(!dir.path("results/bad").exists(), "nothing is published of it");
    let page = fs::read_to_string(dir.path("sheet.html")).unwrap();
    assert_eq!(page.matches("data:image/jpeg;base64,").count(), 2);

    let made = |id: &str| {
        fs::metadata(dir.path("results").join(id).join("run.json"))
            .unwrap()
            .modified()
            .unwrap()
    };
    let before = (made("clip1"), made("clip2"));
    let again = ended(worker(&manifest, &[])).result();
    assert_eq!(
        (&again["done"], &again["done_before"], &again["poison"]),
        (&0.into(), &2.into(), &1.into())
    );
    assert_eq!(before, (made("clip1"), made("clip2")), "nothing was touched");

    // One task of an array: the code tells of its one job.
    let task = |index: &str| ended(worker(&manifest, &["--index", index])).code;
    assert_eq!((task("0"), task("1"), task("2"), task("3")), (65, 0, 0, 66));
    let mut by_engine = worker(&manifest, &[]);
    by_engine.env("SLURM_ARRAY_TASK_ID", "0");
    assert_eq!(ended(by_engine).code, 65);
    let logs = || fs::read_to_string(dir.path("results/.log/bad.txt")).unwrap().len();
    let said = logs();
    assert_eq!(ended(worker(&manifest, &["--retry-failed", "--index", "0"])).code, 65);
    assert!(logs() > said, "it was tried again because that was asked for");

    // Other settings: all is made again, and takes the place of what was there.
    let manifest = plan(&dir, &["--iterations", "21", "--force"]);
    assert_eq!(status(&manifest, &[])["counts"]["waiting"], 3);
    let other = ended(worker(&manifest, &["--scratch", &dir.at("scratch")])).result();
    assert_eq!((&other["done"], &other["poison"]), (&2.into(), &1.into()));
    let run: Value = serde_json::from_slice(&fs::read(dir.path("results/clip1/run.json")).unwrap()).unwrap();
    assert_eq!(run["iterations"], 21);
}

#[test]
fn two_workers_do_every_clip_once() {
    let dir = Scratch::new();
    write_clips(&dir, 4);
    let manifest = plan(&dir, &["--iterations", "40"]);
    let workers: Vec<_> = (0..2)
        .map(|_| {
            let mut command = worker(&manifest, &[]);
            command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
        })
        .collect();
    let results: Vec<Value> = workers
        .into_iter()
        .map(|child| {
            let ended = Ended::of(child.wait_with_output().unwrap());
            assert_eq!(ended.code, 0, "{}", ended.stderr);
            ended.result()
        })
        .collect();
    let sum = |name: &str| results.iter().map(|r| r[name].as_u64().unwrap()).sum::<u64>();
    assert_eq!(
        (sum("done"), sum("done_before"), sum("again")),
        (4, 4, 0),
        "{results:?}"
    );
    for i in 1..=4 {
        let log = fs::read_to_string(dir.path(&format!("results/.log/clip{i}.txt"))).unwrap();
        let trained = log
            .lines()
            .filter(|l| l.contains("\"stage\":\"train\"") && l.contains("\"started\""));
        assert_eq!(trained.count(), 1, "clip{i}: {log}");
    }
    assert_eq!(status(&manifest, &[])["counts"]["done"], 4);
}

#[cfg(unix)]
#[test]
fn after_a_killed_worker_another_goes_on_and_ends_with_the_same_bits() {
    let dir = Scratch::new();
    write_clips(&dir, 1);
    let settings = ["--iterations", "1200", "--set", "checkpoint.every_s=0.02"];
    let (input, whole) = (dir.at("clips/clip1"), dir.at("whole"));
    succeed(&[&["run", &input, "-o", &whole], settings.as_slice()].concat());
    let manifest = plan(&dir, &settings);
    let lease = ["--lease-seconds", "4"];
    let mut running = start_until_saved(worker(&manifest, &lease), &dir.path("results/.work/clip1"), 2);
    assert_eq!(clip(&status(&manifest, &[]), "clip1")["state"], "running");
    let refused = ended(worker(&manifest, &[&lease[..], &["--no-wait"]].concat()));
    assert_eq!(refused.code, 75, "another has it: {}", refused.stderr);
    running.0.kill().unwrap();
    running.0.wait().unwrap();
    assert!(!dir.path("results/clip1").exists(), "nothing half done is published");

    let second = ended(worker(&manifest, &lease));
    assert_eq!(second.code, 0, "{}", second.stderr);
    assert_eq!(second.result()["done"], 1);
    let log = fs::read_to_string(dir.path("results/.log/clip1.txt")).unwrap();
    assert!(log.contains("\"status\":\"resumed\""), "it began anew: {log}");
    let scene = |folder: &str| fs::read(dir.path(folder).join("scene.safetensors")).unwrap();
    assert!(
        scene("whole") == scene("results/clip1"),
        "it must end with the same bits"
    );
    let record: Value = serde_json::from_slice(&fs::read(dir.path("results/.state/clip1.json")).unwrap()).unwrap();
    assert_eq!((&record["verdict"], &record["vanished"]), (&"done".into(), &1.into()));
}

#[cfg(unix)]
#[test]
fn a_worker_that_is_told_to_stop_gives_its_job_back() {
    let dir = Scratch::new();
    write_clips(&dir, 2);
    let manifest = plan(&dir, &["--iterations", "3000", "--set", "checkpoint.every_s=0.02"]);
    for (name, code) in [("-TERM", 75), ("-INT", 130)] {
        let mut running = start_until_saved(worker(&manifest, &[]), &dir.path("results/.work/clip1"), 1);
        let pid = running.0.id().to_string();
        assert!(Command::new("kill").args([name, &pid]).status().unwrap().success());
        assert_eq!(running.0.wait().unwrap().code(), Some(code), "{name}");
        let report = status(&manifest, &[]);
        assert_eq!(clip(&report, "clip1")["state"], "interrupted", "{report}");
        assert_eq!(clip(&report, "clip2")["state"], "waiting", "{report}");
        let run: Value = serde_json::from_slice(&fs::read(dir.path("results/.work/clip1/run.json")).unwrap()).unwrap();
        assert_eq!(run["status"], "stopped", "it saved before it went");
    }
}

#[cfg(unix)]
#[test]
fn what_crashes_again_and_again_is_given_up() {
    use std::os::unix::process::ExitStatusExt;
    let dir = Scratch::new();
    write_clips(&dir, 1);
    let manifest = plan(&dir, &["--iterations", "20"]);
    let mut running = start(worker(&manifest, &["--attempts", "2"]));
    // Every run that appears is killed, as a machine without memory does.
    let mut killed = 0;
    while running.0.try_wait().unwrap().is_none() {
        let found = Command::new("pgrep")
            .args(["-P", &running.0.id().to_string()])
            .output()
            .unwrap();
        for pid in String::from_utf8(found.stdout).unwrap().split_whitespace() {
            let sent = Command::new("kill")
                .args(["-KILL", pid])
                .stderr(Stdio::null())
                .status()
                .unwrap();
            killed += usize::from(sent.success());
        }
        sleep(Duration::from_millis(5));
    }
    assert!(killed >= 2);
    let status_code = running.0.wait().unwrap();
    assert_eq!((status_code.code(), status_code.signal()), (Some(0), None));
    let report = status(&manifest, &["--failed"]);
    let given_up = clip(&report, "clip1");
    assert_eq!(
        (&given_up["state"], &given_up["attempts"]),
        (&"poison".into(), &2.into()),
        "{report}"
    );
    assert!(given_up["reason"].as_str().unwrap().contains("signal 9"), "{report}");
}

#[test]
fn plans_that_cannot_be_made_and_inputs_that_changed() {
    let dir = Scratch::new();
    write_clips(&dir, 1);
    let (clips, out, manifest) = (dir.at("clips"), dir.at("results"), dir.at("jobs.jsonl"));
    let plan_of = |given: &str| ["batch", "plan", given, "-o", &manifest, "--out", &out].map(str::to_owned);
    let refuse = |given: &str, code: i32, words: &[&str]| {
        let args = plan_of(given);
        refused(&args.each_ref().map(String::as_str), code, words);
        assert!(!dir.path("jobs.jsonl").exists());
    };
    refuse(&dir.at("none"), 66, &["there is no", "none"]);
    refuse(&clips, 65, &["holds no video", "--recursive"]);
    refuse("s3://bucket/a.mp4", 65, &["s3://", "mount the store"]);
    fs::create_dir_all(dir.path("results/clip1")).unwrap();
    dir.write("results/clip1/thesis.tex", "mine");
    refuse(&dir.at("clips/clip1"), 73, &["was not made by `minute4d batch`"]);
    fs::remove_dir_all(dir.path("results")).unwrap();

    let named = plan(&dir, &["--iterations", "5"]);
    let again = plan_of(&dir.at("clips/clip1"));
    refused(&again.each_ref().map(String::as_str), 73, &["already there", "--force"]);
    fs::write(dir.path("clips/clip1/name.txt"), "another").unwrap();
    let changed = ended(worker(&named, &["--index", "0"]));
    assert_eq!(changed.code, 65);
    assert!(
        changed.stderr.contains("changed since it was planned"),
        "{}",
        changed.stderr
    );
    dir.write("jobs.jsonl", "{}");
    assert_eq!(call(&["batch", "status", "--manifest", &manifest]).code, 65);
}

/// The environment of the run that a worker started for a clip in `folder`, once there is one.
#[cfg(target_os = "linux")]
fn environment_of_run(folder: &str, worker: &mut Running) -> String {
    loop {
        let processes = fs::read_dir("/proc").unwrap().flatten().map(|entry| entry.path());
        for process in processes {
            let line = String::from_utf8_lossy(&fs::read(process.join("cmdline")).unwrap_or_default()).into_owned();
            // Of a process that is about to become the run the line is still that of the worker.
            if line.contains(folder) && line.contains("--stop-at-eof") {
                return String::from_utf8_lossy(&fs::read(process.join("environ")).unwrap_or_default()).into_owned();
            }
        }
        assert!(worker.0.try_wait().unwrap().is_none(), "the worker ended without a run");
        sleep(Duration::from_millis(1));
    }
}

#[cfg(target_os = "linux")]
#[test]
fn runs_are_not_told_the_credentials_of_the_worker() {
    let dir = Scratch::new();
    write_clips(&dir, 1);
    let manifest = plan(&dir, &["--iterations", "200", "--no-viewer"]);
    let mut command = worker(&manifest, &[]);
    let secrets = [
        ("AWS_SECRET_ACCESS_KEY", "s3cr3t-1"),
        ("HF_TOKEN", "s3cr3t-2"),
        ("HTTPS_PROXY", "http://me:s3cr3t-3@proxy:3128"),
    ];
    command.envs(secrets).env("M4_HARMLESS", "harmless");
    let mut running = start(command);
    let environment = environment_of_run(&dir.at("results"), &mut running);
    assert!(environment.contains("M4_HARMLESS=harmless"), "{environment}");
    assert!(!environment.contains("s3cr3t"), "{environment}");
    assert!(running.0.wait().unwrap().success());
}

#[test]
fn links_out_of_a_capture_are_allowed_by_who_plans() {
    let dir = Scratch::new();
    let manifest = {
        write_clips(&dir, 1);
        plan(&dir, &["--allow-outside", "--iterations", "1"])
    };
    let text = fs::read_to_string(&manifest[1]).unwrap();
    assert!(text.lines().next().unwrap().contains("--allow-outside"), "{text}");
}
