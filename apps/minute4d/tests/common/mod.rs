//! The program from outside: arguments, exit codes, messages.

pub mod clips;

use m4_core::{Camera, Capture, CaptureFrame, Intrinsics, Plane, RgbImage, Se3, nalgebra::Vector6};
use m4_io::capture::{self, Split};
use m4_io::image::write_rgb;
use m4_io::video::{self, Mp4Writer, VideoOptions};
use minute4d::Silent;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output};
use std::sync::OnceLock;
use tempfile::TempDir;

pub const SIZE: (usize, usize) = (64, 48);

#[derive(Debug)]
pub struct Ended {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl Ended {
    pub fn of(output: Output) -> Self {
        Self {
            code: output.status.code().unwrap_or(-1),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }

    /// The events of `--json`, each a line that is an object with a name.
    pub fn events(&self) -> Vec<Value> {
        let events: Vec<Value> = self
            .stdout
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        assert!(
            events.iter().all(|e| e["event"].is_string()),
            "{}",
            self.stdout
        );
        events
    }

    /// The last event, which must be `end`, the only one, and agree with the exit code.
    pub fn end(&self) -> Value {
        let events = self.events();
        let ends = events.iter().filter(|e| e["event"] == "end").count();
        let end = events.last().expect("no event at all").clone();
        assert!(ends == 1 && end["event"] == "end", "{}", self.stdout);
        assert_eq!(end["code"], self.code, "{end}");
        assert_eq!(end["ok"], self.code == 0, "{end}");
        end
    }

    pub fn result(&self) -> Value {
        let events = self.events();
        let event = events.iter().find(|e| e["event"] == "result");
        event.unwrap_or_else(|| panic!("no result in {} {}", self.stdout, self.stderr))["result"]
            .clone()
    }
}

pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A process; killed and reaped when a test ends early.
pub struct Running(pub Child);

impl Running {
    /// Sends a signal, such as `-INT`.
    #[cfg(unix)]
    pub fn signal(&self, name: &str) {
        let status = Command::new("kill")
            .args([name, &self.0.id().to_string()])
            .status()
            .unwrap();
        assert!(status.success());
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended long ago.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A folder that is removed with the test, and paths in it.
pub struct Scratch(TempDir);

impl Scratch {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn at(&self, name: &str) -> String {
        text(&self.path(name)).to_owned()
    }

    /// The program with arguments as they are typed, started in this folder: words with spaces
    /// between them; what stands in single quotes is one word.
    pub fn command(&self, line: &str) -> Command {
        let mut command = crate::program(line.split_whitespace().next().unwrap_or_default());
        // No weights that this machine may have, and no progress that depends on the terminal.
        let none = Path::new(env!("CARGO_TARGET_TMPDIR")).join("no-weights");
        command
            .env_remove("MINUTE4D_SIMD")
            .env("MINUTE4D_WEIGHTS", none)
            .env("TERM", "dumb");
        command.current_dir(self.0.path());
        for (i, part) in line.split('\'').enumerate() {
            match i % 2 {
                0 => command.args(part.split_whitespace()),
                _ => command.arg(part),
            };
        }
        command
    }

    pub fn call(&self, line: &str) -> Ended {
        Ended::of(self.command(line).output().unwrap())
    }

    pub fn succeed(&self, line: &str) -> Ended {
        let ended = self.call(line);
        assert_eq!(ended.code, 0, "{line}\n{}\n{}", ended.stdout, ended.stderr);
        ended
    }

    /// Calls the program as typed and expects it to refuse with that code and these words, on
    /// stderr and as events.
    pub fn refused(&self, line: &str, code: i32, words: &[&str]) {
        self.refused_with(line, &[], code, words);
    }

    /// As [`Self::refused`], with environment variables.
    pub fn refused_with(&self, line: &str, env: &[(&str, &str)], code: i32, words: &[&str]) {
        let mut command = self.command(line);
        command.arg("--json").envs(env.iter().copied());
        let ended = Ended::of(command.output().unwrap());
        let args: Vec<_> = command.get_args().collect();
        assert_eq!(
            ended.code, code,
            "{args:?}\n{}\n{}",
            ended.stdout, ended.stderr
        );
        let end = ended.end();
        let reason = end["reason"].as_str().unwrap();
        for word in words {
            assert!(
                reason.contains(word),
                "{args:?}: {word:?} is not in {reason:?}"
            );
            assert!(
                ended.stderr.contains(word),
                "{args:?}: {word:?} is not in {:?}",
                ended.stderr
            );
        }
        let lower = ended.stderr.to_lowercase();
        assert!(
            !lower.contains("panicked") && !lower.contains("internal error"),
            "{}",
            ended.stderr
        );
    }

    pub fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&std::fs::read(self.path(name)).unwrap()).unwrap()
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap()
    }

