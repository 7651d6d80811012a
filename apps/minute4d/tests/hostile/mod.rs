//! A table of hostile inputs: how each is made, the command line, the exit code, and words of the
//! message. Each case must end in time, and none in a panic.

mod inputs;

use crate::common::{Ended, Running, Scratch, finished_run};
use inputs::*;
use std::fs;
use std::io::Read;
use std::net::TcpListener;
use std::process::{Command, Stdio};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Longest time that a case may take, in a debug build on a loaded machine.
const LONGEST: Duration = Duration::from_secs(20);

struct Case {
    /// What it is, for the report.
    name: &'static str,
    /// Makes its files.
    make: fn(&Scratch),
    /// The command line; `RUN` stands for the folder of a finished run.
    line: &'static str,
    code: i32,
    /// Words that the message holds.
    words: &'static [&'static str],
}

const fn case(
    name: &'static str,
    make: fn(&Scratch),
    line: &'static str,
    code: i32,
    words: &'static [&'static str],
) -> Case {
    Case {
        name,
        make,
        line,
        code,
        words,
    }
}

/// What is not a regular file. Nothing of it is read.
const FILES: [Case; 15] = [
    case(
        "pipe as a clip",
        pipe_clip,
        "run clip.mp4 -o out",
        65,
        &["clip.mp4", "a pipe"],
    ),
    case(
        "pipe as a clip of geometry",
        pipe_clip,
        "geometry clip.mp4 -o out",
        65,
        &["clip.mp4", "a pipe"],
    ),
    case(
        "device as a clip",
        nothing,
        "run /dev/zero -o out",
        65,
        &["/dev/zero", "a device"],
    ),
    case(
        "standard input as a clip",
        nothing,
        "run /dev/stdin -o out",
        65,
        &["/dev/stdin", "not a regular file"],
    ),
    case(
        "pipe in a folder of clips",
        folder_with_pipe,
        "batch plan clips -o j --out r",
        65,
        &["clip.mp4", "a pipe"],
    ),
    case(
        "pipe as a planned clip",
        pipe_clip,
        "batch plan clip.mp4 -o j --out r",
        65,
        &["clip.mp4", "a pipe"],
    ),
    case(
        "pipe as a manifest",
        pipe_clip,
        "batch status --manifest clip.mp4",
        65,
        &["clip.mp4", "a pipe"],
    ),
    case(
        "device as settings",
        nothing,
        "train --print-config --config /dev/zero",
        65,
        &["/dev/zero", "a device"],
    ),
    case(
        "huge settings",
        huge_config,
        "train --print-config --config huge.toml",
        65,
        &["huge.toml", "limit of 1 MiB"],
    ),
    case(
        "pipe as a list of frames",
        list_is_pipe,
        "train capture -o out",
        65,
        &["transforms_train.json", "a pipe"],
    ),
    case(
        "pipe as a record",
        record_is_pipe,
        "train capture -o out --resume",
        65,
        &["run.json", "a pipe"],
    ),
    case(
        "pipe as a scene",
        scene_is_pipe,
        "render scene.safetensors -o x.png",
        65,
        &["scene.safetensors", "a pipe"],
    ),
    case(
        "pipe as splats",
        scene_is_pipe,
        "import splats.ply -o out",
        65,
        &["splats.ply", "a pipe"],
    ),
    case(
        "pipe to view",
        scene_is_pipe,
        "view scene.safetensors --no-open",
        66,
        &["no scene or run"],
    ),
    case(
        "pipe as a path",
        capture_and_pipe,
        "render RUN --path pipe.json -o x",
        65,
        &["pipe.json", "a pipe"],
    ),
];

/// Numbers that no run can use.
const NUMBERS: [Case; 4] = [
    case(
        "endless training",
        capture,
        "train capture -o o --set train.iterations=5000000000",
        78,
        &["1 to 10000000"],
    ),
    case(
        "steps that hear no stop",
        capture,
        "train capture -o o --set train.batch=100000",
        78,
        &["1 to 32"],
    ),
    case(
        "time that is no number",
        capture,
        "train capture -o o --set limit.time_s=nan",
        78,
        &["limit.time_s = NaN"],
    ),
    case(
        "seed beyond the format",
        capture,
        "train capture -o o --seed 18446744073709551615",
        2,
        &["--seed"],
    ),
];

