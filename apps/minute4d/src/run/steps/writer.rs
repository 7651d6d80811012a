//! A thread that writes files while others compute.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread;

/// The end of the name of a file that is being written.
pub(super) const PART: &str = ".part";
/// Files that wait to be written; who has more waits, so that memory stays small.
const WAITING: usize = 4;

/// Writes one file into a folder.
type Task = Box<dyn FnOnce(&Path) -> io::Result<()> + Send>;

/// Writes files in the order in which they are pushed. The thread ends with this and finishes its
/// work before.
pub(super) struct Writer {
    folder: PathBuf,
    state: Arc<State>,
    tasks: Mutex<Option<SyncSender<Task>>>,
}

#[derive(Default)]
struct State {
    progress: Mutex<Progress>,
    idle: Condvar,
}

#[derive(Default)]
struct Progress {
    pending: usize,
    error: Option<io::Error>,
}

impl Writer {
    pub fn new(folder: PathBuf) -> Self {
        Self {
            folder,
            state: Arc::default(),
            tasks: Mutex::new(None),
        }
    }

    /// Has `write` called with the folder. Returns the error of an earlier file that was not
    /// returned yet.
    pub fn push(
        &self,
        write: impl FnOnce(&Path) -> io::Result<()> + Send + 'static,
    ) -> Option<io::Error> {
        let error = {
            let mut progress = self.state.lock();
            progress.pending += 1;
            progress.error.take()
        };
        let tasks = self
            .tasks
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .get_or_insert_with(|| self.start())
            .clone();
        // where no thread was started
        if let Err(refused) = tasks.send(Box::new(write)) {
            self.state.done(refused.0(&self.folder));
        }
        error
    }

    /// Waits until all files are written. Returns the error of one that was not returned yet.
    pub fn settle(&self) -> Option<io::Error> {
        let mut progress = self.state.lock();
        while progress.pending > 0 {
            progress = self
                .state
                .idle
                .wait(progress)
                .unwrap_or_else(PoisonError::into_inner);
        }
        progress.error.take()
    }

    fn start(&self) -> SyncSender<Task> {
        let (sender, tasks) = sync_channel::<Task>(WAITING);
        let (folder, state) = (self.folder.clone(), self.state.clone());
        let work = move || {
            tasks
                .into_iter()
                .for_each(|write| state.done(write(&folder)))
        };
        // without a thread the channel is closed
        let _ = thread::Builder::new().name("steps".to_owned()).spawn(work);
        sender
    }
}

impl State {
    fn lock(&self) -> std::sync::MutexGuard<'_, Progress> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn done(&self, written: io::Result<()>) {
        let mut progress = self.lock();
        progress.pending -= 1;
        if let Err(error) = written {
            progress.error.get_or_insert(error);
        }
        self.idle.notify_all();
    }
}

/// Writes a file whole or not at all, without waiting for the disk.
pub(super) fn write(folder: &Path, name: &str, parts: &[&[u8]]) -> io::Result<()> {
    let temporary = folder.join(format!("{name}{PART}"));
    let written = (|| {
        let mut file = fs::File::create(&temporary)?;
        for part in parts {
            file.write_all(part)?;
        }
        fs::rename(&temporary, folder.join(name))
    })();
    if written.is_err() {
        let _ = fs::remove_file(&temporary);
    }
    written
}

#[cfg(test)]
mod tests {
    use super::{Writer, write};
    use std::fs;

    #[test]
    fn all_files_are_written_and_one_error_is_told_once() {
        let dir = tempfile::tempdir().unwrap();
        let writer = Writer::new(dir.path().to_path_buf());
        for i in 0..20u8 {
            assert!(
                writer
                    .push(move |folder| write(folder, &i.to_string(), &[&[i; 1000], &[1]]))
                    .is_none()
            );
        }
        assert!(writer.settle().is_none());
        for i in 0..20u8 {
            let bytes = fs::read(dir.path().join(i.to_string())).unwrap();
            assert_eq!((bytes.len(), bytes[0], bytes[1000]), (1001, i, 1));
        }
        writer.push(|folder| write(&folder.join("nowhere"), "a", &[]));
        writer.push(|folder| write(&folder.join("nowhere"), "b", &[]));
        assert_eq!(
            writer.settle().unwrap().kind(),
            std::io::ErrorKind::NotFound
        );
        assert!(writer.settle().is_none());
    }
}
