//! Supervises reader processes, which may panic, abort or hang.

use crate::worker::{MAX_TIME, current, saved};
use std::io::{self, BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::{fs, thread};

/// Findings after which a reader is left alone.
const MAX_FINDINGS: usize = 12;

/// An input that failed.
#[derive(Debug, Clone)]
pub struct Finding {
    /// The reader.
    pub reader: String,
    /// The mutation of the file.
    pub input: String,
    /// The fault that it caused.
    pub why: String,
    /// The file of the input.
    pub saved: PathBuf,
}

/// What came of all inputs of one reader.
#[derive(Debug, Clone, Default)]
pub struct Report {
    /// Inputs that were read.
    pub read: usize,
    /// Inputs that were refused.
    pub refused: usize,
    /// Inputs in all.
    pub executions: usize,
    /// The most memory that one took, bytes.
    pub peak_bytes: usize,
    /// The input.
    pub peak_input: String,
    /// The findings.
    pub findings: Vec<Finding>,
}

/// Runs `command(from)`, a process that calls [`crate::work`] for `reader`, until all inputs are through; after an input that it does
/// not come back from it is started again behind that one.
///
/// # Errors
///
/// What the system says.
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
        let mut names = Vec::new();
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
                    names.push(rest.to_owned());
                    report.executions += 1;
                }
                Some("read") => report.read += 1,
                Some("refused") => report.refused += 1,
                Some("found") => save(&mut report, reader, folder, &at, rest),
                Some("done") => {
                    if let Some(which) = rest.parse::<usize>().ok().filter(|_| number > report.peak_bytes) {
                        report.peak_bytes = number;
                        report.peak_input = names.get(which.wrapping_sub(from)).cloned().unwrap_or_default();
                    }
                    break None;
                }
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
