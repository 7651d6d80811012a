//! Where dependencies come from: registries alone.

use anyhow::{Context, Result, bail};
use std::path::Path;

/// The packages of a Cargo.lock that come from a git repository, each as `name: source`.
#[must_use]
pub fn git_sources(lock: &str) -> Vec<String> {
    let mut name = "";
    let mut found = Vec::new();
    for line in lock.lines() {
        if let Some(value) = line.strip_prefix("name = ") {
            name = value.trim_matches('"');
        } else if let Some(value) = line.strip_prefix("source = ") {
            let source = value.trim_matches('"');
            if source.starts_with("git+") {
                found.push(format!("{name}: {source}"));
            }
        }
    }
    found
}

/// Checks the Cargo.lock of the workspace at `root`.
///
/// # Errors
///
/// If it cannot be read, or with every package that comes from git.
pub fn check(root: &Path) -> Result<()> {
    let path = root.join("Cargo.lock");
    let lock = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let found = git_sources(&lock);
    if found.is_empty() { Ok(()) } else { bail!("packages from git:\n{}", found.join("\n")) }
}
