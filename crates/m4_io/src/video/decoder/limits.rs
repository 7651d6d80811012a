//! The resource limits of a decoder; those of the operating system (`setrlimit`, `prctl`) on Linux
//! only.

use crate::Fault;
use serde::{Deserialize, Serialize};
use std::io;

const MIB: u64 = 1 << 20;
/// Address space of a decoder besides its images: ffmpeg 5.1 with 6 threads maps 0.5 GiB.
const BASE_BYTES: u64 = 2 << 30;
/// Images that a decoder may hold: 16 for reference, as many in flight in its threads, and some on
/// their way out.
const IMAGES: u64 = 40;
/// Bytes of a pixel: two samples, and half of two more, of 16 bits.
const PIXEL_BYTES: u64 = 4;
/// The most that is granted by itself: half of the memory of a small workstation.
const MOST_BYTES: u64 = 8 << 30;
/// Seconds that any decoder has.
const BASE_S: u64 = 120;
/// Slower than any processor of this decade decodes and converts, pixels per second.
const PIXELS_A_SECOND: u64 = 2_000_000;
/// Slower than any of them takes a file apart, bytes per second.
const BYTES_A_SECOND: u64 = 5_000_000;

/// What a process that decodes a video may take before it is ended with [`Fault::Decoder`]. Memory
/// and seconds are limits of the operating system, on Linux alone; that something must come from it
/// holds on every system.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct DecoderLimits {
    /// Address space, MiB. Default 0: by the size of the images, 2 GiB and 160 bytes per pixel, at
    /// most 8 GiB (2.3 GiB for 1080p, 3.2 GiB for 4K).
    pub memory_mb: u64,
    /// Seconds of one core. Default 0: by the length of the clip, 120 s and 1 s for every 2 million
    /// pixels (10 s of 1080p at 30 frames per second: 431 s) and 5 MB of the file.
    pub cpu_seconds: u64,
    /// Seconds within which something must come from the decoder while it is waited for. Default
    /// 120.
    pub idle_seconds: u64,
}

impl Default for DecoderLimits {
    fn default() -> Self {
        Self {
            memory_mb: 0,
            cpu_seconds: 0,
            idle_seconds: 120,
        }
    }
}

/// What is to be decoded, as far as it is known before.
#[derive(Debug, Clone, Copy, Default)]
pub struct Work {
    /// Of an image; 0 where it is not known.
    pub pixels: u64,
    /// Images.
    pub frames: u64,
    /// Of the file.
    pub bytes: u64,
}

/// Limits of one process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Allowed {
    /// Address space, bytes.
    pub memory_bytes: u64,
    /// Seconds of one core.
    pub cpu_s: u64,
    /// Seconds without output.
    pub idle_s: u64,
}

impl DecoderLimits {
    /// Fails for limits under which nothing can be decoded.
    pub(crate) fn check(&self) -> Result<(), Fault> {
        let bad = |option: &str, value: u64, expected: &str| {
            Err(Fault::option(
                format!("the video option {option} is {value}"),
                expected,
            ))
        };
        // Of which none can overflow below.
        if self.memory_mb != 0 && !(64..=1 << 24).contains(&self.memory_mb) {
            let expected =
                "64 to 16777216 MiB were expected, or 0 for a limit by the size of the images";
            return bad("decoder.memory_mb", self.memory_mb, expected);
        }
        if self.cpu_seconds > 1 << 30 {
            let expected =
                "at most 1073741824 s were expected, or 0 for a limit by the length of the clip";
            return bad("decoder.cpu_seconds", self.cpu_seconds, expected);
        }
        if !(1..=1 << 30).contains(&self.idle_seconds) {
            return bad(
                "decoder.idle_seconds",
                self.idle_seconds,
                "1 to 1073741824 s were expected",
            );
        }
        Ok(())
    }

    /// The limits of a process that does `work`.
    pub(crate) fn allowed(&self, work: Work) -> Allowed {
        let images = work.pixels.saturating_mul(IMAGES * PIXEL_BYTES);
        let memory_bytes = match self.memory_mb {
            0 => BASE_BYTES.saturating_add(images).min(MOST_BYTES),
            mb => mb.saturating_mul(MIB),
        };
        let cpu_s = match self.cpu_seconds {
            0 => {
                let pixels = work.pixels.saturating_mul(work.frames);
                BASE_S + pixels / PIXELS_A_SECOND + work.bytes / BYTES_A_SECOND
            }
            s => s,
        };
        Allowed {
            memory_bytes,
            cpu_s,
            idle_s: self.idle_seconds,
        }
    }
}

/// Which process limits itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Confined {
    /// Our own decoder, which opens no file and starts nothing.
    Decoder,
    /// One that becomes another program now.
    Program,
}

