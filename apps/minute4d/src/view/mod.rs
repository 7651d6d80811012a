//! `minute4d view`: finds the scene in a folder, shows it in the browser, and every newer one that
//! replaces it.

mod broadcast;

pub use broadcast::Broadcast;

use crate::run::folder;
use crate::run::record::{RunRecord, Status};
use crate::run::viewer::title;
use m4_core::{Progress, Scene};
use m4_io::capture::{CaptureOptions, Split};
use m4_io::files;
use m4_io::scene::safetensors;
use m4_kernels::SimdLevel;
use m4_train::MetricsEvent;
use m4_viewer::server::{Hub, Metrics, Server};
use m4_viewer::{Frames, page};
use minute4d::json::MAX_RECORD_BYTES;
use minute4d::layout::{self, CAPTURE_FOLDER, METRICS_FILE, SCENE_FILE, VIEWER_FILE, is_capture};
use minute4d::page::{frames, median_depth, pack};
use minute4d::{Error, Observer};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

const LOOK: Duration = Duration::from_millis(500);
const ASK: Duration = Duration::from_millis(50);

/// A server at work.
#[derive(Debug)]
pub struct Viewing {
    source: Source,
    level: SimdLevel,
    hub: Arc<Hub>,
    server: Server,
    /// The scene that is shown, or that could not be.
    shown: Option<Stamp>,
    /// State at the last check: a file is read once two checks agree.
    last_stamp: Option<Stamp>,
    metrics: Option<Stamp>,
    /// Last iteration announced to the pages.
    told: usize,
    with_frames: bool,
}

/// Serves a scene (a file, or the folder of a run, which may still train) on a port of 127.0.0.1,
/// any free one for 0.
///
/// # Errors
///
/// [`Error::Missing`] if there is no scene and no run, [`Error::ReadData`] if the scene cannot be
/// read, [`Error::Serve`] if the port cannot be had.
pub fn view(path: &Path, port: u16, observer: &dyn Observer) -> Result<Viewing, Error> {
    let level = SimdLevel::detect()?;
    let source = Source::new(path)?;
    let hub = Hub::waiting(&source.title());
    let mut viewing = Viewing {
        server: Server::start(Arc::clone(&hub), port)?,
        shown: None,
        last_stamp: None,
        metrics: None,
        told: 0,
        with_frames: false,
        source,
        level,
        hub,
    };
    if let Some(stamp) = viewing.source.newest() {
        viewing.show(stamp, observer)?;
    }
    viewing.tell();
    Ok(viewing)
}

impl Viewing {
    /// The address of the page, token included.
    pub fn url(&self) -> &str {
        self.server.url()
    }

    /// Shows what is new until the caller asks to stop. A file that cannot be read is reported and
    /// the scene before stays.
    pub fn follow(&mut self, observer: &dyn Observer) {
        let mut next = Instant::now() + LOOK;
        while !observer.cancelled() {
            std::thread::sleep(ASK);
            if Instant::now() >= next {
                self.look(observer);
                next = Instant::now() + LOOK;
            }
        }
    }

    fn look(&mut self, observer: &dyn Observer) {
        let newest = self.source.newest();
        let still = newest == self.last_stamp;
        self.last_stamp.clone_from(&newest);
        if let Some(stamp) = newest.filter(|stamp| still && self.shown.as_ref() != Some(stamp)) {
            match self.show(stamp.clone(), observer) {
                Ok(()) => {}
                // an older checkpoint may go away while it is read: the next look finds the newer
                // one
                Err(_) if Stamp::of(&stamp.path).as_ref() != Some(&stamp) => self.shown = None,
                Err(error) => observer.warn(&format!("the newer scene cannot be shown: {error}")),
            }
        }
        self.tell();
    }

    /// Reads a scene whole, then tells the pages.
    fn show(&mut self, stamp: Stamp, observer: &dyn Observer) -> Result<(), Error> {
        self.shown = Some(stamp.clone());
        let wanted = !self.with_frames;
        let with_frames = self
            .source
            .show(&stamp, self.level, &self.hub, wanted, observer)?;
        self.with_frames |= with_frames;
        Ok(())
    }

    /// Tells the pages how training continues, where a run says so.
    fn tell(&mut self) {
        let stamp = self.source.metrics_stamp();
        if stamp != self.metrics {
            self.metrics = stamp;
            let metrics = self.source.metrics();
            let last = metrics.last().map_or(0, |m| m.iteration);
            // fewer than before: another run has begun
            let from = if last < self.told { 0 } else { self.told };
            for m in metrics.iter().filter(|m| m.iteration > from) {
                self.hub.metrics(m);
            }
            self.told = last;
        }
        if let Some(ok) = self.source.end() {
            self.hub.end(ok);
        }
    }
}

/// A file as it lies there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Stamp {
    pub path: PathBuf,
    len: u64,
    modified: Option<SystemTime>,
}

