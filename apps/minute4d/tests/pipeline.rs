//! The happy path from outside: train, render, eval, stop, resume.

use crate::common::{
    Ended, Running, Scratch, capture, capture_with_near_objects, frames_of, mean_image_psnr_db,
    write_capture, write_images,
};
use m4_core::{Sim3, exp_so3, nalgebra::Vector3};
use m4_io::capture::Split;
use m4_io::scene::safetensors;
use minute4d::Silent;
use serde_json::Value;
use std::fs;
use std::io::{BufRead, BufReader};
use std::process::{ChildStdout, Stdio};

fn with_capture(with_test: bool) -> Scratch {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), with_test);
    dir
}

#[test]
fn train_render_eval() {
    let dir = with_capture(true);
    let ended = dir.succeed("train capture -o out --iterations 120 --seed 3");
    assert_eq!(
        ended.stdout.trim_end(),
        "out",
        "the result is the path and nothing else"
    );

    let record = dir.json("out/run.json");
    assert_eq!(record["status"], "finished");
    assert_eq!(
        (&record["seed"], &record["iterations"]),
        (&3.into(), &120.into())
    );
    assert_eq!(record["settings"]["train"]["seed"], 3);
    assert!(record["stages"]["train"]["seconds"].as_f64().unwrap() > 0.0);
    assert!(
        record["splats"]["static"].as_u64().unwrap() > 0
            && record["splats"]["dynamic"].as_u64().unwrap() > 0
    );
    assert!(dir.read("out/preview.mp4").len() > 1000);
    let metrics = fs::read_to_string(dir.path("out/metrics.jsonl")).unwrap();
    let losses: Vec<f64> = metrics
        .lines()
        .map(|l| {
            serde_json::from_str::<Value>(l).unwrap()["loss"]
                .as_f64()
                .unwrap()
        })
        .collect();
    assert!(
        losses.len() >= 2 && losses.last() < losses.first(),
        "{losses:?}"
    );
    assert!(
        !dir.path("out/checkpoints").exists(),
        "nothing is left over"
    );

    dir.succeed("render out -o png");
    assert_eq!(dir.count("png"), 6);
    dir.succeed("render out --path swing --time freeze@0.2s -o swing.mp4");
    dir.succeed("render out --path test:capture/transforms_test.json --time play -o test");
    assert_eq!(dir.count("test"), 6);

    let report = dir.succeed("eval out --data capture --json").result();
    let psnr = report["mean"]["psnr_db"].as_f64().unwrap();
    let held_out = capture(6, true).frames.into_iter().map(|f| f.rgb);
    let trivial = mean_image_psnr_db(&capture(6, false).frames, held_out, usize::MAX);
    assert!(
        psnr > trivial + 3.0,
        "{psnr} dB, the mean image {trivial} dB"
    );
    assert!(
        report["mean"]["masked_psnr_db"].is_number() && report["mean"]["masked_ssim"].is_number()
    );
    assert_eq!(dir.json("out/eval.json")["mean"], report["mean"]);

    // views near the training camera have rows of their own; here they are the same views
    fs::copy(
        dir.path("capture/transforms_test.json"),
        dir.path("capture/transforms_near.json"),
    )
    .unwrap();
    let both = dir.succeed("eval out --data capture --json").result();
    let sets: Vec<&Value> = both["sets"].as_array().unwrap().iter().collect();
    let of = |name: &str| {
        sets.iter()
            .find(|set| set["set"] == name)
            .map(|set| &set["mean"])
    };
    assert_eq!(
        (of("far"), of("near"), of("between")),
        (Some(&report["mean"]), Some(&report["mean"]), None),
        "{both}"
    );
    assert!(of("far").unwrap()["static_psnr_db"].is_number());
    let table = dir.succeed("eval out --data capture").stdout;
    assert!(table.contains("near") && table.contains("LPIPS"), "{table}");

    assert_eq!(frames_of(&dir.path("swing.mp4")).0, 120);
    let scene = safetensors::read(&dir.path("out/scene.safetensors")).unwrap();
    assert!(
        scene.state.is_none(),
        "only checkpoints have the state of the optimiser"
    );
}

