//! Where figures come from: the machine and the commit, which must be what is built.

use super::PAGE;
use anyhow::{Context, Result, bail};
use std::path::Path;
use std::process::Command;

/// Machine and commit in words. Tracked files other than the page must be as committed.
pub(super) fn origin(root: &Path) -> Result<String> {
    let status = output(
        root,
        "git",
        &["status", "--porcelain", "--untracked-files=no"],
    )?;
    let changed = changed(&status);
    if !changed.is_empty() {
        bail!(
            "commit first, so that the commit on the page is what was measured; changed: {}",
            changed.join(", ")
        );
    }
    let field = |path: &str, key: &str| {
        let text = std::fs::read_to_string(path).ok()?;
        let line = text.lines().find(|line| line.starts_with(key))?;
        Some(
            line.split_once(':')?
                .1
                .trim()
                .trim_end_matches(" kB")
                .to_owned(),
        )
    };
    let cpu = field("/proc/cpuinfo", "model name").unwrap_or_else(|| "unknown CPU".to_owned());
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let kib = field("/proc/meminfo", "MemTotal").and_then(|kib| kib.parse::<f64>().ok());
    let memory = kib.map_or_else(|| "-".to_owned(), |kib| format!("{:.0}", kib / 1_048_576.0));
    let commit = output(root, "git", &["rev-parse", "--short", "HEAD"])?;
    Ok(format!(
        "{cpu}, {cores} cores, {memory} GiB, commit {}",
        commit.trim()
    ))
}

/// What a command prints.
pub(super) fn output(root: &Path, program: &str, args: &[&str]) -> Result<String> {
    let mut command = Command::new(program);
    printed(command.args(args).current_dir(root))
}

/// What a command prints; if it fails, the error has what it says.
pub(super) fn printed(command: &mut Command) -> Result<String> {
    let output = command
        .output()
        .with_context(|| format!("cannot start {command:?}"))?;
    if !output.status.success() {
        bail!(
            "{command:?} failed:\n{}",
            String::from_utf8_lossy(&output.stderr).trim()
        );
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// The files that `git status --porcelain` names, without the page.
fn changed(status: &str) -> Vec<&str> {
    status
        .lines()
        .filter_map(|line| line.get(3..))
        .filter(|&path| path != PAGE)
        .collect()
}

#[test]
fn changes_other_than_the_page_are_named() {
    let status = " M docs/results.md\nM  xtask/src/lib.rs\nR  a.rs -> b.rs\n";
    assert_eq!(changed(status), ["xtask/src/lib.rs", "a.rs -> b.rs"]);
}
