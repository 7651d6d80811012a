//! What is left of a run that was killed, ran out of time or out of disk, and how it continues;
//! decoding in a process of its own, whose end ends nothing else.

#[cfg(unix)]
use crate::common::Ended;
use crate::common::clips::{frame_image, walk, write};
use crate::common::{Scratch, write_capture};
use m4_core::Plane;
use m4_io::video::Mp4Writer;
use std::fs;
use std::path::Path;
#[cfg(unix)]
use std::process::Command;
use std::process::Stdio;
use std::time::Duration;

const FRAMES: usize = 10;
/// A run from `walk` that is small and quick.
const RUN: &str =
    "run walk --json --iterations 30 --set dense.working_side_px=160 --set preview.panel_px=64";

fn with_walk() -> Scratch {
    let dir = Scratch::new();
    write(&dir.path("walk"), walk(FRAMES).iter().map(frame_image));
    dir
}

fn same_result(a: &Path, b: &Path) {
    for name in ["scene.safetensors", "capture/transforms_train.json"] {
        assert!(
            fs::read(a.join(name)).unwrap() == fs::read(b.join(name)).unwrap(),
            "{name} differs"
        );
    }
}

/// Names of the finished steps of geometry.
fn steps(out: &Path) -> Vec<String> {
    let entries = fs::read_dir(out.join("capture/.minute4d-steps"))
        .into_iter()
        .flatten();
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    names
        .filter(|name| name != "key" && !name.ends_with(".part"))
        .collect()
}

#[test]
fn killed_geometry_resumes_after_its_last_step() {
    let dir = with_walk();
    dir.succeed(&format!("{RUN} -o calm"));
    assert!(
        steps(&dir.path("calm")).is_empty() && !dir.path("calm/capture/.minute4d-steps").exists(),
        "steps go when all is done"
    );
    // killed when cameras are known, when some flow is, and when depth is
    for step in ["cameras", "flow-", "dense"] {
        let mut child = dir
            .command(&format!("{RUN} -o killed --resume"))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        while !steps(&dir.path("killed"))
            .iter()
            .any(|name| name.starts_with(step))
        {
            assert!(
                child.try_wait().unwrap().is_none(),
                "it ended before {step} was seen"
            );
            std::thread::sleep(Duration::from_millis(1));
        }
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(!dir.path("killed/capture/transforms_train.json").exists());
    }
    // one step is torn, as by a machine that lost its power
    let torn = dir.path("killed/capture/.minute4d-steps/cameras");
    let bytes = fs::read(&torn).unwrap();
    fs::write(&torn, &bytes[..bytes.len() / 2]).unwrap();
    let events = dir.succeed(&format!("{RUN} -o killed --resume")).events();
    assert!(
        events
            .iter()
            .any(|e| e.to_string().contains("its finished steps are used")),
        "{events:?}"
    );
    assert!(!dir.path("killed/capture/.minute4d-steps").exists());
    same_result(&dir.path("calm"), &dir.path("killed"));
}

#[test]
fn partial_files_of_a_killed_process_do_not_block_the_next_run() {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    fs::create_dir(dir.path("out")).unwrap();
    let torn = dir.path("out/.run.json.tmp-999999999");
    fs::write(&torn, "{\"format\":\"minu").unwrap();
    dir.succeed("train capture -o out --iterations 20");
    assert!(!torn.exists());
    let hidden = fs::read_dir(dir.path("out")).unwrap();
    let hidden: Vec<_> = hidden
        .map(|entry| entry.unwrap().file_name())
        .filter(|name| name.to_string_lossy().starts_with('.'))
        .collect();
    assert_eq!(hidden, [".minute4d-files.json"]);
}

