//! Many clips: planned, run job by job, killed, resumed, reported.

use crate::common::{Ended, Running, Scratch, capture, mean_image_psnr_db, write_capture};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

fn write_clips(dir: &Scratch, n: usize) {
    for i in 1..=n {
        write_capture(&dir.path(&format!("clips/clip{i}")), false);
        // Clips of the same bytes would be one clip to the eye that looks at hashes.
        fs::write(dir.path(&format!("clips/clip{i}/name.txt")), i.to_string()).unwrap();
    }
}

fn plan(dir: &Scratch, more: &str) {
    let line = "batch plan clips --recursive -o jobs.jsonl --out results";
    dir.succeed(&format!("{line} {more}"));
}

fn job(dir: &Scratch, more: &str) -> Command {
    let mut command = dir.command(&format!("batch run --json --manifest jobs.jsonl {more}"));
    for name in ["SLURM_ARRAY_TASK_ID", "JOB_COMPLETION_INDEX"] {
        command.env_remove(name);
    }
    command
}

fn ended(mut command: Command) -> Ended {
    Ended::of(command.output().unwrap())
}

fn status(dir: &Scratch, more: &str) -> Value {
    let line = "batch status --json --manifest jobs.jsonl";
    dir.succeed(&format!("{line} {more}")).result()
}

fn clip<'a>(report: &'a Value, id: &str) -> &'a Value {
    let clips = report["clips"].as_array().unwrap();
    clips
        .iter()
        .find(|c| c["id"] == id)
        .unwrap_or_else(|| panic!("no {id} in {report}"))
}

fn start(mut command: Command) -> Running {
    Running(
        command
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap(),
    )
}

/// Names of the checkpoints of a clip at work.
fn checkpoints(work: &Path) -> Vec<std::ffi::OsString> {
    let entries = fs::read_dir(work.join("checkpoints")).into_iter().flatten();
    entries
        .filter_map(|entry| Some(entry.ok()?.file_name()))
        .collect()
}

/// Starts a job and waits until its run has written this many new checkpoints, so that it is
/// running by then.
fn start_until_saved(command: Command, work: &Path, n: usize) -> Running {
    let before = checkpoints(work);
    let mut running = start(command);
    while checkpoints(work)
        .iter()
        .filter(|name| !before.contains(name))
        .count()
        < n
    {
        assert!(
            running.0.try_wait().unwrap().is_none(),
            "the job ended before it could be stopped"
        );
        sleep(Duration::from_millis(2));
    }
    running
}

fn code(dir: &Scratch, index: usize) -> i32 {
    ended(job(dir, &format!("--index {index}"))).code
}

/// What begins as a video does, and is none.
fn write_corrupt(dir: &Scratch, name: &str) {
    let mut bytes = b"\0\0\0\x20ftypisom\0\0\x02\0isomiso2avc1mp41".to_vec();
    bytes.extend((0..20_000_u32).map(|i| (i * i % 251) as u8));
    dir.write(name, bytes);
}

