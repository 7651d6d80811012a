//! Shows the scene in the browser during training.

use super::{Source, event};
use m4_core::{Progress, Scene};
use m4_kernels::SimdLevel;
use m4_train::MetricsEvent;
use m4_viewer::server::{Hub, Server};
use minute4d::page::pack;
use minute4d::{Error, Observer, StageEvent};
use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time for which an ended run waits for pages to fetch its last scene.
const LINGER: Duration = Duration::from_secs(3);
/// Least seconds between two scenes: a person does not follow more.
const EVERY_S: f64 = 2.0;
/// Most of the machine's time that scenes for the page may take, which is not noticed; when they
/// would take more there are fewer.
const SHARE: f64 = 0.03;

/// An observer that passes everything on, and shows scenes and metrics to the pages of a server.
///
/// Training is asked for a copy of its scene only while a page is open, and seldom; a thread of its
/// own packs the copy. What is computed does not depend on any of it.
pub struct Broadcast<'a> {
    inner: &'a dyn Observer,
    hub: Arc<Hub>,
    server: Server,
    worker: Option<(SyncSender<Copied>, JoinHandle<()>)>,
    pace: Arc<Mutex<Pace>>,
}

struct Copied {
    scene: Scene,
    median_depth: f64,
    /// Time for which training waited for the copy.
    waited: Duration,
}

/// When the next scene may be copied.
#[derive(Debug)]
struct Pace {
    threads: f64,
    busy: bool,
    next: Instant,
}

impl Pace {
    /// After a scene that held all threads for `waited` and one of them for `packed`.
    fn done(&mut self, waited: Duration, packed: Duration, now: Instant) {
        let cost_s = waited.as_secs_f64() + packed.as_secs_f64() / self.threads;
        let pause_s = (cost_s / SHARE).max(EVERY_S);
        self.busy = false;
        self.next = now + Duration::try_from_secs_f64(pause_s).unwrap_or(Duration::from_secs(60));
    }
}

fn lock(pace: &Mutex<Pace>) -> MutexGuard<'_, Pace> {
    pace.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<'a> Broadcast<'a> {
    /// Serves pages called `title` on a port of 127.0.0.1, any free one for 0.
    ///
    /// # Errors
    ///
    /// [`Error::Serve`] if the port cannot be had, [`Error::Internal`] if there is no thread.
    pub fn start(inner: &'a dyn Observer, title: &str, port: u16) -> Result<Self, Error> {
        let hub = Hub::waiting(title);
        let server = Server::start(Arc::clone(&hub), port)?;
        let pace = Arc::new(Mutex::new(Pace {
            threads: rayon::current_num_threads() as f64,
            busy: false,
            next: Instant::now(),
        }));
        let (send, receive) = sync_channel(1);
        let (title, to, done) = (title.to_owned(), Arc::clone(&hub), Arc::clone(&pace));
        let thread = std::thread::Builder::new()
            .name("snapshots".to_owned())
            .spawn(move || pack_all(&receive, &title, &to, &done))
            .map_err(|e| Error::internal(format!("cannot start a thread for the page: {e}")))?;
        Ok(Self {
            inner,
            hub,
            server,
            worker: Some((send, thread)),
            pace,
        })
    }

    /// The address of the page, token included.
    pub fn url(&self) -> &str {
        self.server.url()
    }

    /// Shows the result of a run, if it has one, and tells the pages that it ended.
    pub fn finish(&mut self, out: &Path, ok: bool) -> Result<(), Error> {
        if let Some((send, thread)) = self.worker.take() {
            drop(send);
            let _ = thread.join();
        }
        let shown = if ok { self.show_result(out) } else { Ok(()) };
        self.hub.end(ok);
        shown
    }

    fn show_result(&self, out: &Path) -> Result<(), Error> {
        let source = Source::new(out)?;
        if let Some(stamp) = source.newest() {
            source.show(&stamp, SimdLevel::detect()?, &self.hub, true, self.inner)?;
        }
        Ok(())
    }

    /// Keeps serving until the caller asks to stop; with `briefly` only until open pages had time
    /// to fetch the last scene.
    pub fn stay(&self, briefly: bool) {
        let start = Instant::now();
        let over = || briefly && (self.hub.listeners() == 0 || start.elapsed() >= LINGER);
        while !self.inner.cancelled() && !over() {
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

fn pack_all(scenes: &Receiver<Copied>, title: &str, hub: &Hub, pace: &Mutex<Pace>) {
    while let Ok(copied) = scenes.recv() {
        let start = Instant::now();
        let (manifest, payload) = pack(&copied.scene, title, copied.median_depth);
        hub.show(manifest, payload.bytes);
        let waited = copied.waited;
        drop(copied);
        lock(pace).done(waited, start.elapsed(), Instant::now());
    }
}

impl Progress for Broadcast<'_> {
    fn update(&self, phase: &str, done: usize, total: usize, note: &str) {
        self.inner.update(phase, done, total, note);
    }

    fn warn(&self, message: &str) {
        self.inner.warn(message);
    }

    fn cancelled(&self) -> bool {
        self.inner.cancelled()
    }
}

impl Observer for Broadcast<'_> {
    fn stage(&self, name: &str, event: StageEvent<'_>) {
        self.inner.stage(name, event);
    }

    fn metrics(&self, metrics: &MetricsEvent, iterations: usize) {
        self.hub.metrics(&event(metrics, iterations));
        self.inner.metrics(metrics, iterations);
    }

    fn wants_scene(&self) -> bool {
        if self.hub.listeners() == 0 {
            return self.inner.wants_scene();
        }
        let pace = lock(&self.pace);
        (!pace.busy && Instant::now() >= pace.next) || self.inner.wants_scene()
    }

    fn scene(&self, copy: &mut dyn FnMut() -> Scene, median_depth: f64) {
        self.inner.scene(copy, median_depth);
        let Some((send, _)) = &self.worker else {
            return;
        };
        let start = Instant::now();
        lock(&self.pace).busy = true;
        let scene = copy();
        let copied = Copied {
            scene,
            median_depth,
            waited: start.elapsed(),
        };
        if let Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) = send.try_send(copied) {
            lock(&self.pace).busy = false;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Pace;
    use std::time::{Duration, Instant};

    #[test]
    fn scenes_that_cost_much_come_seldom() {
        let start = Instant::now();
        let mut pace = Pace {
            threads: 2.0,
            busy: true,
            next: start,
        };
        let ms = Duration::from_millis;
        pace.done(ms(1), ms(10), start);
        assert_eq!(pace.next - start, ms(2000), "no more than a person follows");
        pace.done(ms(50), ms(500), start);
        assert!(
            !pace.busy && (pace.next - start).abs_diff(ms(10_000)) < ms(1),
            "0.3 s of two threads, 3 %"
        );
    }
}
