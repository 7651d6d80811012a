//! The ways in which a decoder can fail, and a bounded part of what it writes to standard error.

use super::Allowed;
use std::io::{BufRead, BufReader, Read};
use std::process::ExitStatus;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};

/// How a process that decodes a video failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DecoderEnd {
    /// It asked for more memory than it may have.
    #[error("it needed more memory than the {limit_mb} MiB that it may have")]
    Memory {
        /// Address space that it may have, MiB.
        limit_mb: u64,
    },
    /// It computed for longer than it may.
    #[error("it computed for longer than the {limit_s} s that it may have")]
    Cpu {
        /// Seconds of one core that it may have.
        limit_s: u64,
    },
    /// Nothing came from it.
    #[error("nothing came from it for {seconds} s")]
    Idle {
        /// Seconds that were waited.
        seconds: u64,
    },
    /// A signal ended it: a crash, or a `kill`.
    #[error("it was ended by signal {signal}{}", signal_name(*signal).map(|name| format!(" ({name})")).unwrap_or_default())]
    Signal {
        /// Its number.
        signal: i32,
    },
    /// It wrote messages without end.
    #[error("it wrote more than {read_mb} MiB of messages")]
    Messages {
        /// MiB that were read.
        read_mb: u64,
    },
    /// It ended early, or answered what no decoder answers.
    #[error("{what}")]
    Answer {
        /// What is known about it.
        what: String,
    },
}

impl DecoderEnd {
    /// What a user can do.
    #[must_use]
    pub fn advice(&self) -> &'static str {
        match self {
            Self::Memory { .. } => "if you trust this clip, raise video.decoder.memory_mb, or make it smaller",
            Self::Cpu { .. } => "if you trust this clip, raise video.decoder.cpu_seconds, or cut a shorter part",
            Self::Idle { .. } => {
                "the clip may be damaged: copy it again; on a slow disk, raise video.decoder.idle_seconds"
            }
            Self::Signal { signal: 9 } => {
                "the system kills programs when memory runs out; else the clip is damaged: copy or export it again"
            }
            // Many decoders crash where memory is refused: SIGABRT, SIGBUS, SIGSEGV.
            Self::Signal { signal: 6 | 7 | 11 } => {
                "the clip is damaged, made to break decoders, or needs more memory: copy or export it again; if you trust \
                 this clip, raise video.decoder.memory_mb"
            }
            Self::Signal { .. } | Self::Messages { .. } | Self::Answer { .. } => {
                "if it fails on another machine, too, the clip is damaged, or made to break decoders: copy or export it again"
            }
        }
    }

    /// What a status and the last words of a process that failed mean.
    pub(super) fn of(status: ExitStatus, cpu_s: Option<f64>, allowed: &Allowed, words: &[String]) -> Self {
        if words.iter().any(|line| is_of_memory(line)) {
            return Self::Memory { limit_mb: allowed.memory_bytes >> 20 };
        }
        let Some(signal) = signal_of(status) else {
            let message = words.last().map_or("no reason given", String::as_str);
            return Self::Answer { what: format!("it ended early ({status}): {message}") };
        };
        // The kernel looks at the clock every few milliseconds.
        let used_up = cpu_s.is_some_and(|s| s + 0.5 > allowed.cpu_s as f64);
        match signal {
            24 => Self::Cpu { limit_s: allowed.cpu_s },
            9 if used_up => Self::Cpu { limit_s: allowed.cpu_s },
            _ => Self::Signal { signal },
        }
    }
}

/// True for what ffmpeg, the C library, Rust, C++, GNU tools and the loader of libraries say when memory runs out.
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

/// True for the words with which ffmpeg and ffprobe say that the bytes of a clip are bad: not that they could not be read.
pub fn is_of_data(line: &str) -> bool {
    // A list of other files is refused as an invalid argument, after words about the whitelist.
    ["invalid data found", "end of file", "on whitelist"].iter().any(|words| line.to_ascii_lowercase().contains(words))
}

