//! Starts a program that does not limit itself: on Linux our own program is started first, limits itself, and then executes that program.

use super::{Allowed, Confined, DecoderProgram, limit_self};
use std::ffi::OsString;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::process::Command;

/// What our own program says of a program that it could not become.
pub const NOT_STARTED: &str = "not started: ";

/// The command for `program`, by way of `launcher` where there is one and the system keeps limits. Its arguments are to
/// follow.
///
/// # Errors
///
/// That there is no such program, where it goes by way of a launcher.
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
        std::env::split_paths(&path)
            .map(|folder| folder.join(program))
            .collect()
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

/// Limits this process and becomes the program `line[0]` with the arguments behind it.
///
/// # Errors
///
/// It returns only where that failed, with the error of the system.
pub fn become_program(line: &[OsString], allowed: &Allowed) -> io::Error {
    let Some((program, arguments)) = line.split_first() else {
        return io::Error::new(ErrorKind::InvalidInput, "a program was expected");
    };
    let named = |e: io::Error| {
        let what = format!("[fatal] {NOT_STARTED}{}: {e}", Path::new(program).display());
        io::Error::new(e.kind(), what)
    };
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
