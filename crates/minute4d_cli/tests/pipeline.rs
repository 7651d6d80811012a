//! The happy path from outside: train, render, eval, inspect, stop, resume.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::common::{
    Ended, Running, Scratch, capture, mean_image_psnr_db, program, refused, succeed, text, train, write_capture,
    write_images,
};
use minute4d::Silent;
use minute4d::core::{Sim3, exp_so3, nalgebra::Vector3};
use minute4d::io::capture::Split;
use serde_json::Value;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{ChildStdout, Command, Stdio};

fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

#[test]
fn train_render_eval_inspect() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), true);
    let (data, out) = (dir.at("capture"), dir.at("out"));
    let ended = train(&data, &out, "120", &["--seed", "3"]);
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    assert_eq!(ended.stdout.trim_end(), out, "the result is the path and nothing else");

    let record = read_json(&dir.path("out/run.json"));
    assert_eq!(record["status"], "finished");
    assert_eq!((&record["seed"], &record["iterations"]), (&3.into(), &120.into()));
    assert_eq!(record["settings"]["train"]["seed"], 3);
    assert!(record["stages"]["train"]["seconds"].as_f64().unwrap() > 0.0);
    assert!(record["splats"]["static"].as_u64().unwrap() > 0 && record["splats"]["dynamic"].as_u64().unwrap() > 0);
    assert!(fs::metadata(dir.path("out/preview.mp4")).unwrap().len() > 1000);
    let metrics = fs::read_to_string(dir.path("out/metrics.jsonl")).unwrap();
    let losses: Vec<f64> = metrics
        .lines()
        .map(|l| serde_json::from_str::<Value>(l).unwrap()["loss"].as_f64().unwrap())
        .collect();
    assert!(losses.len() >= 2 && losses.last() < losses.first(), "{losses:?}");
    assert!(!dir.path("out/checkpoints").exists(), "nothing is left over");

    let (png, mp4) = (dir.at("png"), dir.at("swing.mp4"));
    succeed(&["render", &out, "-o", &png]);
    assert_eq!(fs::read_dir(&png).unwrap().count(), 6);
    succeed(&["render", &out, "--path", "swing", "--time", "freeze@0.2s", "-o", &mp4]);
    let list = format!("test:{data}/transforms_test.json");
    succeed(&["render", &out, "--path", &list, "--time", "5..0", "-o", &dir.at("test")]);
    assert_eq!(fs::read_dir(dir.path("test")).unwrap().count(), 6);

    let report = succeed(&["eval", &out, "--data", &data, "--json"]).result();
    let psnr = report["mean"]["psnr_db"].as_f64().unwrap();
    let held_out = capture(6, true).frames.into_iter().map(|f| f.rgb);
    let trivial = mean_image_psnr_db(&capture(6, false).frames, held_out, usize::MAX);
    assert!(psnr > trivial + 3.0, "{psnr} dB, the mean image {trivial} dB");
    assert!(report["mean"]["masked_psnr_db"].is_number() && report["mean"]["masked_ssim"].is_number());
    assert_eq!(read_json(&dir.path("out/eval.json"))["mean"], report["mean"]);

    assert_eq!(succeed(&["inspect", &out, "--json"]).result()["kind"], "run");
    assert_eq!(succeed(&["inspect", &data, "--json"]).result()["test_views"], 6);
    assert_eq!(succeed(&["inspect", &mp4, "--json"]).result()["frames"], 120);
    let scene = dir.at("out/scene.safetensors");
    assert_eq!(succeed(&["inspect", &scene, "--json"]).result()["with_optimiser"], true);
    let same = succeed(&["eval-geometry", &data, "--truth", &data, "--json"]).result();
    assert!(same["trajectory"]["rmse"].as_f64().unwrap() < 1e-6, "{same}");
}

#[test]
fn held_out_views_are_aligned_to_an_own_world() {
    let dir = Scratch::new();
    write_capture(&dir.path("truth"), true);
    let mut own = capture(6, false);
    let map = Sim3 {
        scale: 2.5,
        rotation: exp_so3(&Vector3::new(0.4, -0.9, 0.2)),
        translation: Vector3::new(3.0, -1.0, 2.0),
    };
    for frame in &mut own.frames {
        frame.camera.c2w = map.transform_pose(&frame.camera.c2w);
        frame.depth = frame.depth.as_ref().map(|d| d.to_map().map(|z| z * 2.5).into());
    }
    minute4d::io::capture::write(&dir.path("own"), &own, Split::Train, &Silent).unwrap();
    let score = |data: &str, out: &str| {
        let out = dir.at(out);
        assert_eq!(train(&dir.at(data), &out, "120", &[]).code, 0);
        let ended = succeed(&["eval", &out, "--data", &dir.at("truth"), "--json"]);
        (ended.result(), ended.stderr)
    };
    let (same, quiet) = score("truth", "same");
    let (moved, warned) = score("own", "moved");
    assert!(
        same["alignment"].is_null() && !quiet.contains("world of its own"),
        "{quiet}"
    );
    assert!(
        (moved["alignment"]["scale"].as_f64().unwrap() - 2.5).abs() < 1e-3,
        "{moved}"
    );
    assert!(warned.contains("world of its own"), "{warned}");
    let psnr = |report: &Value| report["mean"]["psnr_db"].as_f64().unwrap();
    assert!(
        (psnr(&same) - psnr(&moved)).abs() < 1.5,
        "{} and {} dB",
        psnr(&same),
        psnr(&moved)
    );
}

