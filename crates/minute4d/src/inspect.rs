//! Describes the contents of a file or folder.

use crate::folder::SCENE_FILE;
use crate::record::{RUN_FILE, RunRecord, Status};
use crate::settings::Settings;
use crate::{Error, Observer, hash, is_capture};
use m4_core::{Capture, Scene};
use m4_io::capture::{CaptureOptions, Split};
use m4_io::reach::Reach;
use m4_io::scene::safetensors;
use m4_io::video::VideoOptions;
use serde::Serialize;
use std::fmt;
use std::path::Path;

/// The description of a file or folder.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Inspection {
    /// A video, or a folder of images.
    Video(VideoFacts),
    /// Posed frames.
    Capture(CaptureFacts),
    /// A scene file.
    Scene(SceneFacts),
    /// The folder of a run.
    Run(Box<RunFacts>),
}

/// Facts about a clip.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VideoFacts {
    /// Frames that can be decoded.
    frames: usize,
    /// Width and height, upright, pixels.
    size: [usize; 2],
    /// Seconds from the first to the last frame.
    duration_s: f64,
    /// Mean frames per second.
    fps: Option<f64>,
    /// Longest over median time between frames: 1 for an even clock.
    longest_gap: Option<f64>,
    /// Focal length of the frames in the file, pixels, if the file states it.
    focal_px: Option<f64>,
    warnings: Vec<String>,
}

/// Facts about a capture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CaptureFacts {
    /// Training frames.
    frames: usize,
    /// Width and height of the first, pixels.
    size: [usize; 2],
    /// Horizontal field of view of the first, degrees.
    fov_deg: f64,
    /// Seconds from the first to the last frame, where known.
    duration_s: Option<f64>,
    /// True when a unit is a metre.
    metric: bool,
    /// Length of the camera's path, units.
    path_length: f64,
    with_depth: usize,
    with_mask: usize,
    /// Share of pixels that the masks mark as dynamic.
    moving_share: Option<f64>,
    /// Held-out views listed, if the list can be read.
    test_views: Option<usize>,
}

/// Facts about a scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SceneFacts {
    /// Splats without time parameters.
    splats_static: usize,
    /// Splats with time parameters.
    splats_dynamic: usize,
    /// True if splats have one scale instead of three.
    isotropic: bool,
    sh_degree: usize,
    /// Highest temporal harmonic.
    time_degree: usize,
    time_frames: usize,
    /// Seconds, where known.
    duration_s: Option<f64>,
    cameras: usize,
    /// True if training can be resumed from it.
    with_optimiser: bool,
    finite: bool,
}

/// Facts about a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunFacts {
    record: RunRecord,
    /// Files that are missing or have changed.
    damaged: Vec<String>,
    /// Its scene, if it has one that can be read.
    scene: Option<SceneFacts>,
}

/// Describes the contents of `path`; a capture may refer to files within `reach`.
///
/// # Errors
///
/// [`Error`] naming what is wrong with it.
pub fn inspect(path: &Path, reach: Reach, observer: &dyn Observer) -> Result<Inspection, Error> {
    if !path.exists() {
        return Err(Error::Missing { what: "file or folder", path: path.to_path_buf() });
    }
    if path.join(RUN_FILE).is_file()
        && let Some(record) = RunRecord::read(path)?
    {
        return run_facts(path, record);
    }
    if is_capture(path) {
        let options = CaptureOptions { reach, ..Settings::fast().capture };
        let capture = m4_io::capture::read(path, Split::Train, &options, observer)?;
        return Ok(Inspection::Capture(capture_facts(path, &capture)));
    }
    if path.extension().is_some_and(|e| e == "safetensors") {
        return Ok(Inspection::Scene(scene_facts(path)?));
    }
    video_facts(path, observer)
}

fn run_facts(path: &Path, record: RunRecord) -> Result<Inspection, Error> {
    let mut damaged = Vec::new();
    for (name, file) in &record.files {
        let full = path.join(name);
        if !full.is_file() || hash::of_path(&full)? != file.blake3 {
            damaged.push(name.clone());
        }
    }
    let scene = path.join(SCENE_FILE);
    let scene = if scene.is_file() { Some(scene_facts(&scene)?) } else { None };
    Ok(Inspection::Run(Box::new(RunFacts { record, damaged, scene })))
}

fn scene_facts(path: &Path) -> Result<SceneFacts, Error> {
    let file = safetensors::read(path)?;
    let scene: &Scene = &file.scene;
    let splats = &scene.splats;
    let layout = splats.layout();
    Ok(SceneFacts {
        splats_static: splats.n_static(),
        splats_dynamic: splats.n_dynamic(),
        isotropic: layout.isotropic,
        sh_degree: layout.sh_degree,
        time_degree: layout.time_degree,
        time_frames: scene.time_frames,
        duration_s: scene.duration_s,
        cameras: scene.source.len(),
        with_optimiser: file.state.is_some(),
        finite: splats.is_finite(),
    })
}

fn capture_facts(path: &Path, capture: &Capture) -> CaptureFacts {
    let lens = capture.frames.first().map(|f| f.camera.intrinsics);
    let centres = capture.frames.iter().map(|f| f.camera.centre());
    let steps = centres.clone().zip(centres.skip(1)).map(|(a, b)| (b - a).norm());
    CaptureFacts {
        frames: capture.frames.len(),
        size: lens.map_or([0, 0], |k| [k.width, k.height]),
        fov_deg: lens.map_or(0.0, |k| k.horizontal_fov_rad().to_degrees()),
        duration_s: capture.duration_s,
        metric: capture.metric,
        path_length: steps.sum(),
        with_depth: capture.frames.iter().filter(|f| f.depth.is_some()).count(),
        with_mask: capture.frames.iter().filter(|f| f.mask.is_some()).count(),
        moving_share: crate::enhance::moving_share(capture),
        test_views: test_views(path),
    }
}

