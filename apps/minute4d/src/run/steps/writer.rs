//! A thread that writes files while others compute.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};

/// The end of the name of a file that is being written.
pub(super) const PART: &str = ".part";
/// Files that wait to be written; who has more waits, so that memory stays small.
const WAITING: usize = 4;

/// Writes one file into a folder.
type Task = Box<dyn FnOnce(&Path) -> io::Result<()> + Send>;

/// Writes files in the order in which they are pushed.
pub(super) struct Writer {
    folder: PathBuf,
    /// From the first file on until all are written.
    thread: Mutex<Option<Thread>>,
}

struct Thread {
    tasks: SyncSender<Task>,
    /// Returns the first error.
    ended: JoinHandle<io::Result<()>>,
}

impl Writer {
    pub fn new(folder: PathBuf) -> Self {
        Self {
            folder,
            thread: Mutex::new(None),
        }
    }

    /// Has `write` called with the folder: by the thread, or now where there can be none.
    pub fn push(
        &self,
        write: impl FnOnce(&Path) -> io::Result<()> + Send + 'static,
    ) -> io::Result<()> {
        let mut thread = self.lock();
        if thread.is_none() {
            *thread = self.start().ok();
        }
        let task: Task = Box::new(write);
        let left = match thread.as_ref() {
            Some(thread) => thread.tasks.send(task).err().map(|refused| refused.0),
            None => Some(task),
        };
        left.map_or(Ok(()), |task| task(&self.folder))
    }

    /// Waits until all files are written. Returns the first error since the last call.
    pub fn settle(&self) -> io::Result<()> {
        let Some(Thread { tasks, ended }) = self.lock().take() else {
            return Ok(());
        };
        drop(tasks);
        ended
            .join()
            .unwrap_or_else(|_| Err(io::Error::other("the thread that writes them ended")))
    }

    fn lock(&self) -> MutexGuard<'_, Option<Thread>> {
        self.thread.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn start(&self) -> io::Result<Thread> {
        let (tasks, received) = sync_channel::<Task>(WAITING);
        let folder = self.folder.clone();
        let work = move || {
            let written = received.into_iter().map(|write| write(&folder));
            written.fold(Ok(()), io::Result::and)
        };
        let ended = thread::Builder::new()
            .name("steps".to_owned())
            .spawn(work)?;
        Ok(Thread { tasks, ended })
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
            writer
                .push(move |folder| write(folder, &i.to_string(), &[&[i; 1000], &[1]]))
                .unwrap();
        }
        writer.settle().unwrap();
        for i in 0..20u8 {
            let bytes = fs::read(dir.path().join(i.to_string())).unwrap();
            assert_eq!((bytes.len(), bytes[0], bytes[1000]), (1001, i, 1));
        }
        for name in ["a", "b"] {
            writer
                .push(move |folder| write(&folder.join("nowhere"), name, &[]))
                .unwrap();
        }
        assert_eq!(
            writer.settle().unwrap_err().kind(),
            std::io::ErrorKind::NotFound
        );
        writer.settle().unwrap();
    }
}
