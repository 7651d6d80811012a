//! Decoders as child processes: their limits, their supervision, and their end.
//!
//! Decoders are large programs in C that are given bytes of strangers. They run in processes of
//! their own, so that a crash, an endless loop or a claim of all memory is an error of the clip.
//!
//! ```text
//! this module  our own program, started once more: the decoder of H.264, or what limits itself and becomes another program
//! child        watching a decoder
//! end          what it wrote to standard error, and how it ended
//! limits       how much a clip of some size may take, and the limits of the kernel
//! ```

mod child;
mod end;
mod limits;

pub use child::{Child, Start};
pub use end::{is_of_data, is_of_memory};
pub use limits::{Allowed, Confined, DecoderLimits, Work, limit_self};

use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// What our own program says of a program that it could not become.
pub const NOT_STARTED: &str = "not started: ";

/// The command for `program`, by way of `launcher` where the system keeps limits; its arguments are
/// to follow.
pub fn command(launcher: Option<&DecoderProgram>, program: &Path, allowed: &Allowed) -> Command {
    match launcher.filter(|_| cfg!(target_os = "linux")) {
        Some(launcher) => {
            let mut command = launcher.command(allowed);
            command.arg(program);
            command
        }
        None => Command::new(program),
    }
}

/// Limits this process and becomes `program`; returns only where that failed.
pub fn become_program(program: &OsString, arguments: &[OsString], allowed: &Allowed) -> io::Error {
    let mut command = Command::new(program);
    command.args(arguments);
    let e = limit_self(allowed, Confined::Program)
        .err()
        .unwrap_or_else(|| replace(&mut command));
    io::Error::new(e.kind(), format!("[fatal] {NOT_STARTED}{e}"))
}

#[cfg(unix)]
fn replace(command: &mut Command) -> io::Error {
    std::os::unix::process::CommandExt::exec(command)
}

#[cfg(not(unix))]
fn replace(_: &mut Command) -> io::Error {
    io::ErrorKind::Unsupported.into()
}

/// Variables that a decoder keeps: where programs are and, where systems need them, shared
/// libraries and Windows' folder.
const KEPT: &[&str] = if cfg!(windows) {
    &["PATH", "SystemRoot"]
} else if cfg!(target_os = "linux") {
    &["PATH", "LD_LIBRARY_PATH"]
} else {
    &["PATH"]
};

/// Takes everything but [`KEPT`] from a command.
pub(super) fn clear_environment(command: &mut Command) {
    command.env_clear();
    for name in KEPT {
        if let Some(value) = std::env::var_os(name) {
            command.env(name, value);
        }
    }
    // Arenas of the C library take address space for every thread.
    command.env("MALLOC_ARENA_MAX", "4");
}

static REGISTERED: OnceLock<DecoderProgram> = OnceLock::new();

/// A program that calls [`super::serve_decoder`], and what it must be told to do so. The limits are
/// two more arguments, behind these; on Linux a command line may follow, which the program becomes
/// under these limits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DecoderProgram {
    /// Its file, or a name on the PATH.
    pub program: PathBuf,
    /// Its first arguments.
    pub arguments: Vec<OsString>,
}

impl DecoderProgram {
    /// A program, and the argument that makes it a decoder.
    pub fn new(program: impl Into<PathBuf>, argument: impl Into<OsString>) -> Self {
        Self {
            program: program.into(),
            arguments: vec![argument.into()],
        }
    }

    /// The command that starts it under these limits.
    pub(crate) fn command(&self, allowed: &Allowed) -> Command {
        let mut command = Command::new(&self.program);
        command
            .args(&self.arguments)
            .arg(allowed.memory_bytes.to_string())
            .arg(allowed.cpu_s.to_string());
        command
    }
}

/// From now on [`super::read()`] has H.264 decoded by `program`, in a process of its own, and on
/// Linux ffmpeg started by it, so that it is limited before it reads a byte. A program calls this
/// once, at its start, most often with [`std::env::current_exe`]; without it OpenH264 decodes
/// inside of the calling process. Returns the program if another one was registered before.
pub fn set_decoder_program(program: DecoderProgram) -> Result<(), DecoderProgram> {
    REGISTERED.set(program)
}

/// The program that was registered.
#[must_use]
pub fn decoder_program() -> Option<&'static DecoderProgram> {
    REGISTERED.get()
}
