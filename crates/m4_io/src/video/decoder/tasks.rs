//! Counts the processes and threads of a user.

use std::fs;

/// Processes and threads of the user of this process, as `RLIMIT_NPROC` counts them; `None` where `/proc` cannot be read.
pub fn of_this_user() -> Option<u64> {
    let user = rustix::process::getuid().as_raw();
    let entries = fs::read_dir("/proc").ok()?.flatten();
    let is_process = |name: &str| name.bytes().all(|b| b.is_ascii_digit());
    let processes = entries.filter(|entry| entry.file_name().to_str().is_some_and(is_process));
    // One that has ended since it was listed counts no more.
    let texts = processes.filter_map(|entry| fs::read_to_string(entry.path().join("status")).ok());
    Some(texts.filter_map(|text| threads(&text, user)).sum())
}

/// Threads of a process by its `status`, if its real user is `user`.
fn threads(status: &str, user: u32) -> Option<u64> {
    let field = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name))?;
        line.split_whitespace().next()
    };
    (field("Uid:")?.parse() == Ok(user)).then_some(field("Threads:")?.parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::{of_this_user, threads};

    #[test]
    fn threads_of_one_user_are_counted() {
        let status = "Name:\tUid: 7\nUid:\t1000\t0\t0\t0\nGid:\t5\t5\t5\t5\nThreads:\t12\n";
        assert_eq!((threads(status, 1000), threads(status, 0)), (Some(12), None));
        assert_eq!(threads("", 0), None);
        // at least this test and the program that waits for it
        assert!(of_this_user().unwrap() >= 2);
    }
}