#[test]
fn corrupt_clip_fails_permanently_and_others_finish() {
    let dir = Scratch::new();
    write_clips(&dir, 2);
    write_corrupt(&dir, "clips/bad.mp4");
    plan(&dir, "--iterations 20");
    let bad = ended(job(&dir, "--index 0"));
    assert_eq!(bad.code, 65, "{}", bad.stderr);
    assert_eq!(bad.result()["outcome"], "failed");
    let mut by_scheduler = job(&dir, "");
    by_scheduler.env("SLURM_ARRAY_TASK_ID", "1");
    assert_eq!(ended(by_scheduler).code, 0);
    let good = ended(job(&dir, "--index 2"));
    assert_eq!(
        (good.code, &good.result()["outcome"]),
        (0, &"done".into()),
        "{}",
        good.stderr
    );

    let report = status(&dir, "--html sheet.html");
    dir.write("mine.html", "mine");
    dir.refused(
        "batch status --manifest jobs.jsonl --html mine.html",
        73,
        &["mine.html", "no list names it as a result of minute4d"],
    );
    assert_eq!(dir.read("mine.html"), b"mine");
    let counts = report["counts"].as_object().unwrap();
    assert_eq!((&counts["done"], &counts["failed"]), (&2.into(), &1.into()));
    let sum: u64 = counts.values().filter_map(Value::as_u64).sum();
    assert_eq!(sum, report["jobs"].as_u64().unwrap());
    let good = clip(&report, "clip1");
    // the score is that of the training frames
    let frames = capture(6, false).frames;
    let trivial = mean_image_psnr_db(&frames, frames.iter().map(|f| f.rgb.clone()), usize::MAX);
    let psnr = good["psnr_db"].as_f64().unwrap();
    assert!(
        psnr > trivial + 3.0,
        "{psnr} dB, the mean image {trivial} dB: {good}"
    );
    assert!(good["splats"].as_u64().unwrap() > 0, "{good}");
    assert!(
        good["seconds"].as_f64().unwrap() > 0.0 && good["host"].is_string(),
        "{good}"
    );
    let bad = clip(&report, "bad");
    assert!(
        bad["code"] == 65 && bad["reason"].as_str().unwrap().contains("bad.mp4"),
        "{bad}"
    );
    let page = fs::read_to_string(dir.path("sheet.html")).unwrap();
    assert_eq!(page.matches("data:image/jpeg;base64,").count(), 2);
    assert!(page.contains("bad.mp4") && !page.contains("http"));
    for file in [
        "run.json",
        "scene.safetensors",
        "preview.mp4",
        "poster.jpg",
        "batch.json",
    ] {
        assert!(dir.path("results/clip2").join(file).is_file(), "{file}");
    }
    assert!(
        !dir.path("results/bad").exists(),
        "nothing is published of it"
    );

    // What has ended is not run again.
    let scene_time = |id: &str| {
        fs::metadata(dir.path("results").join(id).join("scene.safetensors"))
            .unwrap()
            .modified()
            .unwrap()
    };
    let log_length = || {
        fs::read_to_string(dir.path("results/.log/bad.txt"))
            .unwrap()
            .len()
    };
    let (before, log) = ((scene_time("clip1"), scene_time("clip2")), log_length());
    assert_eq!([0, 1, 2, 3].map(|index| code(&dir, index)), [65, 0, 0, 66]);
    assert_eq!(
        (before, log),
        ((scene_time("clip1"), scene_time("clip2")), log_length()),
        "nothing was touched"
    );
    assert_eq!(ended(job(&dir, "--retry-failed --index 0")).code, 65);
    assert!(
        log_length() > log,
        "it was run again because that was asked for"
    );
    let which = ended(job(&dir, ""));
    assert!(
        which.code == 2 && which.stderr.contains("--index from 0 to 2"),
        "{}",
        which.stderr
    );

    // Other settings: all is made again, and takes the place of what was there.
    plan(&dir, "--iterations 21 --force");
    assert_eq!(status(&dir, "")["counts"]["waiting"], 3);
    assert_eq!([0, 1, 2].map(|index| code(&dir, index)), [65, 0, 0]);
    assert_eq!(dir.json("results/clip1/run.json")["iterations"], 21);
}

/// The environment of a child of the process `parent`.
#[cfg(target_os = "linux")]
fn environment_of_child(parent: u32) -> String {
    let processes = fs::read_dir("/proc")
        .unwrap()
        .filter_map(|entry| Some(entry.ok()?.path()));
    let child = processes.into_iter().find(|folder| {
        let status = fs::read_to_string(folder.join("status")).unwrap_or_default();
        status
            .lines()
            .any(|line| line == format!("PPid:\t{parent}"))
    });
    fs::read_to_string(child.unwrap().join("environ")).unwrap()
}

