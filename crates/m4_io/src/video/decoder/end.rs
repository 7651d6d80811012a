//! The ways in which a decoder can fail.

use super::Allowed;
use std::fmt;
use std::process::ExitStatus;

/// How a process that decodes a video failed.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum DecoderEnd {
    /// It asked for more memory than it may have.
    Memory {
        /// Address space that it may have, MiB.
        limit_mb: u64,
    },
    /// It computed for longer than it may.
    Cpu {
        /// Seconds of one core that it may have.
        limit_s: u64,
    },
    /// Nothing came from it.
    Idle {
        /// Seconds that were waited.
        seconds: u64,
    },
    /// A signal ended it: a crash, or a `kill`.
    Signal {
        /// Its number.
        signal: i32,
    },
    /// It wrote messages without end.
    Messages {
        /// MiB that were read.
        read_mb: u64,
    },
    /// It ended early, or answered what no decoder answers.
    Answer {
        /// What is known about it.
        what: String,
    },
}

impl fmt::Display for DecoderEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Memory { limit_mb } => write!(f, "it needed more memory than the {limit_mb} MiB that it may have"),
            Self::Cpu { limit_s } => write!(f, "it computed for longer than the {limit_s} s that it may have"),
            Self::Idle { seconds } => write!(f, "nothing came from it for {seconds} s"),
            Self::Signal { signal } => match signal_name(*signal) {
                Some(name) => write!(f, "it was ended by signal {signal} ({name})"),
                None => write!(f, "it was ended by signal {signal}"),
            },
            Self::Messages { read_mb } => write!(f, "it wrote more than {read_mb} MiB of messages"),
            Self::Answer { what } => f.write_str(what),
        }
    }
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

/// True for the words with which programs say that memory ran out: of ffmpeg and the C library, of Rust, of C++,
/// of the tools of GNU, and of the loader of shared libraries.
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