/// The number of held-out views, from the list alone.
fn test_views(path: &Path) -> Option<usize> {
    let text = std::fs::read(path.join(Split::Test.file_name())).ok()?;
    let list: serde_json::Value = serde_json::from_slice(&text).ok()?;
    Some(list.get("frames")?.as_array()?.len())
}

fn video_facts(path: &Path, observer: &dyn Observer) -> Result<Inspection, Error> {
    // All frames, but small, so that a long clip fits the memory; then two at their own size.
    let small = VideoOptions { size: Some(64), ..VideoOptions::default() };
    let video = m4_io::video::read(path, &small, observer)?;
    let full = VideoOptions { size: None, max_frames: Some(2), ..VideoOptions::default() };
    let ends = m4_io::video::read(path, &full, observer)?;
    let times: Vec<f64> = video.frames.iter().map(|f| f.time_s).collect();
    let mut gaps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
    gaps.sort_by(f64::total_cmp);
    let duration_s = times.last().zip(times.first()).map_or(0.0, |(b, a)| b - a);
    let median = gaps.get(gaps.len() / 2).copied().filter(|&g| g > 0.0);
    let size = ends.frames.first().map_or([0, 0], |f| f.rgb.size().into());
    Ok(Inspection::Video(VideoFacts {
        frames: times.len(),
        size,
        duration_s,
        fps: (duration_s > 0.0).then(|| (times.len() - 1) as f64 / duration_s),
        longest_gap: median.zip(gaps.last()).map(|(median, longest)| longest / median),
        focal_px: ends.focal_px,
        warnings: video.warnings,
    }))
}

impl fmt::Display for Inspection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Video(facts) => facts.fmt(f),
            Self::Capture(facts) => facts.fmt(f),
            Self::Scene(facts) => facts.fmt(f),
            Self::Run(facts) => facts.fmt(f),
        }
    }
}

/// ` (3.20 s)`, or nothing.
fn seconds(duration_s: Option<f64>) -> String {
    duration_s.map_or_else(String::new, |s| format!(", {s:.2} s"))
}

impl fmt::Display for VideoFacts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [w, h] = self.size;
        write!(f, "video: {} frames of {w} x {h} pixels, {:.2} s", self.frames, self.duration_s)?;
        if let Some(fps) = self.fps {
            write!(f, ", {fps:.2} frames per second")?;
        }
        if let Some(gap) = self.longest_gap.filter(|&g| g > 1.5) {
            write!(f, "\nuneven clock: the longest gap between frames is {gap:.1} times the usual one")?;
        }
        if let Some(focal) = self.focal_px {
            write!(f, "\nfocal length stated in the file: {focal:.1} px")?;
        }
        self.warnings.iter().try_for_each(|w| write!(f, "\nwarning: {w}"))
    }
}

impl fmt::Display for CaptureFacts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [w, h] = self.size;
        writeln!(
            f,
            "capture: {} frames of {w} x {h} pixels{}, field of view {:.1} degrees",
            self.frames,
            seconds(self.duration_s),
            self.fov_deg
        )?;
        let unit = if self.metric { "m" } else { "units (scale unknown)" };
        write!(f, "camera path: {:.3} {unit}", self.path_length)?;
        write!(f, "\ndepth: {} frames\nmasks: {} frames", self.with_depth, self.with_mask)?;
        if let Some(share) = self.moving_share {
            write!(f, ", {:.1} % of the pixels move", 100.0 * share)?;
        }
        match self.test_views {
            Some(n) => write!(f, "\nheld-out views: {n}"),
            None => write!(f, "\nheld-out views: none"),
        }
    }
}

impl fmt::Display for SceneFacts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shape = if self.isotropic { "isotropic" } else { "anisotropic" };
        writeln!(
            f,
            "scene: {} static and {} dynamic splats, {shape}, colour degree {} in space and {} in time",
            self.splats_static, self.splats_dynamic, self.sh_degree, self.time_degree
        )?;
        write!(f, "time: {} frames{}, {} cameras", self.time_frames, seconds(self.duration_s), self.cameras)?;
        if !self.finite {
            write!(f, "\ndamaged: some numbers are not finite")?;
        }
        let optimiser = if self.with_optimiser { "included" } else { "not included" };
        write!(f, "\nstate of the optimiser: {optimiser}")
    }
}

impl fmt::Display for RunFacts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let record = &self.record;
        let status = match record.status {
            Status::Running => "unfinished (running, or killed)",
            Status::Stopped => "stopped, can be resumed",
            Status::Failed => "failed",
            Status::Finished => "finished",
        };
        writeln!(f, "run: {status}, profile {}, seed {}, minute4d {}", record.profile, record.seed, record.minute4d)?;
        writeln!(f, "input: {}", record.input.path)?;
        for (name, stage) in &record.stages {
            let state = if stage.done { "done" } else { "not done" };
            writeln!(f, "stage {name}: {state}, {:.1} s", stage.seconds)?;
        }
        if let Some(bytes) = record.peak_memory_bytes {
            writeln!(f, "peak memory: {:.0} MiB", bytes as f64 / f64::from(1 << 20))?;
        }
        if let Some(error) = &record.error {
            writeln!(f, "error: {error}")?;
        }
        for warning in &record.warnings {
            writeln!(f, "warning: {warning}")?;
        }
        for name in &self.damaged {
            writeln!(f, "damaged: {name} is missing or not as it was written")?;
        }
        match &self.scene {
            Some(scene) => scene.fmt(f),
            None => write!(f, "scene: none yet"),
        }
    }
}
