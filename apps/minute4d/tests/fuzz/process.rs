//! The process that reads, with limits of memory and time, and the one that starts it: readers may
//! panic, abort or hang. The process that reads prints a line for each input on standard output:
//!
//! ```text
//! at NAME          the input is read; its bytes lie in FOLDER/READER-current, should the process not come back
//! read, refused    how it ended; neither where the reader panicked
//! found WHY        a panic, something not valid, a long message, much memory, much time; the input is kept
//! done             all inputs are through
//! ```

use crate::numbers::is_number;
use crate::reader::{Outcome, Reader, Stage};
use std::io::{self, Write as _};
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio, abort};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use std::{fs, thread};

/// Address space of the process, bytes.
const ADDRESS_SPACE: u64 = 2 << 30;
/// Memory that reading may take, bytes: this, and this many times the file.
const FREE: usize = 64 << 20;
const TIMES: usize = 64;
/// Time that one file may take: a thousand times what is usual, on a machine that does much else.
/// After twice as long the process aborts.
const MAX_TIME: Duration = Duration::from_secs(20);

/// How much memory is taken; the allocator counts for the whole process.
#[derive(Clone, Copy)]
pub struct Meter {
    pub reset: fn(),
    /// The peak since then, bytes.
    pub peak: fn() -> usize,
    pub now: fn() -> usize,
}

/// Where the input that is being read lies.
fn current(folder: &Path, reader: &str) -> PathBuf {
    folder.join(format!("{reader}-current"))
}

/// What the process that reads keeps in mind for its other threads.
struct Watched {
    /// When the current input was begun.
    began: Mutex<Instant>,
    /// The message of the last panic.
    said: Mutex<String>,
}

/// Reads all inputs.
pub fn work(
    reader: &Reader,
    folder: &Path,
    inputs: impl FnOnce(&Stage<'_>) -> Box<dyn Iterator<Item = (String, Vec<u8>)>>,
    meter: Meter,
) -> io::Result<()> {
    limit_memory(ADDRESS_SPACE)?;
    let watched = Arc::new(Watched {
        began: Mutex::new(Instant::now()),
        said: Mutex::default(),
    });
    let to = watched.clone();
    set_hook(Box::new(move |info| {
        *to.said.lock().unwrap() = info.to_string().replace('\n', " ")
    }));
    let stage = reader.stage()?;
    let watch = watched.clone();
    thread::spawn(move || {
        while watch.began.lock().unwrap().elapsed() < 2 * MAX_TIME {
            thread::sleep(Duration::from_secs(1));
        }
        abort();
    });
    let current = current(folder, reader.name);
    let mut out = io::stdout().lock();
    // the frame of tests may have begun a line
    writeln!(out)?;
    for (name, bytes) in inputs(&stage) {
        writeln!(out, "at {name}")?;
        out.flush()?;
        fs::write(&current, &bytes)?;
        let before = (meter.now)();
        (meter.reset)();
        let start = Instant::now();
        *watched.began.lock().unwrap() = start;
        let outcome = catch_unwind(AssertUnwindSafe(|| stage.read(&bytes)));
        let (memory_bytes, time) = ((meter.peak)().saturating_sub(before), start.elapsed());
        let fault = match outcome {
            Err(_) => Some(watched.said.lock().unwrap().clone()),
            Ok(outcome) => {
                let outcome = outcome?;
                writeln!(
                    out,
                    "{}",
                    if matches!(outcome, Outcome::Refused(_)) {
                        "refused"
                    } else {
                        "read"
                    }
                )?;
                stage.fault(&outcome, is_number(&name))
            }
        };
        let much = memory_bytes > FREE + TIMES * bytes.len();
        let much = much.then(|| {
            format!(
                "{} MiB of memory for {} bytes",
                memory_bytes >> 20,
                bytes.len()
            )
        });
        let slow = (time > MAX_TIME).then(|| format!("{time:.1?}"));
        if let Some(why) = fault.or(much).or(slow) {
            let short: String = why.chars().take(300).collect();
            writeln!(out, "found {}", short.replace('\n', " "))?;
            fs::rename(
                &current,
                folder.join(format!("{}-{}", reader.name, file_name(&name))),
            )?;
        }
    }
    writeln!(out, "done")?;
    out.flush()?;
    let _ = fs::remove_file(&current);
    Ok(())
}

/// The name of an input as that of a file.
fn file_name(input: &str) -> String {
    input.replace(|c: char| !c.is_ascii_alphanumeric(), "-")
}

/// Limits the address space of this process, bytes: what asks for more is aborted, whatever the
/// machine has.
fn limit_memory(bytes: u64) -> io::Result<()> {
    #[cfg(unix)]
    {
        use rustix::process::{Resource, Rlimit, setrlimit};
        let limit = Rlimit {
            current: Some(bytes),
            maximum: Some(bytes),
        };
        setrlimit(Resource::As, limit).map_err(io::Error::from)
    }
    #[cfg(not(unix))]
    Err(io::Error::other(format!(
        "{bytes} bytes cannot be made the limit on this system"
    )))
}

#[derive(Debug, Clone)]
pub struct Finding {
    pub input: String,
    pub why: String,
    pub saved: PathBuf,
}

#[derive(Debug, Clone, Default)]
pub struct Report {
    pub read: usize,
    pub refused: usize,
    pub executions: usize,
    pub findings: Vec<Finding>,
}

/// Runs `command`, a process that calls [`work`] for `reader`. An input that it does not come back
/// from is its last.
pub fn watch(reader: &str, folder: &Path, mut command: Command) -> io::Result<Report> {
    // no other program decodes what ours does not
    command
        .env("PATH", "/nonexistent")
        .env("RAYON_NUM_THREADS", "1")
        .stderr(Stdio::null());
    let output = command.output()?;
    let mut report = Report::default();
    let (mut input, mut done) = ("the start".to_owned(), false);
    let finding = |input: &str, why: String| {
        let saved = folder.join(format!("{reader}-{}", file_name(input)));
        Finding {
            input: input.to_owned(),
            why,
            saved,
        }
    };
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        match line.split_once(' ').unwrap_or((line, "")) {
            ("at", name) => {
                input = name.to_owned();
                report.executions += 1;
            }
            ("found", why) => report.findings.push(finding(&input, why.to_owned())),
            ("read", "") => report.read += 1,
            ("refused", "") => report.refused += 1,
            ("done", "") => done = true,
            // what the frame of tests says
            _ => {}
        }
    }
    if !done {
        let last = finding(
            &input,
            format!("it was aborted, or did not come back ({})", output.status),
        );
        // it may have died before it wrote one
        let _ = fs::rename(current(folder, reader), &last.saved);
        report.findings.push(last);
    }
    Ok(report)
}
