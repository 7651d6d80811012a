//! Decoders as child processes: their limits, their supervision, and their end.
//!
//! Decoders are large programs in C that are given bytes of strangers. They run in processes of their
//! own, so that a crash, an endless loop or a claim of all memory is an error of the clip.
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

pub use child::{Child, Halt, Start};
pub use end::{DecoderEnd, is_of_data, is_of_memory};
pub use limits::{Allowed, Confined, DecoderLimits, Work, limit_self};

use std::ffi::OsString;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// What our own program says of a program that it could not become.
pub const NOT_STARTED: &str = "not started: ";

/// The command for `program`, by way of `launcher` where the system keeps limits; its arguments are to follow.
pub fn command(launcher: Option<&DecoderProgram>, program: &Path, allowed: &Allowed) -> io::Result<Command> {
    let Some(launcher) = launcher.filter(|_| cfg!(target_os = "linux")) else {
        return Ok(Command::new(program));
    };
    let mut command = launcher.command(allowed);
    command.arg(find(program)?);
    Ok(command)
}

/// The file of a program: the first of its name on the PATH, where it has no folder.
fn find(program: &Path) -> io::Result<PathBuf> {
    let places: Vec<PathBuf> = if program.components().count() > 1 {
        vec![program.to_path_buf()]
    } else {
        let path = std::env::var_os("PATH").unwrap_or_default();
        std::env::split_paths(&path).map(|folder| folder.join(program)).collect()
    };
    let found = places.into_iter().find(|place| is_program(place));
    // As starting it would have said.
    found.ok_or_else(|| match std::fs::metadata(program) {
        Err(e) => e,
        Ok(_) => io::Error::new(ErrorKind::NotFound, "there is no such program"),
    })
}

#[cfg(unix)]
fn is_program(file: &Path) -> bool {
    use std::os::unix::fs::PermissionsExt;
    std::fs::metadata(file).is_ok_and(|m| m.is_file() && m.permissions().mode() & 0o111 != 0)
}

#[cfg(not(unix))]
fn is_program(file: &Path) -> bool {
    file.is_file()
}

/// Limits this process and becomes the program `line[0]` with its arguments; returns only where that failed.
pub fn become_program(line: &[OsString], allowed: &Allowed) -> io::Error {
    let Some((program, arguments)) = line.split_first() else {
        return io::Error::new(ErrorKind::InvalidInput, "a program was expected");
    };
    let named =
        |e: io::Error| io::Error::new(e.kind(), format!("[fatal] {NOT_STARTED}{}: {e}", Path::new(program).display()));
    let mut command = Command::new(program);
    command.args(arguments);
    if let Err(e) = limit_self(allowed, Confined::Program) {
        return named(e);
    }
    named(replace(&mut command))
}

#[cfg(unix)]
fn replace(command: &mut Command) -> io::Error {
    std::os::unix::process::CommandExt::exec(command)
}

#[cfg(not(unix))]
fn replace(_: &mut Command) -> io::Error {
    ErrorKind::Unsupported.into()
}

/// Variables that a decoder keeps: where programs are and, where systems need them, shared libraries and Windows' folder.
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
/// two more arguments, behind these; on Linux a command line may follow, which the program becomes under these limits.
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
        Self { program: program.into(), arguments: vec![argument.into()] }
    }

    /// The command that starts it under these limits.
    pub(crate) fn command(&self, allowed: &Allowed) -> Command {
        let mut command = Command::new(&self.program);
        command.args(&self.arguments).arg(allowed.memory_bytes.to_string()).arg(allowed.cpu_s.to_string());
        command
    }
}

/// From now on [`super::read()`] has H.264 decoded by `program`, in a process of its own, and on Linux ffmpeg
/// started by it, so that it is limited before it reads a byte. A program calls this once, at its start, most often with
/// [`std::env::current_exe`]; without it OpenH264 decodes inside of the calling process.
/// Returns the program if another one was registered before.
pub fn set_decoder_program(program: DecoderProgram) -> Result<(), DecoderProgram> {
    REGISTERED.set(program)
}

/// The program that was registered.
#[must_use]
pub fn decoder_program() -> Option<&'static DecoderProgram> {
    REGISTERED.get()
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use super::find;
    use std::path::Path;

    #[test]
    fn programs_are_found_on_the_path_or_at_the_given_place() {
        let shell = find(Path::new("sh")).unwrap();
        assert!(shell.is_absolute() && shell.ends_with("sh"));
        assert_eq!(find(&shell).unwrap(), shell);
        for none in ["no-such-program", "/nowhere/sh", "/", "Cargo.toml", ""] {
            assert!(find(Path::new(none)).is_err(), "{none}");
        }
    }
}
