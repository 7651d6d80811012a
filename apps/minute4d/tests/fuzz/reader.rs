//! One reader, its folder, and the outcome of a read; checks that the data returned by readers are
//! valid.

use crate::files::{Wrap, copy, fixture};
use m4_core::{Camera, Capture, CaptureFrame, CompactDepth, DepthMap, Scene, Tracks, Video};
use m4_io::range;
use m4_io::trajectory::{KeyPose, Trajectory};
use std::path::{Path, PathBuf};
use std::{fs, io};
use tempfile::TempDir;

/// Longest message of a refusal, characters: one that is longer quotes the file without end.
pub const MAX_REASON: usize = 1000;

/// Readers of bytes, and those that take what is damaged for missing: they name no file.
const NAMELESS: [&str; 9] = [
    "io-npy",
    "io-npy-bytes",
    "io-npz",
    "side-exr",
    "side-depth",
    "program-run-record",
    "program-geometry-record",
    "batch-record",
    "batch-result-mark",
];

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// They were read, and what was read is valid.
    Read,
    /// They were refused, with this message.
    Refused(String),
    /// They were taken, but what was read is not valid: what is wrong.
    Invalid(String),
}

impl Outcome {
    /// Of a result and a look at what was read.
    pub fn of<T, E: std::fmt::Display>(
        read: Result<T, E>,
        fault: impl FnOnce(&T) -> Option<String>,
    ) -> Self {
        match read {
            Err(e) => Self::Refused(e.to_string()),
            Ok(value) => fault(&value).map_or(Self::Read, Self::Invalid),
        }
    }
}

/// What else lies in the folder of a reader.
pub enum Around {
    /// Nothing.
    Nothing,
    /// Copies of fixtures: from, to (below the stage).
    Fixtures(Vec<(String, String)>),
    /// What a function writes.
    Made(fn(&Path)),
}

type Call = Box<dyn Fn(&Path) -> Outcome + Send + Sync>;
type Seeds = Box<dyn Fn(&Path) -> Vec<Vec<u8>> + Send + Sync>;

pub struct Reader {
    /// As the folder of the corpus is called; what it begins with is the family, which has a target
    /// of the fuzzer.
    pub name: &'static str,
    /// Where the bytes are put, below the stage.
    pub file: String,
    /// What the reader is given, below the stage.
    pub given: String,
    pub around: Around,
    pub wrap: Wrap,
    pub seeds: Seeds,
    pub call: Call,
}

impl Reader {
    pub fn family(&self) -> &'static str {
        self.name.split('-').next().unwrap_or(self.name)
    }

    /// A folder in which this reader reads, ready for bytes. A temporary one, gone when the stage
    /// is.
    pub fn stage(&self) -> io::Result<Stage<'_>> {
        let folder = tempfile::Builder::new().prefix("m4fuzz").tempdir()?;
        let here = folder.path();
        match &self.around {
            Around::Nothing => {}
            Around::Fixtures(all) => {
                for (from, to) in all {
                    copy(&fixture(from), &here.join(to))?;
                }
            }
            Around::Made(make) => make(here),
        }
        let file = here.join(&self.file);
        if let Some(parent) = file.parent() {
            fs::create_dir_all(parent)?;
        }
        let seeds = (self.seeds)(&file);
        Ok(Stage {
            reader: self,
            file,
            given: if self.given.is_empty() {
                here.to_path_buf()
            } else {
                here.join(&self.given)
            },
            seeds,
            folder,
        })
    }
}

pub struct Stage<'a> {
    reader: &'a Reader,
    file: PathBuf,
    given: PathBuf,
    seeds: Vec<Vec<u8>>,
    folder: TempDir,
}

impl Stage<'_> {
    /// Sound contents of the file; at least one.
    pub fn seeds(&self) -> &[Vec<u8>] {
        &self.seeds
    }

    pub fn reader(&self) -> &Reader {
        self.reader
    }

    /// Puts the bytes where they belong, and reads. A message has `STAGE` instead of the folder.
    pub fn read(&self, bytes: &[u8]) -> io::Result<Outcome> {
        // a file that is emptied and written again is sent to the disk at once by some file systems
        match fs::remove_file(&self.file) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            _ => fs::write(&self.file, self.reader.wrap.on(bytes))?,
        }
        let folder = self.folder.path().to_string_lossy();
        Ok(match (self.reader.call)(&self.given) {
            Outcome::Refused(reason) => Outcome::Refused(reason.replace(&*folder, "STAGE")),
            other => other,
        })
    }

    /// What is wrong with what came of some bytes: not valid, or a message that quotes the file, or
    /// does not name it where it must.
    pub fn fault(&self, outcome: &Outcome, named: bool) -> Option<String> {
        match outcome {
            Outcome::Read => None,
            Outcome::Invalid(what) => Some(format!("invalid: {what}")),
            Outcome::Refused(reason) => {
                let n = reason.chars().count();
                let start: String = reason.chars().take(160).collect();
                if named && !reason.contains("STAGE") && !NAMELESS.contains(&self.reader.name) {
                    return Some(format!("a message that does not name the file: {start}"));
                }
                (n > MAX_REASON).then(|| format!("a message of {n} characters: {start}"))
            }
        }
    }
}