#[test]
fn baselines_need_no_training() {
    let dir = with_capture(true);
    let own = capture_with_near_objects();
    m4_io::capture::write(&dir.path("own"), &own, Split::Train, &Silent).unwrap();
    dir.succeed("train own -o out --iterations 10 --no-viewer");
    let report = dir.succeed("eval out --data capture --json").result();
    let baselines = report["baselines"].as_array().unwrap();
    let names: Vec<&str> = baselines
        .iter()
        .map(|b| b["name"].as_str().unwrap())
        .collect();
    assert_eq!(names.len(), 3, "{names:?}");
    let dynamic = |k: usize| baselines[k]["mean"]["masked_psnr_db"].as_f64().unwrap();
    assert!(
        dynamic(0) > dynamic(2),
        "true depth is better than one colour: {report}"
    );
    assert!(!report["aligned"].as_array().unwrap().is_empty());
}

#[test]
fn held_out_views_are_aligned_to_an_own_world() {
    let dir = with_capture(true);
    let mut own = capture(6, false);
    let map = Sim3 {
        scale: 2.5,
        rotation: exp_so3(&Vector3::new(0.4, -0.9, 0.2)),
        translation: Vector3::new(3.0, -1.0, 2.0),
    };
    for frame in &mut own.frames {
        frame.camera.c2w = map.transform_pose(&frame.camera.c2w);
        frame.depth = frame
            .depth
            .as_ref()
            .map(|d| d.to_map().map(|z| z * 2.5).into());
    }
    m4_io::capture::write(&dir.path("own"), &own, Split::Train, &Silent).unwrap();
    let score = |data: &str, out: &str| {
        dir.succeed(&format!("train {data} -o {out} --iterations 120"));
        let ended = dir.succeed(&format!("eval {out} --data capture --json"));
        (ended.result(), ended.stderr)
    };
    let (same, quiet) = score("capture", "same");
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
    let (same, moved) = (psnr(&same), psnr(&moved));
    assert!((same - moved).abs() < 1.5, "{same} and {moved} dB");
}

#[test]
fn scene_is_independent_of_the_number_of_threads() {
    let dir = with_capture(false);
    let scene = |threads: usize| {
        dir.succeed(&format!(
            "train capture -o out{threads} --iterations 80 --threads {threads}"
        ));
        dir.read(&format!("out{threads}/scene.safetensors"))
    };
    let (one, two, three) = (scene(1), scene(2), scene(3));
    assert!(one == two && two == three, "the files differ");
}

/// Preview, clip and page have threads of their own; none of them waits for the only worker, which
/// may wait for them.
#[test]
fn one_worker_is_enough() {
    let dir = with_capture(false);
    for line in [
        "train capture -o out --iterations 2",
        "render out -o out.mp4",
        "render out -o images",
    ] {
        let ended = Ended::of(
            dir.command(line)
                .env("RAYON_NUM_THREADS", "1")
                .output()
                .unwrap(),
        );
        assert_eq!(ended.code, 0, "{line}\n{}", ended.stderr);
    }
}

