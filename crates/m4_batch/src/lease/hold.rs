//! A lease that is held: renewed from a thread of its own for as long as it lives.

use super::{Holder, store};
use crate::error::FileError;
use m4_io::atomic;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Renewals within the time that a lease lasts.
const RENEWALS: u32 = 4;

#[derive(Debug)]
struct Held {
    number: u64,
    content: Vec<u8>,
    /// Just before it was last renewed.
    renewed: Instant,
    lost: bool,
    ended: bool,
}

#[derive(Debug)]
struct Shared {
    folder: PathBuf,
    lasts: Duration,
    held: Mutex<Held>,
    wake: Condvar,
}

/// A job of ours. Dropped without [`Lease::release`], it is no longer renewed, and others take it for dead after a while.
#[derive(Debug)]
pub struct Lease {
    shared: Arc<Shared>,
    me: Holder,
    thread: Option<JoinHandle<()>>,
}

impl Lease {
    pub(super) fn hold(folder: &Path, number: u64, content: Vec<u8>, me: &Holder, lasts: Duration) -> Self {
        let shared = Arc::new(Shared {
            folder: folder.to_path_buf(),
            lasts,
            held: Mutex::new(Held {
                number,
                content,
                renewed: Instant::now(),
                lost: false,
                ended: false,
            }),
            wake: Condvar::new(),
        });
        let renewed = Arc::clone(&shared);
        Self {
            shared,
            me: me.clone(),
            thread: Some(thread::spawn(move || renewed.keep_up())),
        }
    }

    /// Its number.
    #[must_use]
    pub fn number(&self) -> u64 {
        self.shared.lock().number
    }

    /// True when another has the job, or may have because the lease could not be renewed for as long as it lasts.
    /// This asks no file: it can be asked often.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        let held = self.shared.lock();
        held.lost || held.renewed.elapsed() >= self.shared.lasts
    }

    /// Makes sure that the job is ours now, and for as long as a lease lasts: takes the next number, which nobody else
    /// can have then. False when it is another's.
    ///
    /// # Errors
    ///
    /// [`FileError`] where nothing can be written.
    pub fn confirm(&self) -> Result<bool, FileError> {
        let mut held = self.shared.lock();
        if held.lost {
            return Ok(false);
        }
        let now = Instant::now();
        match store::create(&self.shared.folder, held.number + 1, &self.me)? {
            Some(content) => {
                held.number += 1;
                held.content = content;
                held.renewed = now;
                Ok(true)
            }
            None => {
                held.lost = true;
                Ok(false)
            }
        }
    }

    /// Gives the job back. Where another has it, there is nothing to give.
    ///
    /// # Errors
    ///
    /// [`FileError`] where it cannot be written; the job is free when the lease has run out.
    pub fn release(mut self) -> Result<(), FileError> {
        self.stop();
        let held = self.shared.lock();
        if held.lost {
            return Ok(());
        }
        let path = store::file(&self.shared.folder, held.number);
        let given_back = Holder {
            released: true,
            ..self.me.clone()
        };
        let failed = FileError::write(&path);
        match store::bytes(&given_back).and_then(|bytes| atomic::write(&path, &bytes)) {
            Ok(()) => Ok(()),
            Err(error) => Err(failed(error)),
        }
    }

    fn stop(&mut self) {
        self.shared.lock().ended = true;
        self.shared.wake.notify_all();
        if let Some(thread) = self.thread.take() {
            // A panic in it was reported by its own thread.
            let _ = thread.join();
        }
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Shared {
    fn lock(&self) -> std::sync::MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Renews the lease until it is given up or lost.
    fn keep_up(&self) {
        let mut held = self.lock();
        // Asked before each wait: the lease may have been given up before this thread began.
        while !(held.ended || held.lost) {
            let waited = self.wake.wait_timeout(held, self.lasts / RENEWALS);
            held = waited.map_or_else(|e| e.into_inner().0, |(held, _)| held);
            if held.ended || held.lost {
                return;
            }
            // The file system may be slow, and whoever asks whether the lease is lost must not wait for it.
            let (number, content) = (held.number, held.content.clone());
            drop(held);
            let now = Instant::now();
            let next = store::file(&self.folder, number + 1);
            let taken = next.exists();
            // A failure is tried again soon, and in the end counts as a loss.
            let renewed = !taken && store::renew(&store::file(&self.folder, number), &content).is_ok();
            held = self.lock();
            if taken && held.number == number {
                held.lost = true;
            } else if renewed && held.number == number {
                held.renewed = now;
            }
        }
    }
}
