//! The process that reads, with a limit of memory, and the one that watches it: readers may panic, abort or hang. The process that
//! reads prints a line for each input on standard output:
//!
//! ```text
//! at I NAME                input I is read; its bytes lie in FOLDER/READER-current, should the process not come back
//! read I, refused I        how it ended; neither where the reader panicked
//! found I WHY              a panic, something not valid, a long message, much memory, much time; the input lies in FOLDER/READER-I
//! done                     all inputs are through
//! ```

use crate::reader::{Outcome, Reader, Stage};
use std::io::{self, BufRead as _, BufReader, Write as _};
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use std::{fs, thread};

/// Address space of the process, bytes.
const ADDRESS_SPACE: u64 = 2 << 30;
/// Memory that reading may take, bytes: this, and this many times the file.
const FREE: usize = 64 << 20;
const TIMES: usize = 64;
/// Time that one file may take: a thousand times what is usual, on a machine that does much else.
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

/// Where input `i`, which failed, is kept.
fn saved(folder: &Path, reader: &str, i: usize) -> PathBuf {
    folder.join(format!("{reader}-{i}"))
}

/// Reads all inputs from number `from` on.
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
    for (i, (name, bytes)) in inputs(&stage).enumerate().skip(from) {
        writeln!(out, "at {i} {name}")?;
        out.flush()?;
        match fs::remove_file(&current) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            _ => fs::write(&current, &bytes)?,
        }
        let before = (meter.now)();
        (meter.reset)();
        let start = Instant::now();
        let outcome = catch_unwind(AssertUnwindSafe(|| stage.read(&bytes)));
        let (taken, time) = ((meter.peak)().saturating_sub(before), start.elapsed());
        let fault = match outcome {
            Err(_) => Some(said.lock().map(|s| s.clone()).unwrap_or_default()),
            Ok(outcome) => {
                let outcome = outcome?;
                let how = if matches!(outcome, Outcome::Refused(_)) { "refused" } else { "read" };
                writeln!(out, "{how} {i}")?;
                Stage::fault(&outcome)
            }
        };
        let much = taken > FREE + TIMES * bytes.len();
        let much = much.then(|| format!("{} MiB of memory for {} bytes", taken >> 20, bytes.len()));
        let slow = (time > MAX_TIME).then(|| format!("{time:.1?}"));
        if let Some(why) = fault.or(much).or(slow) {
            fs::write(saved(folder, reader.name, i), &bytes)?;
            let short: String = why.chars().take(300).collect();
            writeln!(out, "found {i} {}", short.replace('\n', " "))?;
            out.flush()?;
        }
    }
    writeln!(out, "done")?;
    out.flush()?;
    match fs::remove_file(&current) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(e),
        _ => Ok(()),
    }
}

/// Limits the address space of this process, bytes: what asks for more is aborted, whatever the machine has.
fn limit_memory(bytes: u64) -> io::Result<()> {
    #[cfg(unix)]
    {
        use rustix::process::{Resource, Rlimit, setrlimit};
        let limit = Rlimit { current: Some(bytes), maximum: Some(bytes) };
        setrlimit(Resource::As, limit).map_err(io::Error::from)
    }
    #[cfg(not(unix))]
    Err(io::Error::other(format!("{bytes} bytes cannot be made the limit on this system")))
}

/// Findings after which a reader is left alone.
const MAX_FINDINGS: usize = 12;

#[derive(Debug, Clone)]
pub struct Finding {
    pub reader: String,
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

/// Runs `command(from)`, a process that calls [`work`] for `reader`, until all inputs are through; after an input that it does
/// not come back from it is started again behind that one.
pub fn watch(reader: &str, folder: &Path, mut command: impl FnMut(usize) -> Command) -> io::Result<Report> {
    let mut report = Report::default();
    let mut from = 0;
    loop {
        // no other program decodes what ours does not
        let mut child = command(from)
            .env("PATH", "/nonexistent")
            .env("RAYON_NUM_THREADS", "1")
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        let lines = lines(&mut child)?;
        let mut at = (from, "the start".to_owned());
        let ended = loop {
            let line = match lines.recv_timeout(2 * MAX_TIME) {
                Ok(line) => line,
                Err(RecvTimeoutError::Timeout) => {
                    child.kill()?;
                    break Some(format!("it does not come back within {:?}", 2 * MAX_TIME));
                }
                Err(RecvTimeoutError::Disconnected) => break Some("it was aborted".to_owned()),
            };
            let mut words = line.splitn(3, ' ');
            let (kind, number, rest) = (words.next(), words.next(), words.next().unwrap_or_default());
            let number: usize = number.and_then(|n| n.parse().ok()).unwrap_or(0);
            match kind {
                Some("at") => {
                    at = (number, rest.to_owned());
                    report.executions += 1;
                }
                Some("read") => report.read += 1,
                Some("refused") => report.refused += 1,
                Some("found") => save(&mut report, reader, folder, &at, rest),
                Some("done") => break None,
                // what the frame of tests says
                _ => {}
            }
        };
        let status = child.wait()?;
        let Some(why) = ended else {
            return Ok(report);
        };
        // it may have died before it wrote one
        if current(folder, reader).is_file() {
            fs::copy(current(folder, reader), saved(folder, reader, at.0))?;
        }
        save(&mut report, reader, folder, &at, &format!("{why} ({status})"));
        if report.findings.len() >= MAX_FINDINGS {
            return Ok(report);
        }
        from = at.0 + 1;
    }
}

fn lines(child: &mut Child) -> io::Result<Receiver<String>> {
    let out = child.stdout.take().ok_or(io::ErrorKind::BrokenPipe)?;
    let (to, from) = channel();
    thread::spawn(move || {
        for line in BufReader::new(out).lines().map_while(Result::ok) {
            if to.send(line).is_err() {
                break;
            }
        }
    });
    Ok(from)
}

fn save(report: &mut Report, reader: &str, folder: &Path, at: &(usize, String), why: &str) {
    if report.findings.len() < MAX_FINDINGS {
        report.findings.push(Finding {
            reader: reader.to_owned(),
            input: at.1.clone(),
            why: why.to_owned(),
            saved: saved(folder, reader, at.0),
        });
    }
}
