//! The ways in which a decoder can fail.

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
            Self::Memory { .. } => {
                "if you trust this clip, raise video.decoder.memory_mb, or make it smaller"
            }
            Self::Cpu { .. } => {
                "if you trust this clip, raise video.decoder.cpu_seconds, or cut a shorter part"
            }
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