#[cfg(target_os = "linux")]
#[test]
fn run_of_a_job_sees_no_keys_of_who_started_it() {
    let dir = Scratch::new();
    write_clips(&dir, 1);
    plan(&dir, "--iterations 100000 --set checkpoint.every_s=0.02");
    let mut command = job(&dir, "--index 0");
    command
        .env("AWS_SECRET_ACCESS_KEY", "abc")
        .env("HF_TOKEN", "def")
        .env("LC_ALL", "C")
        .env("RAYON_NUM_THREADS", "2");
    let running = start_until_saved(command, &dir.path("results/.work/clip1"), 1);
    let environment = environment_of_child(running.0.id());
    let names: Vec<&str> = environment
        .split_terminator('\0')
        .filter_map(|pair| Some(pair.split_once('=')?.0))
        .collect();
    for name in ["PATH", "LC_ALL", "RAYON_NUM_THREADS", "MINUTE4D_WEIGHTS"] {
        assert!(names.contains(&name), "{name} is needed: {names:?}");
    }
    for name in ["AWS_SECRET_ACCESS_KEY", "HF_TOKEN"] {
        assert!(!names.contains(&name), "{name} is passed on: {names:?}");
    }
}

#[cfg(unix)]
#[test]
fn killed_job_resumes_to_identical_bits() {
    let dir = Scratch::new();
    write_clips(&dir, 1);
    let settings = "--iterations 500 --set checkpoint.every_s=0.02";
    dir.succeed(&format!("run clips/clip1 -o whole {settings}"));
    plan(&dir, settings);
    let mut running =
        start_until_saved(job(&dir, "--index 0"), &dir.path("results/.work/clip1"), 2);
    running.0.kill().unwrap();
    running.0.wait().unwrap();
    assert!(
        !dir.path("results/clip1").exists(),
        "nothing half done is published"
    );
    assert_eq!(clip(&status(&dir, ""), "clip1")["state"], "waiting");

    let second = ended(job(&dir, "--index 0"));
    assert_eq!(second.code, 0, "{}", second.stderr);
    let log = fs::read_to_string(dir.path("results/.log/clip1.txt")).unwrap();
    assert!(
        log.contains("\"status\":\"resumed\""),
        "it began anew: {log}"
    );
    assert!(
        dir.read("whole/scene.safetensors") == dir.read("results/clip1/scene.safetensors"),
        "it must end with the same bits"
    );
}

#[cfg(unix)]
#[test]
fn stopped_job_saves_and_can_be_rerun() {
    let dir = Scratch::new();
    write_clips(&dir, 1);
    plan(&dir, "--iterations 3000 --set checkpoint.every_s=0.02");
    for (name, code) in [("-TERM", 75), ("-INT", 130)] {
        let mut running =
            start_until_saved(job(&dir, "--index 0"), &dir.path("results/.work/clip1"), 1);
        running.signal(name);
        assert_eq!(running.0.wait().unwrap().code(), Some(code), "{name}");
        let report = status(&dir, "");
        assert_eq!(clip(&report, "clip1")["state"], "retryable", "{report}");
        let run = dir.json("results/.work/clip1/run.json");
        assert_eq!(run["status"], "stopped", "it saved before it went");
    }
}

/// The system's out-of-memory killer ends the run with SIGKILL, not the job that started it.
#[cfg(target_os = "linux")]
#[test]
fn out_of_memory_job_can_be_rerun() {
    let dir = Scratch::new();
    write_clips(&dir, 1);
    plan(&dir, "--iterations 3000 --set checkpoint.every_s=0.02");
    let mut running =
        start_until_saved(job(&dir, "--index 0"), &dir.path("results/.work/clip1"), 1);
    let output = Command::new("pgrep")
        .args(["-P", &running.0.id().to_string()])
        .output()
        .unwrap();
    for pid in String::from_utf8(output.stdout).unwrap().split_whitespace() {
        assert!(
            Command::new("kill")
                .args(["-KILL", pid])
                .status()
                .unwrap()
                .success()
        );
    }
    assert_eq!(running.0.wait().unwrap().code(), Some(75));
    let report = status(&dir, "--failed");
    let killed = clip(&report, "clip1");
    assert!(
        killed["state"] == "retryable"
            && killed["reason"].as_str().unwrap().contains("out of memory"),
        "{report}"
    );
}