#[test]
fn scene_is_independent_of_the_number_of_threads() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let scene = |threads: &str| {
        let out = dir.at(&format!("out{threads}"));
        let more = [
            "--threads",
            threads,
            "--set",
            "train.density.from=20",
            "--set",
            "train.density.every=20",
        ];
        let ended = train(&dir.at("capture"), &out, "80", &more);
        assert_eq!(ended.code, 0, "{}", ended.stderr);
        fs::read(Path::new(&out).join("scene.safetensors")).unwrap()
    };
    let (one, two, three) = (scene("1"), scene("2"), scene("3"));
    assert!(one == two && two == three, "the files differ");
}

/// Starts training and waits for its first steps; gives the rest of its events.
fn start(data: &str, out: &str, iterations: &str, more: &[&str]) -> (Running, BufReader<ChildStdout>) {
    let args = ["train", data, "-o", out, "--iterations", iterations, "--json"];
    let mut command = program();
    command
        .args(args)
        .args(more)
        .stdout(Stdio::piped())
        .stderr(Stdio::null());
    let mut running = Running(command.spawn().unwrap());
    let mut events = BufReader::new(running.0.stdout.take().unwrap());
    let mut line = String::new();
    loop {
        line.clear();
        assert!(
            events.read_line(&mut line).unwrap() > 0,
            "the program ended before it trained"
        );
        let event: Value = serde_json::from_str(&line).unwrap();
        if event["phase"] == "train" && event["done"].as_u64().unwrap() > 0 {
            return (running, events);
        }
    }
}

#[cfg(unix)]
fn signal(running: &Running, name: &str) {
    let status = Command::new("kill")
        .args([name, &running.0.id().to_string()])
        .status()
        .unwrap();
    assert!(status.success());
}

#[cfg(unix)]
#[test]
fn signal_saves_and_resume_gives_identical_bits() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let (data, whole, parts) = (dir.at("capture"), dir.at("whole"), dir.at("parts"));
    assert_eq!(train(&data, &whole, "600", &[]).code, 0);

    for (name, code) in [("-INT", 130), ("-TERM", 143)] {
        let more: &[&str] = if name == "-INT" { &[] } else { &["--resume"] };
        let (mut running, rest) = start(&data, &parts, "600", more);
        signal(&running, name);
        let rest: Vec<String> = rest.lines().map(Result::unwrap).collect();
        assert_eq!(running.0.wait().unwrap().code(), Some(code));
        let end: Value = serde_json::from_str(rest.last().unwrap()).unwrap();
        assert_eq!((&end["ok"], &end["code"]), (&false.into(), &code.into()));
        assert!(end["reason"].as_str().unwrap().contains("--resume"), "{end}");
        assert!(fs::read_dir(dir.path("parts/checkpoints")).unwrap().count() > 0);
        assert!(
            !dir.path("parts/scene.safetensors").exists(),
            "an unfinished run has no result"
        );
        assert_eq!(read_json(&dir.path("parts/run.json"))["status"], "stopped");
    }
    let ended = train(&data, &parts, "600", &["--resume", "--json"]);
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    let events = ended.events();
    let resumed = events
        .iter()
        .find(|e| e["status"] == "resumed")
        .expect("training started anew");
    assert!(resumed["done"].as_u64().unwrap() > 0, "{resumed}");
    let same = |name: &str| {
        fs::read(dir.path(&format!("whole/{name}"))).unwrap() == fs::read(dir.path(&format!("parts/{name}"))).unwrap()
    };
    assert!(same("scene.safetensors"), "a resumed run must end with the same bits");
}

