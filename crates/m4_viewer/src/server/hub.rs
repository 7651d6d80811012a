//! The state shown by the server, set by the program and read by every request, and the server-sent
//! events that a page has not received yet.

use super::Shared;
use super::guard::query_value;
use crate::frames::Frames;
use crate::manifest::{Live, Manifest};
use crate::page::Parts;
use axum::extract::State;
use axum::http::Uri;
use axum::response::sse::{Event, KeepAlive, Sse};
use futures_util::stream::{Stream, unfold};
use serde::Serialize;
use std::convert::Infallible;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::sync::watch::Receiver;

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

    /// Shows a scene (`payload` before gzip, and what describes it), and tells every page that is
    /// open.
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
        let event = Event {
            event: "metrics",
            metrics,
        };
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
        self.pulse
            .send_if_modified(|pulse| pulse.end.replace(ok) != Some(ok));
    }

    /// Number of listening pages.
    pub fn listeners(&self) -> usize {
        self.pulse.receiver_count()
    }

    pub(super) fn subscribe(&self) -> Receiver<Pulse> {
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
            (
                manifest,
                shown.payload.clone(),
                shown.frames.clone(),
                shown.version,
            )
        };
        // frames belong to the cameras of a scene: of those that do not fit none are shown
        let frames = frames.filter(|f| f.index.offsets.len() == manifest.cameras.len() + 1);
        manifest.frames = frames.as_ref().map(|f| f.index.clone());
        manifest.live = Some(Live {
            events: format!("/events?token={token}&seen={version}"),
            scene: format!("/scene?token={token}"),
            token: token.to_owned(),
        });
        make(&Parts {
            manifest: &manifest,
            payload: payload.as_ref().map(|p| p.as_slice()),
            frames: frames.as_deref(),
        })
    }
}

/// Interval of keep-alive messages; also the delay until a closed page is noticed.
const BREATH: Duration = Duration::from_secs(5);

struct Listener {
    hub: Arc<Hub>,
    pulse: Receiver<Pulse>,
    version: u64,
    logged: usize,
    end: Option<bool>,
}

/// The events from where the page stands: `seen` in the query is the version of the scene in it.
pub(super) async fn stream(
    State(shared): State<Shared>,
    uri: Uri,
) -> Sse<impl Stream<Item = Result<Event, Infallible>>> {
    let version = query_value(uri.query(), "seen").and_then(|v| v.parse().ok());
    let listener = Listener {
        pulse: shared.hub.subscribe(),
        hub: shared.hub,
        version: version.unwrap_or(0),
        logged: 0,
        end: None,
    };
    let events = unfold(listener, |mut listener| async {
        let text = listener.next().await?;
        Some((Ok(Event::default().data(text)), listener))
    });
    Sse::new(events).keep_alive(KeepAlive::new().interval(BREATH))
}

impl Listener {
    /// The next event, once there is one; `None` when the server ends.
    async fn next(&mut self) -> Option<String> {
        loop {
            let pulse = *self.pulse.borrow_and_update();
            if self.logged < pulse.logged
                && let Some(line) = self.hub.logged(self.logged)
            {
                self.logged += 1;
                return Some(line.to_string());
            }
            if self.version != pulse.version {
                self.version = pulse.version;
                return Some(format!(
                    "{{\"event\":\"scene\",\"version\":{}}}",
                    pulse.version
                ));
            }
            if std::mem::replace(&mut self.end, pulse.end) != pulse.end
                && let Some(ok) = pulse.end
            {
                return Some(format!("{{\"event\":\"end\",\"ok\":{ok}}}"));
            }
            self.pulse.changed().await.ok()?;
        }
    }
}