/// Starts training and waits for its first steps; gives the rest of its events.
fn start(dir: &Scratch, line: &str) -> (Running, BufReader<ChildStdout>) {
    let mut command = dir.command(line);
    command
        .arg("--json")
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
#[test]
fn signal_saves_and_resume_gives_identical_bits() {
    let dir = with_capture(false);
    dir.succeed("train capture -o whole --iterations 600");
    let train = "train capture -o parts --iterations 600";
    for (name, code, more) in [("-INT", 130, ""), ("-TERM", 143, " --resume")] {
        let (mut running, rest) = start(&dir, &format!("{train}{more}"));
        running.signal(name);
        let rest: Vec<String> = rest.lines().map(Result::unwrap).collect();
        assert_eq!(running.0.wait().unwrap().code(), Some(code));
        let end: Value = serde_json::from_str(rest.last().unwrap()).unwrap();
        assert_eq!((&end["ok"], &end["code"]), (&false.into(), &code.into()));
        assert!(
            end["reason"].as_str().unwrap().contains("--resume"),
            "{end}"
        );
        assert!(dir.count("parts/checkpoints") > 0);
        assert!(
            !dir.path("parts/scene.safetensors").exists(),
            "an unfinished run has no result"
        );
        assert_eq!(dir.json("parts/run.json")["status"], "stopped");
    }
    let events = dir.succeed(&format!("{train} --resume --json")).events();
    let resumed = events
        .iter()
        .find(|e| e["status"] == "resumed")
        .expect("training started anew");
    assert!(resumed["done"].as_u64().unwrap() > 0, "{resumed}");
    assert!(
        dir.read("whole/scene.safetensors") == dir.read("parts/scene.safetensors"),
        "a resumed run must end with the same bits"
    );
}

#[cfg(unix)]
#[test]
fn killed_run_resumes_from_its_last_checkpoint() {
    let dir = with_capture(false);
    dir.succeed("train capture -o whole --iterations 500");
    let train = "train capture -o parts --iterations 500";
    let (mut running, _rest) = start(&dir, &format!("{train} --set checkpoint.every_s=0.02"));
    let saved = dir.path("parts/checkpoints");
    while fs::read_dir(&saved).map_or(0, Iterator::count) < 2 {
        assert!(
            running.0.try_wait().unwrap().is_none(),
            "it ended before it could be killed"
        );
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let second = dir.call(&format!("{train} --resume"));
    assert_eq!(
        second.code, 75,
        "one folder, one process: {}",
        second.stderr
    );
    assert!(second.stderr.contains("another minute4d is using"));
    running.signal("-KILL");
    running.0.wait().unwrap();
    let left = fs::read_dir(&saved).unwrap().filter(|e| {
        e.as_ref()
            .is_ok_and(|e| e.path().extension().is_some_and(|x| x == "safetensors"))
    });
    assert!(
        (1..=3).contains(&left.count()),
        "the last two are kept, a third while it replaces the first"
    );
    assert_eq!(dir.json("parts/run.json")["status"], "running");

    dir.refused(train, 73, &["an unfinished run", "--resume"]);
    let ended = dir.succeed(&format!("{train} --resume --json"));
    assert!(ended.events().iter().any(|e| e["status"] == "resumed"));
    assert!(
        dir.read("whole/scene.safetensors") == dir.read("parts/scene.safetensors"),
        "a resumed run must end with the same bits"
    );
}

#[test]
fn finished_stages_are_reused_unless_inputs_or_settings_change() {
    let dir = with_capture(false);
    let stages = |line: &str| -> Vec<String> {
        let events = dir.succeed(line).events();
        let stages = events
            .iter()
            .filter(|e| e["event"] == "stage" && e["status"] != "finished");
        stages
            .map(|e| format!("{} {} {}", e["stage"], e["status"], e["because"]).replace('"', ""))
            .collect()
    };
    assert_eq!(
        stages("train capture -o out --iterations 20 --json"),
        [
            "train started null",
            "preview started null",
            "viewer started null"
        ]
    );
    assert_eq!(
        stages("train capture -o out --iterations 20 --json --resume"),
        [
            "train reused null",
            "preview reused null",
            "viewer reused null"
        ]
    );
    let more = "train capture -o out --iterations 21 --json --resume";
    assert_eq!(
        stages(more)[0],
        "train started because the settings changed"
    );

    let mut changed = capture(6, false);
    changed.frames[2].rgb.data_mut()[5] = [1, 2, 3];
    m4_io::capture::write(&dir.path("capture"), &changed, Split::Train, &Silent).unwrap();
    assert_eq!(stages(more)[0], "train started because the input changed");

    dir.write("out/metrics.jsonl", "gone");
    assert_eq!(
        stages(more)[0],
        "train started because its files are missing or were changed"
    );
}

#[test]
fn force_replaces_a_run_and_leaves_other_files() {
    let dir = with_capture(false);
    fs::create_dir(dir.path("out")).unwrap();
    dir.write("out/notes.txt", "mine");
    let train = "train capture -o out --iterations 10";
    assert_eq!(dir.call(train).code, 73);
    for _ in 0..2 {
        dir.succeed(&format!("{train} --force"));
    }
    assert_eq!(dir.read("out/notes.txt"), b"mine");
}

#[test]
fn printed_settings_are_a_settings_file() {
    let dir = Scratch::new();
    for (profile, other) in [("fast", "faithful"), ("faithful", "fast")] {
        let printed = dir.succeed(&format!(
            "train --print-config --profile {profile} --set init.keyframe_gaps=0.25"
        ));
        assert!(
            printed.stdout.contains("keyframe_gaps = 0.25"),
            "{}",
            printed.stdout
        );
        dir.write("settings.toml", &printed.stdout);
        let again = dir
            .succeed("run --print-config --config settings.toml")
            .stdout;
        assert_eq!(printed.stdout, again);
        let both = format!("run --print-config --profile {other} --config settings.toml");
        dir.refused(&both, 78, &["profile", "fast", "faithful"]);
    }
    let layers = dir.succeed("train --print-config --set train.iterations=5 --iterations 6");
    assert!(
        layers.stdout.contains("iterations = 6"),
        "an option with its own name is the last word"
    );
}

#[test]
fn closed_stdout_pipe_is_not_a_failure() {
    let dir = Scratch::new();
    let mut command = dir.command("train --print-config");
    let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());
}

#[test]
fn doctor_reports_the_machine() {
    let dir = Scratch::new();
    let machine = dir.succeed("doctor --json").result();
    assert!(machine["threads"].as_u64().unwrap() >= 1 && machine["simd"].is_string());
    let levels = machine["simd_available"].as_array().unwrap();
    assert!(levels.contains(&machine["simd"]), "{machine}");
    let without = Ended::of(
        dir.command("doctor --json")
            .env("PATH", "")
            .output()
            .unwrap(),
    );
    assert_eq!(without.result()["ffmpeg"]["found"], false);
    let notes = machine["notes"].to_string();
    if cfg!(feature = "nets") {
        // No weights are installed where tests look for them.
        assert!(notes.contains("weights fetch recommended"), "{notes}");
        assert_eq!(machine["weights"][0]["installed"], false, "{machine}");
    } else {
        assert!(notes.contains("networks"), "{notes}");
    }
}

#[test]
fn static_camera_gives_a_scene() {
    let dir = Scratch::new();
    write_images(&dir.path("images"), 6);
    let line = "run images -o out --static-camera --fov 56 --iterations 15 --json";
    dir.succeed(line).end();
    let record = dir.json("out/run.json");
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
    let events = dir.succeed(&format!("{line} --resume")).events();
    let reused = events.iter().filter(|e| e["status"] == "reused").count();
    assert_eq!(reused, 4, "{events:?}");
    // its capture may be trained anew in its place
    dir.succeed("train out/capture -o out --force --iterations 10");
    assert!(dir.path("out/capture/transforms_train.json").is_file());
    for line in [
        "run out/capture/train -o out --force",
        "geometry out/capture/train -o out/capture --force",
    ] {
        dir.refused(line, 73, &["out/capture/train", "choose another place"]);
    }
    assert!(
        dir.path("out/capture/transforms_train.json").is_file()
            && dir.path("out/capture/train").is_dir()
    );
}

/// A time for training is a number of iterations: asked for by that number, the run ends with the
/// same bits.
#[test]
fn timed_run_is_reproduced_by_its_iterations() {
    let dir = with_capture(true);
    dir.succeed("train capture -o timed --set train.budget_s=0.2");
    let n = dir.json("timed/run.json")["iterations"].as_u64().unwrap();
    assert!(n >= 50);
    dir.succeed(&format!("train capture -o counted --iterations {n}"));
    assert!(
        dir.read("timed/scene.safetensors") == dir.read("counted/scene.safetensors"),
        "{n} iterations differ"
    );
}

#[test]
fn iterations_disable_the_default_time_budget() {
    let dir = Scratch::new();
    for (options, budget_s) in [
        ("", 60.0),
        ("--preset draft", 10.0),
        ("--iterations 5", 0.0),
        // the number that it would have been anyway is asked for too
        ("--set train.iterations=2000", 0.0),
        ("--set train.iterations=9 --set train.budget_s=7", 7.0),
        ("--profile faithful", 0.0),
    ] {
        let out = dir
            .succeed(&format!("train --print-config {options}"))
            .stdout;
        let line = out
            .lines()
            .find_map(|l| l.strip_prefix("budget_s = "))
            .unwrap();
        assert_eq!(line.parse::<f64>().unwrap(), budget_s, "{options}");
    }
    let both = "train --print-config --profile faithful --preset draft";
    dir.refused(both, 2, &["--preset", "fast profile", "--iterations"]);
}