#[cfg(target_os = "linux")]
#[test]
fn machine_failures_are_not_counted_against_the_clip() {
    let dir = Scratch::new();
    fs::create_dir_all(dir.path("clips")).unwrap();
    // A Matroska file: ffmpeg must decode it.
    dir.write("clips/clip1.mkv", [0x1a, 0x45, 0xdf, 0xa3, 0, 0, 0, 0]);
    plan(&dir, "--iterations 20 --set video.decoder.idle_seconds=1");
    let run = |words: &str, wanted: i32| {
        let mut command = job(&dir, "--index 0");
        // No other ffmpeg; the shell finds `kill` and `sleep` in it or by their places.
        command.env("PATH", dir.at("bin"));
        let ended = ended(command);
        assert_eq!(ended.code, wanted, "{words}: {}", ended.stderr);
        assert!(ended.stderr.contains(words), "{words}: {}", ended.stderr);
        let state = clip(&status(&dir, ""), "clip1")["state"].clone();
        assert_eq!(state == "failed", wanted == 65, "{words}: {state}");
    };
    run("install ffmpeg", 75);
    for (body, words) in [
        // as the system does where memory runs out
        ("kill -KILL $$", "SIGKILL"),
        ("exec /bin/sleep 600", "nothing came from it"),
        ("echo 'Cannot allocate memory' >&2; exit 1", "more memory"),
        (
            "echo 'clip1.mkv: Input/output error' >&2; exit 1",
            "Input/output error",
        ),
        (
            "echo 'error while loading shared libraries: x.so' >&2; exit 127",
            "shared libraries",
        ),
    ] {
        dir.install("ffprobe", body);
        run(words, 75);
    }
    // A machine where the disks are not mounted.
    for name in ["clips", "jobs.jsonl", "results"] {
        fs::rename(dir.path(name), dir.path("away")).unwrap();
        assert_eq!(code(&dir, 0), 75, "{name}");
        assert!(!dir.path(name).exists());
        fs::rename(dir.path("away"), dir.path(name)).unwrap();
    }
    // The same clip, decoded: only now its own bytes speak against it.
    dir.install(
        "ffprobe",
        "echo 'clip1.mkv: Invalid data found when processing input' >&2; exit 1",
    );
    run("Invalid data", 65);
    dir.install("ffprobe", "kill -KILL $$");
    run("not run again without --retry-failed", 65);
}

#[test]
fn invalid_plans_and_changed_inputs_are_rejected() {
    let dir = Scratch::new();
    write_clips(&dir, 1);
    let plan_of = |arguments: &str, code: i32, words: &[&str]| {
        let line = format!("batch plan {arguments} -o jobs.jsonl --out results");
        dir.refused(&line, code, words);
    };
    plan_of("none", 66, &["there is no", "none"]);
    plan_of("clips", 65, &["holds no video", "--recursive"]);
    plan_of("s3://bucket/a.mp4", 65, &["s3://", "mount the store"]);
    fs::create_dir_all(dir.path("results/clip1")).unwrap();
    dir.write("results/clip1/thesis.tex", "mine");
    plan_of("clips/clip1", 73, &["was not created by `minute4d batch`"]);
    assert!(!dir.path("jobs.jsonl").exists());
    fs::remove_dir_all(dir.path("results")).unwrap();

    plan(&dir, "--iterations 5");
    plan_of("clips/clip1", 73, &["already exists", "--force"]);
    fs::write(dir.path("clips/clip1/name.txt"), "another").unwrap();
    let changed = ended(job(&dir, "--index 0"));
    assert_eq!(changed.code, 75);
    assert!(
        changed.stderr.contains("not what was planned"),
        "{}",
        changed.stderr
    );
    dir.write("jobs.jsonl", "{}");
    assert_eq!(dir.call("batch status --manifest jobs.jsonl").code, 65);
    assert_eq!(code(&dir, 0), 78, "65 is for clips");
}

#[test]
fn outside_links_need_permission_of_the_plan() {
    let dir = Scratch::new();
    write_clips(&dir, 1);
    plan(&dir, "--allow-outside --iterations 1");
    let text = fs::read_to_string(dir.path("jobs.jsonl")).unwrap();
    assert!(
        text.lines().next().unwrap().contains("--allow-outside"),
        "{text}"
    );
}
