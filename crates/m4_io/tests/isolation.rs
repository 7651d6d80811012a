//! What a decoder gets of the process that starts it: no secret, no privilege, few files.

#![cfg(target_os = "linux")]

use crate::common::{PROBED, fake_ffmpeg, pinwheel, sent};
use m4_core::{Progress, Silent};
use m4_io::video::{DecoderProgram, VideoOptions, read_with};
use m4_io::{ErrorKind, Fault};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Variables that a decoder may have.
const TOLD: [&str; 3] = ["PATH", "LD_LIBRARY_PATH", "MALLOC_ARENA_MAX"];
const DECODER: &str = env!("CARGO_BIN_EXE_m4_decode_h264");

fn program() -> DecoderProgram {
    DecoderProgram::new(DECODER, "decode")
}

/// What the kernel says of a process: its environment when it began, its state and its limits.
struct Facts {
    environ: Vec<u8>,
    status: String,
    limits: String,
}

impl Facts {
    fn read(folder: &Path) -> Self {
        let text = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
        Self {
            environ: fs::read(folder.join("environ")).unwrap(),
            status: text("status"),
            limits: text("limits"),
        }
    }

    fn limit(&self, name: &str) -> Option<u64> {
        let line = self
            .limits
            .lines()
            .find_map(|line| line.strip_prefix(name))
            .unwrap();
        let [soft, hard] = [0, 1].map(|i| line.split_whitespace().nth(i).unwrap());
        assert_eq!(soft, hard, "{line}");
        soft.parse().ok()
    }

    /// `privileged` is whether it may start set-uid programs as their owners.
    fn check(&self, files: u64, privileged: bool) {
        let variables = self.environ.split(|&b| b == 0).filter(|v| !v.is_empty());
        let names: Vec<String> = variables
            .map(|v| {
                String::from_utf8_lossy(v)
                    .split('=')
                    .next()
                    .unwrap()
                    .to_owned()
            })
            .collect();
        assert!(names.contains(&"PATH".to_owned()));
        assert!(
            names.iter().all(|name| TOLD.contains(&name.as_str())),
            "{names:?}"
        );
        let may_not = self.status.lines().any(|line| line == "NoNewPrivs:\t1");
        assert_eq!(may_not, !privileged, "{}", self.status);
        assert_eq!(self.limit("Max open files"), Some(files));
        assert_eq!(self.limit("Max file size"), Some(1 << 20));
        assert_eq!(self.limit("Max core file size"), Some(0));
        assert!(self.limit("Max address space").is_some() && self.limit("Max cpu time").is_some());
    }
}

/// Programs that write down what the kernel says of them, and a clip that they are asked to read.
fn note_takers(folder: &Path) -> (PathBuf, VideoOptions) {
    let body = |name: &str, rest: &str| {
        let notes = folder.join(format!("{name}.d"));
        fs::create_dir(&notes).unwrap();
        let copy = |what: &str| format!("cat /proc/$$/{what} >'{}/{what}'\n", notes.display());
        // A bare child begins before it is limited, last in the number of files: it waits, at most
        // about five seconds.
        let limited = "n=0; until [ \"$(ulimit -n)\" = 256 ] || [ $n = 500 ]; do n=$((n + 1)); sleep 0.01; done\n";
        limited.to_owned() + &["environ", "status", "limits"].map(copy).concat() + rest
    };
    fake_ffmpeg(
        folder,
        &body("ffprobe", PROBED),
        &body("ffmpeg", &sent(0..3)),
    )
}

#[test]
fn ffmpeg_gets_no_secret_no_privilege_and_few_files() {
    // What cargo tells every test, and no decoder needs.
    assert!(std::env::var_os("CARGO_MANIFEST_DIR").is_some());
    for launcher in [Some(program()), None] {
        let dir = tempfile::tempdir().unwrap();
        let (clip, options) = note_takers(dir.path());
        let video = read_with(launcher.as_ref(), &clip, &options, &Silent).unwrap();
        assert_eq!(video.frames.len(), 3);
        for name in ["ffprobe.d", "ffmpeg.d"] {
            Facts::read(&dir.path().join(name)).check(256, launcher.is_none());
        }
    }
}

/// Writes down what the kernel says of a child, once there is progress.
struct Watch<'a> {
    /// The program of the child.
    file: &'a Path,
    facts: Mutex<Option<Facts>>,
}

impl Progress for Watch<'_> {
    fn update(&self, _: &str, _: usize, _: usize, _: &str) {
        let mut facts = self.facts.lock().unwrap();
        let processes = fs::read_dir("/proc")
            .unwrap()
            .flatten()
            .map(|entry| entry.path());
        let mut ours =
            processes.filter(|p| fs::read_link(p.join("exe")).is_ok_and(|exe| exe == self.file));
        if let (None, Some(process)) = (&*facts, ours.next()) {
            *facts = Some(Facts::read(&process));
        }
    }
    fn warn(&self, _: &str) {}
    fn cancelled(&self) -> bool {
        false
    }
}

#[test]
fn our_own_decoder_gets_no_secret_no_privilege_and_no_file() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().canonicalize().unwrap().join("decoder");
    // By another process: one that has a file open for writing while another is started keeps it
    // from being executed.
    let copied = std::process::Command::new("cp")
        .arg(DECODER)
        .arg(&file)
        .status()
        .unwrap();
    assert!(copied.success());
    let watch = Watch {
        file: &file,
        facts: Mutex::new(None),
    };
    let options = VideoOptions {
        size: Some(64),
        ..VideoOptions::default()
    };
    let program = DecoderProgram::new(&file, "decode");
    let video = read_with(Some(&program), &pinwheel(), &options, &watch).unwrap();
    assert_eq!((video.frames.len(), video.warnings.len()), (96, 0));
    let facts = watch.facts.into_inner().unwrap().unwrap();
    facts.check(3, false);
    assert_eq!(facts.limit("Max processes"), Some(0));
}

#[test]
fn ffmpeg_start_failures_do_not_blame_the_clip() {
    let dir = tempfile::tempdir().unwrap();
    let (clip, options) = note_takers(dir.path());
    let probe = dir.path().join("ffprobe");
    let remove = format!("rm '{}'", probe.display());
    let break_it = format!("printf '#!/nowhere/interpreter\\n' >'{}'", probe.display());
    for spoil in [break_it, remove] {
        // By a shell: a file that some thread has open for writing while another one forks cannot
        // be executed.
        let spoiled = std::process::Command::new("sh")
            .args(["-c", &spoil])
            .status()
            .unwrap();
        assert!(spoiled.success());
        for launcher in [Some(program()), None] {
            let error = read_with(launcher.as_ref(), &clip, &options, &Silent).unwrap_err();
            let needed = matches!(
                error.fault,
                Fault::Content {
                    kind: ErrorKind::Unavailable,
                    ..
                }
            );
            assert!(
                needed && error.to_string().contains("ffprobe"),
                "{spoil}: {error}"
            );
        }
    }
}