/// Files with numbers, texts and images that cannot be used. Where a case ends well, it warns.
const CONTENTS: [Case; 16] = [
    case(
        "camera beyond f32",
        far_camera,
        TRAIN,
        65,
        &["transforms_train.json", "frame 2", "1e39", "-1e7 to 1e7"],
    ),
    case(
        "camera beyond use",
        distant_camera,
        TRAIN,
        65,
        &["transforms_train.json", "frame 2", "1e30", "-1e7 to 1e7"],
    ),
    case(
        "focal length of nothing",
        no_focal_length,
        TRAIN,
        65,
        &["frame 0", "fl_x", "1e-30", "pixels"],
    ),
    case(
        "endless depth",
        endless_depth,
        TRAIN,
        65,
        &["depth_unit_scale_factor", "1e30"],
    ),
    case("one moment", one_moment, TRAIN, 0, &["time"]),
    case("one image", one_image, TRAIN, 0, &["train/00000.png"]),
    case(
        "third of an image",
        third_of_an_image,
        TRAIN,
        65,
        &["train/00002.png", "damaged"],
    ),
    case(
        "third of a depth map",
        third_of_a_depth_map,
        TRAIN,
        65,
        &["depth/00002.png", "damaged"],
    ),
    case(
        "empty image",
        empty_image,
        TRAIN,
        65,
        &["train/00002.png", "empty"],
    ),
    case(
        "text of 16 bits",
        wide_text,
        TRAIN,
        65,
        &["transforms_train.json", "UTF-16"],
    ),
    case(
        "half a list",
        half_a_list,
        TRAIN,
        65,
        &["transforms_train.json", "JSON"],
    ),
    case(
        "nested list",
        nested_list,
        TRAIN,
        65,
        &["transforms_train.json", "JSON"],
    ),
    #[cfg(unix)]
    case(
        "link in a circle",
        link_in_a_circle,
        TRAIN,
        66,
        &["train/00002.png", "in a circle"],
    ),
    #[cfg(not(unix))]
    case("no capture", nothing, TRAIN, 66, &["no capture"]),
    case(
        "private file",
        private_file,
        TRAIN,
        65,
        &["private.png", "outside of"],
    ),
    case(
        "bombs as a clip",
        bombs,
        "geometry bombs -o out",
        65,
        &["16000", "above the limit"],
    ),
    case(
        "list as a scene",
        capture,
        "render capture/transforms_train.json -o x.png",
        65,
        &["transforms_train.json"],
    ),
];
const TRAIN: &str = "train capture -o out --iterations 2 --set preview.panel_px=32";

/// Places where no result can be.
const PLACES: [Case; 9] = [
    case(
        "input as output",
        capture,
        "enhance capture -o capture --tracker flow --segmenter none --force",
        73,
        &["an input"],
    ),
    case(
        "part of the input as output",
        capture,
        "geometry capture/train -o capture --force",
        73,
        &["an input"],
    ),
    case(
        "foreign capture as output",
        capture,
        "geometry capture/train -o capture/../capture",
        73,
        &["capture"],
    ),
    case(
        "device as output",
        full_device,
        "export RUN --format ply -o full --force",
        73,
        &["full", "a device"],
    ),
    case(
        "pipe as output",
        pipe_clip,
        "render RUN -o clip.mp4 --force",
        73,
        &["clip.mp4", "a pipe"],
    ),
    case(
        "folder as a file",
        capture,
        "export RUN --format spz -o capture --force",
        73,
        &["capture", "folder"],
    ),
    case(
        "below a file",
        capture,
        "train capture -o capture/transforms_train.json/out",
        73,
        &["transforms_train.json"],
    ),
    case(
        "above all",
        nothing,
        "export RUN --format ply -o /.. --force",
        73,
        &["names no file"],
    ),
    case("name of 300 letters", capture, LONG, 73, &["cannot write"]),
];
const LONG: &str = concat!(
    "train capture -o ",
    "llllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllll",
    "llllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllll",
    "llllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllllll",
);

/// Names that act on a terminal.
const NAMES: [Case; 4] = [
    case(
        "name that clears",
        acting_names,
        "run 'a\x1b[2J\u{202e}.mp4' -o out",
        65,
        &["a\\u{1b}[2J\\u{202e}.mp4"],
    ),
    case(
        "missing name",
        nothing,
        "run '\x1b[31mno.mp4' -o out",
        66,
        &["\\u{1b}[31mno.mp4"],
    ),
    case(
        "unknown preset",
        nothing,
        "run a -o b --preset 'a\u{202e}b'",
        2,
        &["a\\u{202e}b"],
    ),
    case(
        "name in a result",
        planned,
        "batch plan clips -o 'j\x1b[2J' --out results",
        0,
        &[],
    ),
];

fn read_all(from: Option<impl Read + Send + 'static>) -> JoinHandle<String> {
    thread::spawn(move || {
        let mut text = String::new();
        if let Some(mut from) = from {
            from.read_to_string(&mut text).unwrap();
        }
        text
    })
}

