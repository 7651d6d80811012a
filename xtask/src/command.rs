//! Programs that the tasks start.

use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Returns a command that runs the cargo of this process in the workspace.
pub fn cargo(root: &Path) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.current_dir(root);
    command
}

/// Runs a command to its end.
///
/// # Errors
///
/// It cannot be started, or fails.
pub fn run(command: &mut Command) -> Result<()> {
    let status = command.status().with_context(|| started(command))?;
    if !status.success() {
        bail!("{} ended with {status}", words(command));
    }
    Ok(())
}

/// Runs a command and returns its standard output.
///
/// # Errors
///
/// It cannot be started, fails, or prints something else than text.
pub fn stdout(command: &mut Command) -> Result<String> {
    let output = command.output().with_context(|| started(command))?;
    if !output.status.success() {
        let stderr = String::from_utf8_lossy(&output.stderr);
        bail!("{} ended with {}: {stderr}", words(command), output.status);
    }
    String::from_utf8(output.stdout).with_context(|| format!("{} prints no text", words(command)))
}

fn started(command: &Command) -> String {
    format!("cannot start {}", command.get_program().to_string_lossy())
}

fn words(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    words
        .map(OsStr::to_string_lossy)
        .collect::<Vec<_>>()
        .join(" ")
}

/// The packages of the workspace with all they depend on, and where builds go: `cargo metadata`.
///
/// # Errors
///
/// Cargo fails.
pub fn metadata(root: &Path) -> Result<Value> {
    let text = stdout(cargo(root).args(["metadata", "--format-version", "1", "--locked"]))?;
    serde_json::from_str(&text).context("cargo metadata printed no JSON")
}

/// The folder of builds.
///
/// # Errors
///
/// The metadata has none.
pub fn target_folder(metadata: &Value) -> Result<PathBuf> {
    let folder = metadata["target_directory"].as_str();
    Ok(PathBuf::from(
        folder.context("metadata has no target_directory")?,
    ))
}

/// The triple of the machine that compiles.
///
/// # Errors
///
/// The compiler does not say.
pub fn host() -> Result<String> {
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let text = stdout(Command::new(rustc).arg("-vV"))?;
    let line = text.lines().find_map(|line| line.strip_prefix("host: "));
    Ok(line.context("rustc -vV names no host")?.to_owned())
}
