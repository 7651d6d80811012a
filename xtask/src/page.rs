//! The viewer's page: built from its sources, and compared with the one that is kept.
//!
//! The sources are TypeScript in `crates/m4_viewer/page`; the built page is kept beside them, so
//! that building the program does not need Node.js.

use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};
use std::process::Command;

const SOURCES: &str = "crates/m4_viewer/page";
/// What the tests of the page share with those of the crate; it lies beside the page's folder in
/// the copy too.
const SHARED: &str = "crates/m4_viewer/tests/payload";
const KEPT: &str = "crates/m4_viewer/page.html";
/// Generated folders, which are not copied.
const MADE: [&str; 2] = ["node_modules", "dist"];

/// The result of a comparison.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// The page that is kept is what its sources build to.
    Same,
    /// It is not.
    Differs,
    /// The comparison was skipped.
    Skipped {
        /// The reason.
        reason: String,
    },
}

/// Builds the page from its sources and keeps it.
pub fn build(root: &Path, work: &Path) -> Result<()> {
    let folder = copied(root, work)?;
    npm(&folder, &["ci", "--no-audit", "--no-fund"])?;
    npm(&folder, &["run", "build"])?;
    std::fs::copy(work.join("page.html"), root.join(KEPT))
        .with_context(|| format!("cannot write {KEPT}"))?;
    Ok(())
}

/// Builds the page in `work`, runs its own tests (those in a browser with `chromium`), and compares
/// it byte for byte with the one that is kept.
pub fn compare(root: &Path, work: &Path, chromium: Option<&Path>) -> Result<Outcome> {
    let result = Command::new("npm").arg("--version").output();
    if !result.is_ok_and(|o| o.status.success()) {
        return Ok(Outcome::Skipped {
            reason: "npm is not installed".to_owned(),
        });
    }
    let folder = copied(root, work)?;
    if let Err(error) = npm(&folder, &["ci", "--no-audit", "--no-fund"]) {
        // the lock file and package.json disagree: no network would help
        if error.to_string().contains("EUSAGE") {
            return Err(error);
        }
        return Ok(Outcome::Skipped {
            reason: format!("the packages cannot be had: {error:#}"),
        });
    }
    npm(&folder, &["test"])?;
    npm(&folder, &["run", "build"])?;
    if let Some(chromium) = chromium {
        npm_with(&folder, &["run", "test:browser"], &[("CHROMIUM", chromium)])?;
    }
    let same = read(&root.join(KEPT))? == read(&work.join("page.html"))?;
    Ok(if same {
        Outcome::Same
    } else {
        Outcome::Differs
    })
}

/// A fresh copy of the sources, and of nothing that was built from them.
fn copied(root: &Path, work: &Path) -> Result<PathBuf> {
    let folder = work.join("page");
    if folder.exists() {
        std::fs::remove_dir_all(&folder)
            .with_context(|| format!("cannot empty {}", folder.display()))?;
    }
    copy(&root.join(SOURCES), &folder)?;
    copy(&root.join(SHARED), &work.join("tests/payload"))?;
    Ok(folder)
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    std::fs::create_dir_all(to).with_context(|| format!("cannot make {}", to.display()))?;
    for entry in
        std::fs::read_dir(from).with_context(|| format!("cannot list {}", from.display()))?
    {
        let entry = entry?;
        let (name, target) = (entry.file_name(), to.join(entry.file_name()));
        if MADE.iter().any(|output| name == *output) {
            continue;
        }
        if entry.file_type()?.is_dir() {
            copy(&entry.path(), &target)?;
        } else {
            std::fs::copy(entry.path(), &target)
                .with_context(|| format!("cannot copy {}", entry.path().display()))?;
        }
    }
    Ok(())
}

fn npm(folder: &Path, args: &[&str]) -> Result<()> {
    npm_with(folder, args, &[])
}

fn npm_with(folder: &Path, args: &[&str], env: &[(&str, &Path)]) -> Result<()> {
    let output = Command::new("npm")
        .args(args)
        .envs(env.iter().copied())
        .current_dir(folder)
        .output()
        .context("cannot start npm")?;
    if !output.status.success() {
        let (out, err) = (
            String::from_utf8_lossy(&output.stdout),
            String::from_utf8_lossy(&output.stderr),
        );
        bail!(
            "npm {} ended with {}\n{out}{err}",
            args.join(" "),
            output.status
        );
    }
    Ok(())
}

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))
}