/// Runs a command to its end, which must come in time.
fn ended(mut command: Command, name: &str) -> Ended {
    let mut child = command
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let (stdout, stderr) = (read_all(child.stdout.take()), read_all(child.stderr.take()));
    let start = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if start.elapsed() > LONGEST {
            child.kill().unwrap();
            panic!("{name}: it did not end within {LONGEST:?}");
        }
        thread::sleep(Duration::from_millis(20));
    };
    Ended {
        code: status.code().unwrap_or(-1),
        stdout: stdout.join().unwrap(),
        stderr: stderr.join().unwrap(),
    }
}

/// A character that acts on a terminal.
fn acting(text: &str) -> Option<char> {
    text.chars()
        .find(|c| (c.is_control() && *c != '\n') || matches!(c, '\u{202a}'..='\u{202e}'))
}

fn check(cases: &[Case]) {
    for case in cases {
        let dir = Scratch::new();
        (case.make)(&dir);
        let run = match case.line.contains("RUN") {
            true => finished_run(),
            false => "",
        };
        let mut command = dir.command(&case.line.replace("RUN", &format!("'{run}'")));
        command.stdout(Stdio::piped());
        let ended = ended(command, case.name);
        let (name, stderr) = (case.name, &ended.stderr);
        assert_eq!(ended.code, case.code, "{name}: {stderr}");
        for word in case.words {
            assert!(
                stderr.contains(word),
                "{name}: {word:?} is not in {stderr:?}"
            );
        }
        assert_eq!(
            (acting(stderr), acting(&ended.stdout)),
            (None, None),
            "{name}: {ended:?}"
        );
        assert!(!stderr.contains("internal error"), "{name}: {stderr}");
    }
}

#[test]
fn files_that_are_not_regular_are_refused_before_a_byte_is_read() {
    check(&FILES);
}

#[test]
fn numbers_out_of_range_are_refused() {
    check(&NUMBERS);
}

#[test]
fn contents_that_cannot_be_used_are_named() {
    check(&CONTENTS);
}

#[test]
fn places_where_no_result_can_be_are_refused() {
    check(&PLACES);
}

/// Signals during training, with the exit code of each.
#[cfg(unix)]
#[test]
fn signals_end_a_run_in_time() {
    let dir = Scratch::new();
    capture(&dir);
    for (signal, code) in [("-TERM", 143), ("-INT", 130)] {
        let out = format!("out{signal}");
        let mut command = dir.command(&format!("train capture -o {out} --iterations 1000000"));
        let mut run = Running(
            command
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap(),
        );
        while !dir.path(&format!("{out}/checkpoints")).exists() {
            assert!(
                run.0.try_wait().unwrap().is_none(),
                "{signal}: it ended before it was asked to"
            );
            thread::sleep(Duration::from_millis(5));
        }
        run.signal(signal);
        let start = Instant::now();
        while run.0.try_wait().unwrap().is_none() {
            assert!(start.elapsed() < LONGEST, "{signal}: it did not end");
            thread::sleep(Duration::from_millis(5));
        }
        assert_eq!(run.0.wait().unwrap().code(), Some(code), "{signal}");
        assert_eq!(dir.json(&format!("{out}/run.json"))["status"], "stopped");
    }
}

#[test]
fn a_port_that_is_taken_is_named() {
    let dir = Scratch::new();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let mut command = dir.command(&format!(
        "view '{}' --no-open --port {port}",
        finished_run()
    ));
    command.stdout(Stdio::piped());
    let refused = ended(command, "port");
    assert_eq!(refused.code, 75, "{}", refused.stderr);
    assert!(
        refused.stderr.contains(&port.to_string()),
        "{}",
        refused.stderr
    );
}

#[test]
fn names_that_act_on_a_terminal_are_shown() {
    check(&NAMES);
}

/// Commands whose result goes to a device that is full.
#[cfg(target_os = "linux")]
#[test]
fn a_result_that_does_not_arrive_is_a_failure_and_a_closed_pipe_is_none() {
    let dir = Scratch::new();
    for line in [
        "doctor",
        "doctor --json",
        "train --print-config",
        "--help",
        "--version",
        "run --help",
    ] {
        let full = || fs::File::options().write(true).open("/dev/full").unwrap();
        let mut command = dir.command(line);
        command.stdout(full());
        let refused = ended(command, line);
        assert_eq!(refused.code, 73, "{line}: {}", refused.stderr);
        assert!(
            refused.stderr.contains("standard output"),
            "{line}: {}",
            refused.stderr
        );

        let mut command = dir.command(line);
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        command.stdout(writer);
        let closed = ended(command, line);
        assert_eq!((closed.code, closed.stderr.as_str()), (0, ""), "{line}");
    }
}