#[test]
fn time_limit_ends_with_a_scene_or_a_resumable_state() {
    let dir = with_walk();
    let ended = dir.call(&format!("{RUN} -o out --time-limit 0.05s"));
    let end = ended.end();
    assert_eq!(
        (ended.code, &end["ok"]),
        (75, &false.into()),
        "{}",
        ended.stderr
    );
    let reason = end["reason"].as_str().unwrap();
    assert!(
        reason.contains("time limit") && reason.contains("--resume"),
        "{reason}"
    );
    dir.succeed(&format!("{RUN} -o out --resume"));

    write_capture(&dir.path("capture"), false);
    dir.succeed("train capture -o cut --iterations 1000000 --time-limit 3s");
    let record = dir.json("cut/run.json");
    assert_eq!(record["status"], "finished");
    let done = record["iterations"].as_u64().unwrap();
    assert!((1..1_000_000).contains(&done), "{done}");
    let words = ["write 90, 90s, 10m or 1.5h"];
    dir.refused("train capture -o x --time-limit soon", 2, &words);
}

/// No file may be larger than that: what a disk that is full does to the first large file.
#[cfg(unix)]
fn with_files_of(dir: &Scratch, kilobytes: usize, line: &str) -> Ended {
    let program = dir.command(line);
    let limited = format!(
        "trap '' XFSZ; ulimit -f {}; exec \"$0\" \"$@\"",
        2 * kilobytes
    );
    let mut command = Command::new("sh");
    command.current_dir(dir.path("")).args(["-c", &limited]);
    command.arg(program.get_program()).args(program.get_args());
    for (name, value) in program.get_envs() {
        match value {
            Some(value) => command.env(name, value),
            None => command.env_remove(name),
        };
    }
    Ended::of(command.output().unwrap())
}

#[cfg(unix)]
#[test]
fn full_disk_is_reported_and_the_run_resumes_when_there_is_space() {
    let dir = with_walk();
    dir.succeed(&format!("{RUN} -o calm"));
    // what is large is refused: steps, images or the scene; records are small
    for kilobytes in [24, 60, 200] {
        let ended = with_files_of(&dir, kilobytes, &format!("{RUN} -o full --resume"));
        let end = ended.end();
        assert_eq!(
            ended.code, 73,
            "{kilobytes} kB: {} {}",
            ended.stdout, ended.stderr
        );
        let reason = end["reason"].as_str().unwrap();
        assert!(
            reason.contains("cannot write") && reason.contains("free space"),
            "{reason}"
        );
        let record = dir.json("full/run.json");
        assert_eq!(record["status"], "failed", "{kilobytes} kB");
        assert_eq!(record["error"].as_str().unwrap(), reason);
        assert!(!dir.path("full/scene.safetensors").exists());
    }
    dir.succeed(&format!("{RUN} -o full --resume"));
    same_result(&dir.path("calm"), &dir.path("full"));
}

#[cfg(target_os = "linux")]
#[test]
fn decoder_over_its_limits_is_killed_and_reported() {
    let dir = Scratch::new();
    let clip = dir.path("large.mp4");
    let mut writer = Mp4Writer::create(&clip, 3840, 2160, 24.0).unwrap();
    for i in 0..2 {
        let image = Plane::from_fn(3840, 2160, |x, y| [(x + i) as u8, y as u8, (x ^ y) as u8]);
        writer.push(image).unwrap();
    }
    writer.finish().unwrap();
    // Our own process has all the memory that it wants. What a refusal of memory looks like depends
    // on how much of it the program itself takes.
    let words = ["large.mp4", "decoder failed", "video.decoder.memory_mb"];
    dir.refused(
        "geometry large.mp4 -o out --set video.decoder.memory_mb=64",
        69,
        &words,
    );
    let words = ["decoder.idle_seconds"];
    dir.refused(
        "geometry large.mp4 -o out --set video.decoder.idle_seconds=0",
        78,
        &words,
    );
}

#[test]
fn decode_command_is_hidden_and_fails_without_a_parent() {
    let dir = Scratch::new();
    for line in ["__decode-h264", "__decode-h264 1000000000 20"] {
        let output = dir.command(line).stdin(Stdio::null()).output().unwrap();
        assert_eq!(output.status.code(), Some(1));
        assert!(output.stdout.is_empty() && !output.stderr.is_empty());
    }
    let help = dir.succeed("--help");
    assert!(!help.stdout.contains("__decode"), "{}", help.stdout);
}