impl Stamp {
    /// `None` where there is no such file.
    pub fn of(path: &Path) -> Option<Self> {
        let facts = fs::metadata(path).ok().filter(fs::Metadata::is_file)?;
        Some(Self {
            path: path.to_path_buf(),
            len: facts.len(),
            modified: facts.modified().ok(),
        })
    }
}

/// A scene file, or the folder of a run.
#[derive(Debug)]
pub(super) struct Source {
    path: PathBuf,
}

impl Source {
    /// Takes a path with a scene, or one where a run is at work or was stopped.
    pub fn new(path: &Path) -> Result<Self, Error> {
        layout::settle(path)?;
        let source = Self {
            path: path.to_path_buf(),
        };
        if source.newest().is_some() || (path.is_dir() && RunRecord::read(path)?.is_some()) {
            return Ok(source);
        }
        Err(Error::missing("scene or run", path))
    }

    /// The scene, or the newest checkpoint where training is not done.
    pub fn newest(&self) -> Option<Stamp> {
        if !self.path.is_dir() {
            return Stamp::of(&self.path);
        }
        let checkpoints = folder::checkpoints(&self.path);
        let newest = checkpoints.last().and_then(|(_, path)| Stamp::of(path));
        Stamp::of(&self.path.join(SCENE_FILE)).or(newest)
    }

    /// The lines of the metrics as they are now.
    pub fn metrics_stamp(&self) -> Option<Stamp> {
        Stamp::of(&self.path.join(METRICS_FILE))
    }

    fn record(&self) -> Option<RunRecord> {
        RunRecord::read(&self.path).ok().flatten()
    }

    /// Outcome of the run, once it ended; `None` while it continues. A scene alone is a result.
    pub fn end(&self) -> Option<bool> {
        if !self.path.is_dir() {
            return Some(true);
        }
        match self.record()?.status {
            Status::Running => None,
            Status::Finished => Some(true),
            Status::Stopped | Status::Failed => Some(false),
        }
    }

    /// Returns the title of the page.
    pub fn title(&self) -> String {
        match self.record() {
            Some(record) => title(&self.path, &record.input.path),
            None => title(&self.path, &self.path.display().to_string()),
        }
    }

    /// Returns the metrics so far.
    pub fn metrics(&self) -> Vec<Metrics> {
        let text =
            files::read_text(&self.path.join(METRICS_FILE), MAX_RECORD_BYTES).unwrap_or_default();
        let events: Vec<MetricsEvent> = text
            .lines()
            .filter_map(|l| serde_json::from_str(l).ok())
            .collect();
        let done = events.last().map_or(0, |e| e.iteration);
        let record = self.record();
        let asked = record
            .as_ref()
            .and_then(|r| r.settings["train"]["iterations"].as_u64());
        let finished = record.is_some_and(|r| r.status == Status::Finished);
        // a run that was given seconds says how many iterations they were only when it is done
        let iterations = asked.map_or(done, |n| n as usize).max(done);
        events
            .iter()
            .map(|e| event(e, if finished { done } else { iterations }))
            .collect()
    }

    /// Shows a file of a scene, and the frames of its clip where they are `wanted`. Returns whether
    /// the frames are shown.
    pub fn show(
        &self,
        stamp: &Stamp,
        level: SimdLevel,
        hub: &Hub,
        wanted: bool,
        progress: &dyn Progress,
    ) -> Result<bool, Error> {
        let scene = safetensors::read(&stamp.path)?.scene;
        let (manifest, payload) = pack(&scene, &self.title(), median_depth(&scene, level));
        let frames = wanted.then(|| self.frames(&scene, progress)).flatten();
        let with_frames = frames.is_some();
        if let Some(frames) = frames {
            hub.set_frames(frames);
        }
        hub.show(manifest, payload.bytes);
        Ok(with_frames)
    }

    /// The frames of the source, where they can be found.
    fn frames(&self, scene: &Scene, progress: &dyn Progress) -> Option<Frames> {
        let html = files::read_text(&self.path.join(VIEWER_FILE), u64::MAX).ok();
        let from_page = html.and_then(|html| page::read_frames(&html).ok().flatten());
        if let Some(frames) = from_page.filter(|f| f.index.offsets.len() == scene.source.len() + 1)
        {
            return Some(frames);
        }
        let input = self.record().map(|r| PathBuf::from(r.input.path));
        let captures = [Some(self.path.join(CAPTURE_FOLDER)), input];
        let capture = captures
            .into_iter()
            .flatten()
            .find(|path| is_capture(path))?;
        let read =
            m4_io::capture::read(&capture, Split::Train, &CaptureOptions::default(), progress)
                .ok()?;
        frames(&read, scene).ok().flatten()
    }
}

pub(super) fn event(event: &MetricsEvent, iterations: usize) -> Metrics {
    Metrics {
        iteration: event.iteration,
        iterations,
        loss: event.loss,
        psnr: event.psnr,
        splats: event.splats_static + event.splats_dynamic,
    }
}