/// Bytes that a decoder may write to a file: none has reason to, but wrappers of packages keep
/// small notes.
#[cfg(target_os = "linux")]
const FILE_BYTES: u64 = 1 << 20;
/// Files that another program may have open: many times what ffmpeg has, and one more than where a
/// shell keeps its script.
#[cfg(target_os = "linux")]
const FILES: u64 = 256;
/// Those of our own decoder: its pipes.
#[cfg(target_os = "linux")]
const PIPES: u64 = 3;

#[cfg(target_os = "linux")]
type Limit = (rustix::process::Resource, u64);

/// Of every decoder. The parent process sets them, too, so they are the same there.
#[cfg(target_os = "linux")]
fn limits(allowed: &Allowed) -> [Limit; 4] {
    use rustix::process::Resource;
    // Memory last: what follows may need some.
    [
        (Resource::Core, 0),
        (Resource::Fsize, FILE_BYTES),
        (Resource::Cpu, allowed.cpu_s),
        (Resource::As, allowed.memory_bytes),
    ]
}

#[cfg(target_os = "linux")]
fn set(
    (resource, value): Limit,
    set: impl Fn(rustix::process::Rlimit) -> rustix::io::Result<()>,
) -> io::Result<()> {
    // What this process itself may not have, its children cannot be given.
    let most = rustix::process::getrlimit(resource).maximum;
    let value = Some(most.map_or(value, |most| most.min(value)));
    // Where both are one, the kernel kills; a signal before that could be ignored.
    let limit = rustix::process::Rlimit {
        current: value,
        maximum: value,
    };
    Ok(set(limit)?)
}

/// Sets the limits of a child that was just started. One that does not limit itself (`bare`) is
/// given one of open files too.
#[cfg(target_os = "linux")]
pub fn limit_child(child: &std::process::Child, allowed: &Allowed, bare: bool) -> io::Result<()> {
    use rustix::process::{Pid, Resource, prlimit};
    let pid = Pid::from_child(child);
    let files = bare.then_some((Resource::Nofile, FILES));
    for limit in limits(allowed).into_iter().chain(files) {
        set(limit, |value| match prlimit(Some(pid), limit.0, value) {
            // It has ended already, which will be seen.
            Ok(_) | Err(rustix::io::Errno::SRCH) => Ok(()),
            Err(e) => Err(e),
        })?;
    }
    Ok(())
}

/// Sets the limits of this process, and that neither it nor what it becomes can gain privileges
/// (`no_new_privs`).
#[cfg(target_os = "linux")]
pub fn limit_self(allowed: &Allowed, confined: Confined) -> io::Result<()> {
    use rustix::process::{Resource, setrlimit};
    rustix::thread::set_no_new_privs(true)?;
    let own: &[Limit] = match confined {
        Confined::Decoder => &[(Resource::Nproc, 0), (Resource::Nofile, PIPES)],
        Confined::Program => &[(Resource::Nofile, FILES)],
    };
    for limit in own.iter().copied().chain(limits(allowed)) {
        set(limit, |value| setrlimit(limit.0, value))?;
    }
    Ok(())
}

/// No limits: see the module.
#[cfg(not(target_os = "linux"))]
pub fn limit_child(_: &std::process::Child, _: &Allowed, _: bool) -> io::Result<()> {
    Ok(())
}

/// No limits: see the module.
#[cfg(not(target_os = "linux"))]
pub fn limit_self(_: &Allowed, _: Confined) -> io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{DecoderLimits, Work};

    #[test]
    fn limits_grow_with_the_clip_and_a_number_given_is_kept() {
        let hd = Work {
            pixels: 1920 * 1080,
            frames: 300,
            bytes: 0,
        };
        let allowed = DecoderLimits::default().allowed(hd);
        assert_eq!(
            (allowed.memory_bytes >> 20, allowed.cpu_s, allowed.idle_s),
            (2364, 431, 120)
        );
        let absurd = Work {
            pixels: u64::MAX,
            frames: u64::MAX,
            bytes: u64::MAX,
        };
        assert_eq!(
            DecoderLimits::default().allowed(absurd).memory_bytes,
            8 << 30
        );
        let limits = DecoderLimits {
            memory_mb: 100,
            cpu_seconds: 3,
            idle_seconds: 2,
        };
        let allowed = limits.allowed(absurd);
        assert_eq!(
            (allowed.memory_bytes >> 20, allowed.cpu_s, allowed.idle_s),
            (100, 3, 2)
        );
    }

    #[test]
    fn invalid_limits_are_refused() {
        let with = |memory_mb, cpu_seconds, idle_seconds| DecoderLimits {
            memory_mb,
            cpu_seconds,
            idle_seconds,
        };
        assert!(DecoderLimits::default().check().is_ok());
        for (limits, name) in [
            (with(1, 0, 1), "memory_mb"),
            (with(u64::MAX, 0, 1), "memory_mb"),
            (with(0, u64::MAX, 1), "cpu_seconds"),
            (with(0, 0, 0), "idle_seconds"),
        ] {
            let text = limits.check().unwrap_err().to_string();
            assert!(text.contains(name), "{text}");
        }
    }
}