#[cfg(unix)]
#[test]
fn killed_run_resumes_from_its_last_checkpoint() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let (data, whole, parts) = (dir.at("capture"), dir.at("whole"), dir.at("parts"));
    assert_eq!(train(&data, &whole, "1200", &[]).code, 0);
    let often = ["--set", "checkpoint.every_s=0.02"];
    let (mut running, _rest) = start(&data, &parts, "1200", &often);
    let saved = dir.path("parts/checkpoints");
    while fs::read_dir(&saved).map_or(0, Iterator::count) < 2 {
        assert!(
            running.0.try_wait().unwrap().is_none(),
            "it ended before it could be killed"
        );
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let second = train(&data, &parts, "1200", &["--resume"]);
    assert_eq!(second.code, 75, "one folder, one process: {}", second.stderr);
    assert!(second.stderr.contains("another minute4d is using"));
    signal(&running, "-KILL");
    running.0.wait().unwrap();
    let left = fs::read_dir(&saved).unwrap().filter(|e| {
        e.as_ref()
            .is_ok_and(|e| e.path().extension().is_some_and(|x| x == "safetensors"))
    });
    assert!(
        (1..=3).contains(&left.count()),
        "the last two are kept, a third while it replaces the first"
    );
    assert_eq!(read_json(&dir.path("parts/run.json"))["status"], "running");

    let refused = train(&data, &parts, "1200", &[]);
    assert_eq!(refused.code, 73);
    assert!(refused.stderr.contains("an unfinished run") && refused.stderr.contains("--resume"));
    let ended = train(&data, &parts, "1200", &["--resume", "--json"]);
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    assert!(ended.events().iter().any(|e| e["status"] == "resumed"));
    let scene = |run: &str| fs::read(dir.path(run).join("scene.safetensors")).unwrap();
    assert!(
        scene("whole") == scene("parts"),
        "a resumed run must end with the same bits"
    );
}

#[test]
fn finished_stages_are_reused_unless_inputs_or_settings_change() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let (data, out) = (dir.at("capture"), dir.at("out"));
    let stages = |ended: &Ended| -> Vec<String> {
        assert_eq!(ended.code, 0, "{}", ended.stderr);
        let events = ended.events();
        let stages = events
            .iter()
            .filter(|e| e["event"] == "stage" && e["status"] != "finished");
        stages
            .map(|e| format!("{} {} {}", e["stage"], e["status"], e["because"]).replace('"', ""))
            .collect()
    };
    let first = stages(&train(&data, &out, "20", &["--json"]));
    assert_eq!(
        first,
        ["train started null", "preview started null", "viewer started null"]
    );
    let again = stages(&train(&data, &out, "20", &["--json", "--resume"]));
    assert_eq!(
        again,
        ["train reused null", "preview reused null", "viewer reused null"]
    );
    let more = stages(&train(&data, &out, "21", &["--json", "--resume"]));
    assert_eq!(more[0], "train started because the settings changed");

    let mut changed = capture(6, false);
    changed.frames[2].rgb.data_mut()[5] = [1, 2, 3];
    minute4d::io::capture::write(&dir.path("capture"), &changed, Split::Train, &Silent).unwrap();
    let other = stages(&train(&data, &out, "21", &["--json", "--resume"]));
    assert_eq!(other[0], "train started because the input changed");

    fs::write(dir.path("out/metrics.jsonl"), "gone").unwrap();
    let damaged = stages(&train(&data, &out, "21", &["--json", "--resume"]));
    assert_eq!(
        damaged[0],
        "train started because its files are missing or were changed"
    );
}

#[test]
fn force_replaces_a_run_and_leaves_other_files() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    let (data, out) = (dir.at("capture"), dir.at("out"));
    fs::create_dir(dir.path("out")).unwrap();
    let mine = dir.write("out/notes.txt", "mine");
    assert_eq!(train(&data, &out, "10", &[]).code, 73);
    assert_eq!(train(&data, &out, "10", &["--force"]).code, 0);
    assert_eq!(train(&data, &out, "10", &["--force"]).code, 0);
    assert_eq!(fs::read_to_string(mine).unwrap(), "mine");
}

#[test]
fn printed_settings_are_a_settings_file() {
    let dir = Scratch::new();
    for (profile, other) in [("fast", "faithful"), ("faithful", "fast")] {
        let printed = succeed(&[
            "train",
            "--print-config",
            "--profile",
            profile,
            "--set",
            "init.keyframe_gaps=0.25",
        ])
        .stdout;
        assert!(printed.contains("keyframe_gaps = 0.25"), "{printed}");
        let file = dir.write("settings.toml", &printed);
        let again = succeed(&["run", "--print-config", "--config", &file]).stdout;
        assert_eq!(printed, again);
        let both = ["run", "--print-config", "--profile", other, "--config", &file];
        refused(&both, 78, &["profile", "fast", "faithful"]);
    }
    let layers = [
        "train",
        "--print-config",
        "--set",
        "train.iterations=5",
        "--iterations",
        "6",
    ];
    assert!(
        succeed(&layers).stdout.contains("iterations = 6"),
        "an option with its own name is the last word"
    );
}

