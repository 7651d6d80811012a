//! Limits of a process that reads malformed files.

use std::io;

/// Limits the address space of this process, bytes: what asks for more is aborted, whatever the machine has.
///
/// # Errors
///
/// What the system says; on systems without the limit that there is none.
#[cfg(unix)]
pub fn limit_memory(bytes: u64) -> io::Result<()> {
    use rustix::process::{Resource, Rlimit, setrlimit};
    let limit = Rlimit {
        current: Some(bytes),
        maximum: Some(bytes),
    };
    setrlimit(Resource::As, limit).map_err(io::Error::from)
}

/// Limits the address space of this process, bytes: what asks for more is aborted, whatever the machine has.
///
/// # Errors
///
/// What the system says; on systems without the limit that there is none.
#[cfg(not(unix))]
pub fn limit_memory(_bytes: u64) -> io::Result<()> {
    Err(io::Error::from(io::ErrorKind::Unsupported))
}