pub fn scene(scene: &Scene) -> Option<String> {
    if let Some(fault) = range::of_splats(&scene.splats) {
        return Some(fault);
    }
    let within = |range: &range::Range, v: f32| range.contains(&f64::from(v));
    let faults = [
        (within(&range::NEAR, scene.near), "near"),
        (
            scene.background.iter().all(|v| within(&range::COLOUR, *v)),
            "the background",
        ),
        (
            (1..=*range::FRAMES.end()).contains(&scene.time_frames),
            "the number of frames",
        ),
        (
            scene.duration_s.is_none_or(|s| range::SECONDS.contains(&s)),
            "the duration",
        ),
    ];
    if let Some((_, what)) = faults.into_iter().find(|(valid, _)| !valid) {
        return Some(what.into());
    }
    scene
        .source
        .iter()
        .find_map(|f| range::of_source(f).or_else(|| camera(&f.camera)))
}

pub fn camera(camera: &Camera) -> Option<String> {
    let c2w = camera.c2w.matrix();
    let place = camera
        .c2w
        .translation
        .iter()
        .all(|v| range::COORDINATE.contains(v));
    let rigid = c2w.iter().all(|v| v.is_finite()) && (c2w.determinant() - 1.0).abs() < 1e-2;
    range::of_lens(&camera.intrinsics)
        .or_else(|| (!(rigid && place)).then(|| format!("a pose: {camera:?}")))
}

pub fn tracks(tracks: &Tracks) -> Option<String> {
    let valid = tracks
        .xyz()
        .as_flattened()
        .iter()
        .all(|v| v.is_nan() || range::COORDINATE.contains(&f64::from(*v)));
    (!valid).then(|| "tracks".into())
}

/// Whether depth is in its range, or unknown.
fn is_depth(z: f32) -> bool {
    z == 0.0 || range::DEPTH.contains(&f64::from(z))
}

pub fn depth(depth: &CompactDepth) -> Option<String> {
    (!depth.every(1).all(is_depth)).then(|| "depth".into())
}

pub fn map(map: &DepthMap) -> Option<String> {
    (!map.data().iter().all(|z| is_depth(*z))).then(|| "depth".into())
}

fn frame(frame: &CaptureFrame, last: f64) -> Option<String> {
    let k = &frame.camera.intrinsics;
    if frame.rgb.size() != (k.width, k.height) {
        return Some("the size of an image".into());
    }
    if !(0.0..=last).contains(&frame.t) {
        return Some(format!("a time: {}", frame.t));
    }
    camera(&frame.camera).or_else(|| frame.depth.as_ref().and_then(depth))
}

pub fn capture(capture: &Capture) -> Option<String> {
    let steps = capture.time_frames.saturating_sub(1) as f64;
    let lasts = |s: f64| s == 0.0 || steps == 0.0 || range::FPS.contains(&(steps / s));
    if capture.frames.is_empty() || !capture.duration_s.is_none_or(lasts) {
        return Some(format!(
            "no frames, or their duration: {:?}",
            capture.duration_s
        ));
    }
    let of_tracks = capture.tracks.as_ref().and_then(|t| {
        let fits = t.frames() == capture.frames.len();
        if fits {
            tracks(t)
        } else {
            Some("the length of tracks".into())
        }
    });
    let last = capture.time_frames as f64 - 1.0;
    of_tracks.or_else(|| capture.frames.iter().find_map(|f| frame(f, last)))
}

pub fn video(video: &Video) -> Option<String> {
    if !video
        .frames
        .iter()
        .all(|f| range::SECONDS.contains(&f.time_s))
    {
        return Some("a time".into());
    }
    let size = video.frames.first().map(|f| f.rgb.size());
    let same = video.frames.iter().all(|f| Some(f.rgb.size()) == size);
    (!same).then(|| "images of several sizes".into())
}

pub fn trajectory(path: &Trajectory) -> Option<String> {
    match path {
        Trajectory::Listed(listed) => {
            if !listed.iter().all(|(_, t)| t.is_finite()) {
                return Some("a time".into());
            }
            listed.iter().find_map(|(c, _)| camera(c))
        }
        Trajectory::Keyed(keyed) => {
            let times = keyed
                .keyframes
                .iter()
                .map(|k| k.time_s)
                .chain(keyed.back_s)
                .chain(keyed.fps);
            if keyed.keyframes.is_empty() || !times.into_iter().all(|t| range::SECONDS.contains(&t))
            {
                return Some("a time, or no keyframes".into());
            }
            let valid = keyed.keyframes.iter().all(|k| match &k.pose {
                KeyPose::C2w(c2w) => c2w
                    .translation
                    .iter()
                    .all(|v| range::COORDINATE.contains(v)),
                KeyPose::LookAt {
                    position,
                    look_at,
                    up,
                } => {
                    let up = up.unwrap_or_default();
                    position
                        .iter()
                        .chain(look_at.iter())
                        .chain(up.iter())
                        .all(|v| range::COORDINATE.contains(v))
                }
            });
            (!valid).then(|| "a pose".into())
        }
    }
}
