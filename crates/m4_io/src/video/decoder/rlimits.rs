//! Limits that the operating system keeps (`setrlimit`), on Linux; elsewhere there are none.

use super::Allowed;
use std::io;

/// Bytes that a decoder may write to a file: none of them has reason to write any, but wrappers of packages
/// keep small notes.
#[cfg(target_os = "linux")]
const FILE_BYTES: u64 = 1 << 20;

#[cfg(target_os = "linux")]
fn limits(allowed: &Allowed) -> [(rustix::process::Resource, rustix::process::Rlimit); 4] {
    use rustix::process::{Resource, Rlimit, getrlimit};
    let limit = |resource, value: u64| {
        // What this process itself may not have, its children cannot be given.
        let value = getrlimit(resource).maximum.map_or(value, |most| most.min(value));
        // Where both are one, the kernel kills; a signal before that could be ignored.
        let limit = Rlimit {
            current: Some(value),
            maximum: Some(value),
        };
        (resource, limit)
    };
    [
        limit(Resource::As, allowed.memory_bytes),
        limit(Resource::Cpu, allowed.cpu_s),
        limit(Resource::Fsize, FILE_BYTES),
        limit(Resource::Core, 0),
    ]
}

/// Sets the limits of a child that was just started.
#[cfg(target_os = "linux")]
pub fn limit_child(child: &std::process::Child, allowed: &Allowed) -> io::Result<()> {
    let pid = rustix::process::Pid::from_child(child);
    for (resource, limit) in limits(allowed) {
        match rustix::process::prlimit(Some(pid), resource, limit) {
            // It has ended already, which will be seen.
            Ok(_) | Err(rustix::io::Errno::SRCH) => {}
            Err(e) => return Err(e.into()),
        }
    }
    Ok(())
}

/// Sets the limits of this process.
///
/// # Errors
///
/// What the system says.
#[cfg(target_os = "linux")]
pub fn limit_self(allowed: &Allowed) -> io::Result<()> {
    for (resource, limit) in limits(allowed) {
        rustix::process::setrlimit(resource, limit)?;
    }
    Ok(())
}

/// No limits: see the module.
#[cfg(not(target_os = "linux"))]
pub fn limit_child(_: &std::process::Child, _: &Allowed) -> io::Result<()> {
    Ok(())
}

/// No limits: see the module.
///
/// # Errors
///
/// None.
#[cfg(not(target_os = "linux"))]
pub fn limit_self(_: &Allowed) -> io::Result<()> {
    Ok(())
}
