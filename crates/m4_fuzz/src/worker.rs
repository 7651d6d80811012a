//! The reader process: a memory limit, one input after another, and a line for each on standard output.
//!
//! ```text
//! at I NAME                input I is read; its bytes lie in FOLDER/READER-current, should the process not come back
//! read I, refused I        how it ended; neither where the reader panicked
//! found I WHY              a panic, something not valid, a long message, much memory, much time; the input lies in FOLDER/READER-I
//! done PEAK I              the most memory that one took, bytes, and which
//! ```

use crate::limit::limit_memory;
use crate::reader::{Outcome, Reader, Stage};
use std::io::{self, Write as _};
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Address space of the process, bytes.
const ADDRESS_SPACE: u64 = 2 << 30;
/// Memory that reading may take, bytes: this, and this many times the file.
const FREE: usize = 64 << 20;
const TIMES: usize = 64;
/// Time that one file may take: a thousand times what is usual, on a machine that does much else.
pub const MAX_TIME: Duration = Duration::from_secs(20);

/// How much memory is taken; the allocator counts for the whole process.
#[derive(Clone, Copy)]
pub struct Meter {
    /// Forgets the peak.
    pub reset: fn(),
    /// The peak since then, bytes.
    pub peak: fn() -> usize,
    /// The allocated memory, bytes.
    pub now: fn() -> usize,
}

/// Where the input that is being read lies.
pub fn current(folder: &Path, reader: &str) -> PathBuf {
    folder.join(format!("{reader}-current"))
}

/// Where input `i`, which failed, is kept.
pub fn saved(folder: &Path, reader: &str, i: usize) -> PathBuf {
    folder.join(format!("{reader}-{i}"))
}

/// Reads all inputs from number `from` on.
///
/// # Errors
///
/// What the system says of the stage and of standard output.
pub fn work(
    reader: &Reader,
    folder: &Path,
    from: usize,
    inputs: impl FnOnce(&Stage<'_>) -> Box<dyn Iterator<Item = (String, Vec<u8>)>>,
    meter: Meter,
) -> io::Result<()> {
    limit_memory(ADDRESS_SPACE)?;
    let said = Arc::new(Mutex::new(String::new()));
    let to = said.clone();
    set_hook(Box::new(move |info| {
        if let Ok(mut said) = to.lock() {
            *said = info.to_string().replace('\n', " ");
        }
    }));
    let stage = reader.stage()?;
    let current = current(folder, reader.name);
    let mut out = io::stdout().lock();
    // the frame of tests may have begun a line
    writeln!(out)?;
    let mut most = (0, 0);
    for (i, (name, bytes)) in inputs(&stage).enumerate().skip(from) {
        writeln!(out, "at {i} {name}")?;
        out.flush()?;
        match std::fs::remove_file(&current) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            _ => std::fs::write(&current, &bytes)?,
        }
        let before = (meter.now)();
        (meter.reset)();
        let start = Instant::now();
        let outcome = catch_unwind(AssertUnwindSafe(|| stage.read(&bytes)));
        let (taken, time) = ((meter.peak)().saturating_sub(before), start.elapsed());
        if taken > most.0 {
            most = (taken, i);
        }
        let fault = match outcome {
            Err(_) => Some(said.lock().map(|s| s.clone()).unwrap_or_default()),
            Ok(outcome) => {
                let outcome = outcome?;
                let how = if matches!(outcome, Outcome::Refused(_)) {
                    "refused"
                } else {
                    "read"
                };
                writeln!(out, "{how} {i}")?;
                Stage::fault(&outcome)
            }
        };
        let much = taken > FREE + TIMES * bytes.len();
        let much = much.then(|| format!("{} MiB of memory for {} bytes", taken >> 20, bytes.len()));
        let slow = (time > MAX_TIME).then(|| format!("{time:.1?}"));
        if let Some(why) = fault.or(much).or(slow) {
            std::fs::write(saved(folder, reader.name, i), &bytes)?;
            let short: String = why.chars().take(300).collect();
            writeln!(out, "found {i} {}", short.replace('\n', " "))?;
            out.flush()?;
        }
    }
    writeln!(out, "done {} {}", most.0, most.1)?;
    out.flush()?;
    match std::fs::remove_file(&current) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(e),
        _ => Ok(()),
    }
}