#[cfg(unix)]
fn signal_of(status: ExitStatus) -> Option<i32> {
    std::os::unix::process::ExitStatusExt::signal(&status)
}

#[cfg(not(unix))]
fn signal_of(_: ExitStatus) -> Option<i32> {
    None
}

/// Signals that end decoders and have one number on all systems.
fn signal_name(signal: i32) -> Option<&'static str> {
    match signal {
        2 => Some("SIGINT, interrupted"),
        4 => Some("SIGILL, an instruction that does not exist"),
        6 => Some("SIGABRT, it gave up"),
        8 => Some("SIGFPE, a division by zero"),
        9 => Some("SIGKILL, killed"),
        11 => Some("SIGSEGV, a crash"),
        13 => Some("SIGPIPE, its output was closed"),
        15 => Some("SIGTERM, asked to end"),
        _ => None,
    }
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
    kept: Mutex<Vec<String>>,
    too_many: AtomicBool,
}

impl Messages {
    /// Starts to read.
    pub fn read(stderr: impl Read + Send + 'static, limit_bytes: u64, on_line: OnLine) -> Self {
        let shared = Arc::new(Shared::default());
        let (sender, end) = channel();
        let for_thread = Arc::clone(&shared);
        std::thread::spawn(move || drain(stderr, limit_bytes, on_line, &for_thread, sender));
        Self { shared, end, limit_bytes }
    }

    /// MiB that were read, when there were too many.
    pub fn too_many_mb(&self) -> Option<u64> {
        self.shared.too_many.load(Ordering::Relaxed).then_some(self.limit_bytes >> 20)
    }

    /// Closed when all was read.
    pub fn end(&self) -> &Receiver<()> {
        &self.end
    }

    /// The lines that were kept.
    pub fn kept(&self) -> Vec<String> {
        let kept = self.shared.kept.lock();
        kept.unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Dropping `_end` closes the channel on which the end is waited for.
fn drain(stderr: impl Read, limit_bytes: u64, mut on_line: OnLine, shared: &Shared, _end: Sender<()>) {
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
                keep(&mut shared.kept.lock().unwrap_or_else(PoisonError::into_inner), text);
            }
        }
        starts = ends;
    }
    if stderr.get_ref().limit() == 0 {
        shared.too_many.store(true, Ordering::Relaxed);
    }
}

fn keep(kept: &mut Vec<String>, line: &str) {
    if kept.len() == KEPT_LINES {
        kept.remove(KEPT_LINES / 2);
    }
    kept.push(line.to_owned());
}

#[cfg(test)]
mod tests {
    use super::Messages;
    use std::io::{Cursor, Read};
    use std::time::Duration;

    fn all(input: impl Read + Send + 'static, limit: u64) -> (Vec<String>, Option<u64>) {
        let messages = Messages::read(input, limit, Box::new(|_| true));
        assert!(messages.end().recv_timeout(Duration::from_secs(60)).is_err());
        (messages.kept(), messages.too_many_mb())
    }

    #[test]
    fn the_first_and_the_last_lines_are_kept() {
        let text: String = (0..100).map(|i| format!("line {i}\n")).collect();
        let (kept, many) = all(Cursor::new(text), 1 << 20);
        assert_eq!((kept.len(), many), (16, None));
        assert_eq!((kept[7].as_str(), kept[8].as_str(), kept[15].as_str()), ("line 7", "line 92", "line 99"));
    }

    #[test]
    fn messages_without_end_take_no_memory() {
        let (kept, many) = all(std::io::repeat(b'x'), 3 << 20);
        assert_eq!((kept.len(), kept[0].len(), many), (1, 8 << 10, Some(3)));
        let (kept, many) = all(std::io::repeat(b'\n'), 1 << 20);
        assert_eq!((kept.len(), many), (0, Some(1)));
    }
}
