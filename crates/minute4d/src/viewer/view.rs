//! `minute4d view`: shows a scene in the browser, and every newer one that replaces it.

use super::source::{Source, Stamp};
use crate::{Error, Observer};
use m4_kernels::SimdLevel;
use m4_viewer::server::{Hub, Server};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Interval of checks of the folder.
const LOOK: Duration = Duration::from_millis(500);
/// Interval of checks for a stop.
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
    found: Option<Stamp>,
    metrics: Option<Stamp>,
    /// Last iteration announced to the pages.
    told: usize,
    with_frames: bool,
}

/// Serves a scene (a file, or the folder of a run, which may still train) on a port of 127.0.0.1, any
/// free one for 0.
///
/// # Errors
///
/// [`Error::Missing`] if there is no scene and no run, [`Error::Data`] if the scene cannot be
/// read, [`Error::Viewer`] if the port cannot be had.
pub fn view(path: &Path, port: u16, observer: &dyn Observer) -> Result<Viewing, Error> {
    let level = SimdLevel::detect()?;
    let source = Source::new(path)?;
    let hub = Hub::waiting(&source.title());
    let mut viewing = Viewing {
        server: Server::start(Arc::clone(&hub), port)?,
        shown: None,
        found: None,
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
    #[must_use]
    pub fn url(&self) -> &str {
        self.server.url()
    }

    /// Shows what is new until the caller asks to stop. A file that cannot be read is reported and the scene
    /// before stays.
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
        let still = newest == self.found;
        self.found.clone_from(&newest);
        if let Some(stamp) = newest.filter(|stamp| still && self.shown.as_ref() != Some(stamp)) {
            match self.show(stamp.clone(), observer) {
                Ok(()) => {}
                // an older checkpoint may go away while it is read: the next look finds the newer one
                Err(_) if Stamp::of(&stamp.path).as_ref() != Some(&stamp) => self.shown = None,
                Err(error) => observer.warn(&format!("the newer scene cannot be shown: {error}")),
            }
        }
        self.tell();
    }

    /// Reads a scene whole, then tells the pages.
    fn show(&mut self, stamp: Stamp, observer: &dyn Observer) -> Result<(), Error> {
        self.shown = Some(stamp.clone());
        let (manifest, payload, scene) = self.source.load(&stamp, self.level)?;
        if !self.with_frames
            && let Some(frames) = self.source.frames(&scene, observer)
        {
            self.hub.set_frames(frames);
            self.with_frames = true;
        }
        self.hub.show(manifest, payload);
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
