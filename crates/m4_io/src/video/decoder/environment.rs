//! The environment variables that a decoder gets: none that may hold secrets.

use std::process::Command;

/// Variables that a decoder keeps, where they are set: where programs are and, of systems that need them, the shared
/// libraries of a program that is not installed in the usual place (modules of a cluster) and the folder of Windows.
const KEPT: &[&str] = if cfg!(windows) {
    &["PATH", "SystemRoot"]
} else if cfg!(target_os = "linux") {
    &["PATH", "LD_LIBRARY_PATH"]
} else {
    &["PATH"]
};

/// Takes everything but [`KEPT`] from a command.
pub fn clear(command: &mut Command) {
    command.env_clear();
    for name in KEPT {
        if let Some(value) = std::env::var_os(name) {
            command.env(name, value);
        }
    }
    // Arenas of the C library take address space for every thread.
    command.env("MALLOC_ARENA_MAX", "4");
}
