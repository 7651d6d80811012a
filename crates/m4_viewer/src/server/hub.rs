//! The state shown by the server: set by the program, read by every request.

use crate::frames::Frames;
use crate::manifest::{Live, Manifest};
use crate::page::Parts;
use serde::Serialize;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;

/// Metrics of training.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Metrics {
    /// Steps taken.
    pub iteration: usize,
    /// Steps of the whole run.
    pub iterations: usize,
    /// The loss.
    pub loss: f64,
    /// Of the last frame, dB.
    pub psnr: f64,
    /// The number of them.
    pub splats: usize,
}

/// Counters of events.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Pulse {
    /// Scenes shown.
    pub version: u64,
    /// Lines of the log.
    pub logged: usize,
    /// The outcome.
    pub end: Option<bool>,
}

#[derive(Debug)]
struct Shown {
    manifest: Arc<Manifest>,
    payload: Option<Arc<Vec<u8>>>,
    frames: Option<Arc<Frames>>,
    version: u64,
}

/// The newest scene and the clients that wait for the next.
#[derive(Debug)]
pub struct Hub {
    shown: Mutex<Shown>,
    log: Mutex<Vec<Arc<str>>>,
    pulse: watch::Sender<Pulse>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Hub {
    /// Shows a page that waits for its first scene.
    #[must_use]
    pub fn waiting(title: &str) -> Arc<Self> {
        Arc::new(Self {
            shown: Mutex::new(Shown {
                manifest: Arc::new(Manifest::waiting(title)),
                payload: None,
                frames: None,
                version: 0,
            }),
            log: Mutex::default(),
            pulse: watch::Sender::new(Pulse::default()),
        })
    }

    /// Puts the frames of the source into pages that are opened from now on.
    pub fn set_frames(&self, frames: Frames) {
        lock(&self.shown).frames = Some(Arc::new(frames));
    }

    /// Shows a scene (`payload` before gzip, and what describes it), and tells every page that is open.
    pub fn show(&self, manifest: Manifest, payload: Vec<u8>) {
        let version = {
            let mut shown = lock(&self.shown);
            shown.manifest = Arc::new(manifest);
            shown.payload = Some(Arc::new(payload));
            shown.version += 1;
            shown.version
        };
        self.pulse.send_modify(|pulse| pulse.version = version);
    }

    /// Tells how training continues.
    pub fn metrics(&self, metrics: &Metrics) {
        #[derive(Serialize)]
        struct Event<'a> {
            event: &'static str,
            #[serde(flatten)]
            metrics: &'a Metrics,
        }
        // numbers that are not finite become null, which the page leaves out
        let event = Event { event: "metrics", metrics };
        let Ok(line) = serde_json::to_string(&event) else {
            return;
        };
        let logged = {
            let mut log = lock(&self.log);
            log.push(line.into());
            log.len()
        };
        self.pulse.send_modify(|pulse| {
            pulse.logged = logged;
            // a stopped run resumed, or another began
            pulse.end = None;
        });
    }

    /// Tells that the run has ended; [`metrics`](Self::metrics) begin another one.
    pub fn end(&self, ok: bool) {
        self.pulse.send_if_modified(|pulse| pulse.end.replace(ok) != Some(ok));
    }

    /// Number of listening pages.
    #[must_use]
    pub fn listeners(&self) -> usize {
        self.pulse.receiver_count()
    }

    pub(super) fn subscribe(&self) -> watch::Receiver<Pulse> {
        self.pulse.subscribe()
    }

    pub(super) fn logged(&self, index: usize) -> Option<Arc<str>> {
        lock(&self.log).get(index).cloned()
    }

    /// Current contents of a page; its manifest holds the address of events.
    pub(super) fn with_parts<R>(&self, token: &str, make: impl FnOnce(&Parts<'_>) -> R) -> R {
        let (mut manifest, payload, frames, version) = {
            let shown = lock(&self.shown);
            let manifest = Manifest::clone(&shown.manifest);
            (manifest, shown.payload.clone(), shown.frames.clone(), shown.version)
        };
        // frames belong to the cameras of a scene: of those that do not fit none are shown
        let frames = frames.filter(|f| f.index.offsets.len() == manifest.cameras.len() + 1);
        manifest.frames = frames.as_ref().map(|f| f.index.clone());
        manifest.live = Some(Live {
            events: format!("/events?token={token}&seen={version}"),
            scene: format!("/scene?token={token}"),
            token: token.to_owned(),
        });
        make(&Parts { manifest: &manifest, payload: payload.as_ref().map(|p| p.as_slice()), frames: frames.as_deref() })
    }
}
