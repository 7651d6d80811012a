//! What the status and the words of a decoder that failed mean, and a bounded part of what it
//! writes to standard error.

use super::Allowed;
use crate::DecoderEnd;
use std::io::{BufRead, BufReader, Read};
use std::process::ExitStatus;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};

/// What a status and the last words of a process that failed mean.
pub(super) fn how_it_ended(
    status: ExitStatus,
    cpu_s: Option<f64>,
    allowed: &Allowed,
    words: &[String],
) -> DecoderEnd {
    if words.iter().any(|line| is_of_memory(line)) {
        return DecoderEnd::Memory {
            limit_mb: allowed.memory_bytes >> 20,
        };
    }
    let Some(signal) = signal_of(status) else {
        let message = words.last().map_or("no reason given", String::as_str);
        return DecoderEnd::Answer {
            what: format!("it ended early ({status}): {message}"),
        };
    };
    // The kernel looks at the clock every few milliseconds.
    let used_up = cpu_s.is_some_and(|s| s + 0.5 > allowed.cpu_s as f64);
    match signal {
        24 => DecoderEnd::Cpu {
            limit_s: allowed.cpu_s,
        },
        9 if used_up => DecoderEnd::Cpu {
            limit_s: allowed.cpu_s,
        },
        _ => DecoderEnd::Signal { signal },
    }
}

/// True for what ffmpeg, the C library, Rust, C++, GNU tools and the loader of libraries say when
/// memory runs out.
pub fn is_of_memory(line: &str) -> bool {
    let line = line.to_ascii_lowercase();
    [
        "cannot allocate memory",
        "cannot map zero-fill pages",
        "memory allocation of",
        "bad_alloc",
        "memory exhausted",
        "out of memory",
        "failed to map segment",
    ]
    .iter()
    .any(|words| line.contains(words))
}

/// True for the words with which ffmpeg and ffprobe say that the bytes of a clip are bad: not that
/// they could not be read.
pub fn is_of_data(line: &str) -> bool {
    // A list of other files is refused as an invalid argument, after words about the whitelist.
    ["invalid data found", "end of file", "on whitelist"]
        .iter()
        .any(|words| line.to_ascii_lowercase().contains(words))
}

#[cfg(unix)]
fn signal_of(status: ExitStatus) -> Option<i32> {
    std::os::unix::process::ExitStatusExt::signal(&status)
}

#[cfg(not(unix))]
fn signal_of(_: ExitStatus) -> Option<i32> {
    None
}

/// Longest part of a line that is read, bytes.
const LINE_BYTES: u64 = 8 << 10;
/// Lines that are kept: the first half and the last half.
const KEPT_LINES: usize = 16;

/// What is done with a line: true for those worth keeping.
pub type OnLine = Box<dyn FnMut(&str) -> bool + Send>;

/// Standard error of a child, read by a thread.
pub struct Messages {
    shared: Arc<Shared>,
    end: Receiver<()>,
    /// Bytes that are read at most.
    limit_bytes: u64,
}

#[derive(Default)]
struct Shared {
    lines: Mutex<Vec<String>>,
    too_many: AtomicBool,
}

impl Messages {
    /// Starts to read.
    pub fn read(stderr: impl Read + Send + 'static, limit_bytes: u64, on_line: OnLine) -> Self {
        let shared = Arc::new(Shared::default());
        let (sender, end) = channel();
        let for_thread = Arc::clone(&shared);
        std::thread::spawn(move || drain(stderr, limit_bytes, on_line, &for_thread, sender));
        Self {
            shared,
            end,
            limit_bytes,
        }
    }

    /// MiB that were read, when there were too many.
    pub fn too_many_mb(&self) -> Option<u64> {
        self.shared
            .too_many
            .load(Ordering::Relaxed)
            .then_some(self.limit_bytes >> 20)
    }

    /// Closed when all was read.
    pub fn end(&self) -> &Receiver<()> {
        &self.end
    }

    /// The first and the last lines.
    pub fn lines(&self) -> Vec<String> {
        let lines = self.shared.lines.lock();
        lines.unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Dropping `_end` closes the channel on which the end is waited for.
fn drain(
    stderr: impl Read,
    limit_bytes: u64,
    mut on_line: OnLine,
    shared: &Shared,
    _end: Sender<()>,
) {
    let mut stderr = BufReader::new(stderr.take(limit_bytes));
    let (mut line, mut starts) = (Vec::new(), true);
    loop {
        line.clear();
        match (&mut stderr).take(LINE_BYTES).read_until(b'\n', &mut line) {
            // A pipe that breaks is a child that ended, which its exit status reports.
            Ok(0) | Err(_) => break,
            Ok(_) => {}
        }
        let ends = line.last() == Some(&b'\n');
        // The rest of a line that is too long is no line of its own.
        if starts {
            let text = String::from_utf8_lossy(&line);
            let text = text.trim_end();
            if !text.is_empty() && on_line(text) {
                keep(
                    &mut shared.lines.lock().unwrap_or_else(PoisonError::into_inner),
                    text,
                );
            }
        }
        starts = ends;
    }
    if stderr.get_ref().limit() == 0 {
        shared.too_many.store(true, Ordering::Relaxed);
    }
}

fn keep(lines: &mut Vec<String>, line: &str) {
    if lines.len() == KEPT_LINES {
        lines.remove(KEPT_LINES / 2);
    }
    lines.push(line.to_owned());
}

#[cfg(test)]
mod tests {
    use super::Messages;
    use std::io::{Cursor, Read};
    use std::time::Duration;

    fn all(input: impl Read + Send + 'static, limit: u64) -> (Vec<String>, Option<u64>) {
        let messages = Messages::read(input, limit, Box::new(|_| true));
        assert!(
            messages
                .end()
                .recv_timeout(Duration::from_secs(60))
                .is_err()
        );
        (messages.lines(), messages.too_many_mb())
    }

    #[test]
    fn the_first_and_the_last_lines_are_kept() {
        let text: String = (0..100).map(|i| format!("line {i}\n")).collect();
        let (lines, many) = all(Cursor::new(text), 1 << 20);
        assert_eq!((lines.len(), many), (16, None));
        assert_eq!(
            (lines[7].as_str(), lines[8].as_str(), lines[15].as_str()),
            ("line 7", "line 92", "line 99")
        );
    }

    #[test]
    fn messages_without_end_take_no_memory() {
        let (lines, many) = all(std::io::repeat(b'x'), 3 << 20);
        assert_eq!((lines.len(), lines[0].len(), many), (1, 8 << 10, Some(3)));
        let (lines, many) = all(std::io::repeat(b'\n'), 1 << 20);
        assert_eq!((lines.len(), many), (0, Some(1)));
    }
}
