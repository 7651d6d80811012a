//! Limits of the operating system (`setrlimit`, `prctl`), on Linux only.

use super::Allowed;
use std::io;

/// Which process limits itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Confined {
    /// Our own decoder, which opens no file and starts nothing.
    Decoder,
    /// One that becomes another program now.
    Program,
}

/// Bytes that a decoder may write to a file: none of them has reason to write any, but wrappers of packages
/// keep small notes.
#[cfg(target_os = "linux")]
const FILE_BYTES: u64 = 1 << 20;
/// Files that another program may have open: many times what ffmpeg has, and one more than the number that a shell
/// keeps its script open under.
#[cfg(target_os = "linux")]
const FILES: u64 = 256;
/// Those of our own decoder: its pipes.
#[cfg(target_os = "linux")]
const PIPES: u64 = 3;
/// Processes and threads that the user may have besides those that are there when a program starts. ffmpeg takes some
/// fifty; the others are those of all other programs of the user, which the kernel counts too.
#[cfg(target_os = "linux")]
const MORE_TASKS: u64 = 1024;

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
fn set((resource, value): Limit, set: impl Fn(rustix::process::Rlimit) -> rustix::io::Result<()>) -> io::Result<()> {
    // What this process itself may not have, its children cannot be given.
    let most = rustix::process::getrlimit(resource).maximum;
    let value = Some(most.map_or(value, |most| most.min(value)));
    // Where both are one, the kernel kills; a signal before that could be ignored.
    let limit = rustix::process::Rlimit { current: value, maximum: value };
    Ok(set(limit)?)
}

/// Sets the limits of a child that was just started. One that does not limit itself (`bare`) is given one of open files too.
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

/// Sets the limits of this process, and that neither it nor what it becomes can gain privileges (`no_new_privs`).
///
/// # Errors
///
/// What the system says.
#[cfg(target_os = "linux")]
pub fn limit_self(allowed: &Allowed, confined: Confined) -> io::Result<()> {
    use rustix::process::{Resource, setrlimit};
    rustix::thread::set_no_new_privs(true)?;
    let (files, tasks) = match confined {
        Confined::Decoder => (PIPES, Some(0)),
        Confined::Program => (FILES, tasks_of_this_user().map(|n| n + MORE_TASKS)),
    };
    let tasks = tasks.map(|n| (Resource::Nproc, n));
    let own = tasks.into_iter().chain([(Resource::Nofile, files)]);
    for limit in own.chain(limits(allowed)) {
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
///
/// # Errors
///
/// None.
#[cfg(not(target_os = "linux"))]
pub fn limit_self(_: &Allowed, _: Confined) -> io::Result<()> {
    Ok(())
}

/// Processes and threads of the user of this process, as `RLIMIT_NPROC` counts them; `None` where `/proc` cannot be read.
#[cfg(target_os = "linux")]
fn tasks_of_this_user() -> Option<u64> {
    let user = rustix::process::getuid().as_raw();
    let entries = std::fs::read_dir("/proc").ok()?.flatten();
    let is_process = |name: &str| name.bytes().all(|b| b.is_ascii_digit());
    let processes = entries.filter(|entry| entry.file_name().to_str().is_some_and(is_process));
    // One that has ended since it was listed counts no more.
    let texts = processes.filter_map(|entry| std::fs::read_to_string(entry.path().join("status")).ok());
    Some(texts.filter_map(|text| threads(&text, user)).sum())
}

/// Threads of a process by its `status`, if its real user is `user`.
#[cfg(target_os = "linux")]
fn threads(status: &str, user: u32) -> Option<u64> {
    let field = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name))?;
        line.split_whitespace().next()
    };
    (field("Uid:")?.parse() == Ok(user)).then_some(field("Threads:")?.parse().ok())?
}

#[cfg(test)]
#[cfg(target_os = "linux")]
mod tests {
    use super::{tasks_of_this_user, threads};

    #[test]
    fn threads_of_one_user_are_counted() {
        let status = "Name:\tUid: 7\nUid:\t1000\t0\t0\t0\nGid:\t5\t5\t5\t5\nThreads:\t12\n";
        assert_eq!((threads(status, 1000), threads(status, 0)), (Some(12), None));
        assert_eq!(threads("", 0), None);
        // at least this test and the program that waits for it
        assert!(tasks_of_this_user().unwrap() >= 2);
    }
}