#[test]
fn closed_stdout_pipe_is_not_a_failure() {
    let mut child = program()
        .args(["train", "--print-config"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());
}

#[test]
fn doctor_and_bench_report_the_machine() {
    let machine = succeed(&["doctor", "--json"]).result();
    assert!(machine["threads"].as_u64().unwrap() >= 1 && machine["simd"].is_string());
    let levels = machine["simd_available"].as_array().unwrap();
    assert!(levels.contains(&machine["simd"]), "{machine}");
    let without = Ended::of(program().args(["doctor", "--json"]).env("PATH", "").output().unwrap());
    assert_eq!(without.result()["ffmpeg"]["found"], false);
    let dir = Scratch::new();
    let runs = dir.at("runs");
    let args = [
        "bench",
        "--splats",
        "500,1000",
        "--size",
        "96x72",
        "--steps",
        "1",
        "--threads",
        "1",
        "--json",
        "--save",
        &runs,
    ];
    let bench = succeed(&args).result();
    let cases = bench["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 4, "two sizes, two scenes: {bench}");
    for case in cases {
        assert!(case["step"]["ms"].as_f64().unwrap() > 0.0 && case["frames_per_s"].as_f64().unwrap() > 0.0);
        assert!((0.0..1.0).contains(&case["useful_share"].as_f64().unwrap()), "{case}");
        assert_eq!(case["kernels"].as_array().unwrap().len(), 7);
    }
    let mut saved: Vec<_> = fs::read_dir(dir.path("runs"))
        .unwrap()
        .map(|e| e.unwrap().path())
        .collect();
    saved.sort();
    assert_eq!(saved.len(), 2, "{saved:?}");
    assert_eq!(read_json(&saved[0]), bench);
}

#[test]
fn static_camera_gives_a_scene() {
    let dir = Scratch::new();
    write_images(&dir.path("images"), 6);
    let (input, out) = (dir.at("images"), dir.at("out"));
    let args = [
        "run",
        &input,
        "-o",
        &out,
        "--static-camera",
        "--fov",
        "56",
        "--iterations",
        "15",
        "--json",
    ];
    let ended = succeed(&args);
    ended.end();
    let record = read_json(&dir.path("out/run.json"));
    for stage in ["geometry", "train", "preview", "viewer"] {
        assert_eq!(record["stages"][stage]["done"], true, "{record}");
    }
    assert!(
        !record["warnings"].as_array().unwrap().is_empty(),
        "placeholder depth is reported"
    );
    for file in [
        "scene.safetensors",
        "preview.mp4",
        "viewer.html",
        "metrics.jsonl",
        "capture/transforms_train.json",
    ] {
        assert!(dir.path("out").join(file).is_file(), "{file}");
    }
    let again: Vec<&str> = args.iter().copied().chain(["--resume"]).collect();
    let events = succeed(&again).events();
    let reused = events.iter().filter(|e| e["status"] == "reused").count();
    assert_eq!(reused, 4, "{events:?}");
    assert_eq!(text(&dir.path("out")), out);
}

/// A time for training is a number of iterations: asked for by that number, the run ends with the same bits.
#[test]
fn timed_run_is_reproduced_by_its_iterations() {
    let dir = Scratch::new();
    write_capture(&dir.path("data"), true);
    let (data, timed, counted) = (dir.at("data"), dir.at("timed"), dir.at("counted"));
    succeed(&["train", &data, "-o", &timed, "--set", "train.budget_s=0.2"]);
    let n = read_json(&dir.path("timed/run.json"))["iterations"].as_u64().unwrap();
    assert!(n >= 50);
    succeed(&["train", &data, "-o", &counted, "--iterations", &n.to_string()]);
    let scene = |run: &str| fs::read(dir.path(run).join("scene.safetensors")).unwrap();
    assert!(scene("timed") == scene("counted"), "{n} iterations differ");
}

#[test]
fn iterations_disable_the_default_time_budget() {
    let budget = |more: &[&str]| {
        let out = succeed(&[&["train", "--print-config"], more].concat()).stdout;
        let line = out.lines().find(|l| l.starts_with("budget_s")).unwrap().to_owned();
        line["budget_s = ".len()..].parse::<f64>().unwrap()
    };
    assert_eq!(budget(&[]), 60.0);
    assert_eq!(budget(&["--preset", "draft"]), 10.0);
    assert_eq!(budget(&["--iterations", "5"]), 0.0);
    // the number that it would have been anyway is asked for too
    assert_eq!(budget(&["--set", "train.iterations=2000"]), 0.0);
    assert_eq!(
        budget(&["--set", "train.iterations=9", "--set", "train.budget_s=7"]),
        7.0
    );
    assert_eq!(budget(&["--profile", "faithful"]), 0.0);
    let both = ["train", "--print-config", "--profile", "faithful", "--preset", "draft"];
    refused(&both, 2, &["--preset", "fast profile", "--iterations"]);
}