    /// The files and folders in a folder, without hidden ones.
    pub fn count(&self, name: &str) -> usize {
        let names = std::fs::read_dir(self.path(name))
            .unwrap()
            .map(|entry| entry.unwrap().file_name());
        names
            .filter(|name| !name.to_string_lossy().starts_with('.'))
            .count()
    }

    /// Makes the program `bin/NAME` of a script. By another process: one that is forked here
    /// meanwhile would hold it open for writing.
    #[cfg(target_os = "linux")]
    pub fn install(&self, name: &str, body: &str) {
        let text = self.write(&format!("{name}.txt"), format!("#!/bin/sh\n{body}\n"));
        let install = ["-D", "-m", "755", &text, &self.at(&format!("bin/{name}"))];
        assert!(
            Command::new("install")
                .args(install)
                .status()
                .unwrap()
                .success()
        );
    }

    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> String {
        std::fs::write(self.path(name), bytes).unwrap();
        self.at(name)
    }
}

/// Makes a device that is always full; a link to that of the system for users who may make none,
/// nor replace that one.
#[cfg(unix)]
pub fn device(dir: &Scratch, name: &str) {
    let result = Command::new("mknod")
        .arg(dir.path(name))
        .args(["c", "1", "7"])
        .output();
    if !result.is_ok_and(|output| output.status.success()) {
        std::os::unix::fs::symlink("/dev/full", dir.path(name)).unwrap();
    }
}

/// What a camera sees of a textured wall at depth 4 and a square before it at depth 2.5 that moves
/// to the right; image, depth and mask.
pub fn see(camera: &Camera, share: f64) -> (RgbImage, Plane<f32>, Plane<u8>) {
    let (w, h) = (camera.intrinsics.width, camera.intrinsics.height);
    let hit = |x: usize, y: usize| {
        let at = |z: f64| camera.unproject(x as f64, y as f64, z);
        let near = at(2.5);
        let square = (near.x - (share - 0.5)).abs() < 0.35 && near.y.abs() < 0.35;
        if square {
            (near, 2.5, true)
        } else {
            (at(4.0), 4.0, false)
        }
    };
    let wave = |v: f64| (127.5 + 110.0 * v.sin()) as u8;
    let rgb = Plane::from_fn(w, h, |x, y| match hit(x, y) {
        (p, _, true) => [230, wave(9.0 * (p.x - share)), wave(11.0 * p.y)],
        (p, _, false) => [
            wave(5.0 * p.x + 2.0 * p.y),
            wave(6.0 * p.y),
            wave(4.0 * (p.x - p.y)),
        ],
    });
    let depth = Plane::from_fn(w, h, |x, y| hit(x, y).1 as f32);
    let mask = Plane::from_fn(w, h, |x, y| if hit(x, y).2 { 255 } else { 0 });
    (rgb, depth, mask)
}

fn frame(
    size: (usize, usize),
    shift: f64,
    i: usize,
    n: usize,
    held_out: Option<u32>,
) -> CaptureFrame {
    let share = i as f64 / (n - 1) as f64;
    let camera = Camera {
        intrinsics: Intrinsics::centred(size.0, size.1, 0.94 * size.0 as f64),
        c2w: Se3::identity().retract(&Vector6::new(
            0.4 * share + shift,
            0.02 * share,
            0.0,
            0.0,
            0.0,
            0.0,
        )),
    };
    let (rgb, depth, mask) = see(&camera, share);
    CaptureFrame {
        name: format!("{i:05}"),
        camera,
        t: i as f64,
        rgb,
        depth: held_out.is_none().then(|| depth.into()),
        mask: Some(mask.into()),
        motion: None,
        instances: None,
        camera_index: held_out,
        distance_sigma: None,
    }
}

/// What no reconstruction is needed for: the mean PSNR, dB, over `views` of the mean of `frames`
/// over time. Columns from `columns` on do not count.
pub fn mean_image_psnr_db<'a>(
    frames: impl IntoIterator<Item = &'a CaptureFrame>,
    views: impl IntoIterator<Item = RgbImage>,
    columns: usize,
) -> f64 {
    let frames: Vec<&RgbImage> = frames.into_iter().map(|frame| &frame.rgb).collect();
    let mean = |x: usize, y: usize, k: usize| {
        let sum: f64 = frames.iter().map(|rgb| f64::from(rgb[(x, y)][k])).sum();
        sum / frames.len() as f64
    };
    let psnr_db = |view: RgbImage| {
        let (w, h) = view.size();
        let places = (0..h).flat_map(|y| (0..w.min(columns)).map(move |x| (x, y)));
        let squares: Vec<f64> = places
            .flat_map(|(x, y)| {
                [0, 1, 2].map(|k| (mean(x, y, k) - f64::from(view[(x, y)][k])).powi(2))
            })
            .collect();
        -10.0 * (squares.iter().sum::<f64>() / squares.len() as f64 / (255.0 * 255.0)).log10()
    };
    let scores: Vec<f64> = views.into_iter().map(psnr_db).collect();
    scores.iter().sum::<f64>() / scores.len() as f64
}

/// A capture of `n` frames of [`SIZE`]; with held-out views where `held_out`.
pub fn capture(n: usize, held_out: bool) -> Capture {
    capture_of(SIZE, n, held_out)
}

/// A capture of six frames whose objects are half as far away as they are.
pub fn capture_with_near_objects() -> Capture {
    let mut own = capture(6, false);
    for frame in &mut own.frames {
        let mask = frame.mask.clone().unwrap();
        let depth = frame.depth.as_ref().unwrap().to_map();
        let (w, h) = depth.size();
        let near = |x, y| if mask.at(x, y) { 0.5 } else { 1.0 };
        frame.depth = Some(Plane::from_fn(w, h, |x, y| near(x, y) * depth[(x, y)]).into());
    }
    own
}

fn capture_of(size: (usize, usize), n: usize, held_out: bool) -> Capture {
    let shift = if held_out { 0.1 } else { 0.0 };
    Capture {
        frames: (0..n)
            .map(|i| frame(size, shift, i, n, held_out.then_some(0)))
            .collect(),
        time_frames: n,
        duration_s: Some((n - 1) as f64 / 10.0),
        metric: false,
        tracks: None,
    }
}

pub fn write_capture(folder: &Path, with_test: bool) {
    capture::write(folder, &capture(6, false), Split::Train, &Silent).unwrap();
    if with_test {
        capture::write(folder, &capture(6, true), Split::Test, &Silent).unwrap();
    }
}

/// Reads a capture.
pub fn read_capture(folder: &Path, split: Split) -> Capture {
    capture::read(folder, split, &Default::default(), &Silent).unwrap()
}

/// Number and size of the frames of a video.
pub fn frames_of(path: &Path) -> (usize, (usize, usize)) {
    let video = video::read(path, &VideoOptions::default(), &Silent).unwrap();
    (video.frames.len(), video.frames[0].rgb.size())
}

/// The folder of a finished run of six frames in half a second, trained once for all tests that
/// only read it.
pub fn finished_run() -> &'static str {
    static RUN: OnceLock<(Scratch, String)> = OnceLock::new();
    let (_, path) = RUN.get_or_init(|| {
        let dir = Scratch::new();
        write_capture(&dir.path("capture"), false);
        dir.succeed("train capture -o out --iterations 60");
        let path = dir.at("out");
        (dir, path)
    });
    path
}

pub fn write_clip(folder: &Path, size: (usize, usize), n: usize, fps: f64) {
    let clip = Capture {
        duration_s: Some((n - 1) as f64 / fps),
        ..capture_of(size, n, false)
    };
    capture::write(folder, &clip, Split::Train, &Silent).unwrap();
}

/// Edits the list of training frames of a capture.
pub fn edit_transforms(folder: &Path, edit: impl FnOnce(&mut Value)) {
    let path = folder.join("transforms_train.json");
    let mut list: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    edit(&mut list);
    std::fs::write(&path, serde_json::to_vec(&list).unwrap()).unwrap();
}

pub fn write_video(path: &Path, n: usize) {
    let mut writer = Mp4Writer::create(path, SIZE.0, SIZE.1, 10.0).unwrap();
    for frame in capture(n, false).frames {
        writer.push(frame.rgb).unwrap();
    }
    writer.finish().unwrap();
}

/// The images of the same scene as a folder of PNG files, large enough for geometry.
pub fn write_images(folder: &Path, n: usize) {
    std::fs::create_dir_all(folder).unwrap();
    for frame in capture_of((128, 96), n, false).frames {
        write_rgb(&folder.join(format!("{}.png", frame.name)), &frame.rgb).unwrap();
    }
}
