//! Which crate may depend on which: the table of ARCHITECTURE.md against `cargo metadata`. Where
//! dependencies come from: registries alone.

use anyhow::{Context, Result, bail};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

/// For each crate, the crates of this workspace that it depends on.
pub type Arrows = BTreeMap<String, BTreeSet<String>>;

/// The crate that only tests may use; every crate may have it as a dev-dependency.
pub const TESTKIT: &str = "m4_testkit";

/// Crates whose tests may also use another: to read real data, and to compare what they made with
/// what our own renderer draws of it.
const FOR_TESTS: [(&str, &str); 4] = [
    ("m4_geometry", "m4_io"),
    ("m4_train", "m4_io"),
    ("m4_viewer", "m4_kernels"),
    ("minute4d_cli", "m4_eval"),
];

fn for_tests(from: &str, to: &str) -> bool {
    to == TESTKIT || FOR_TESTS.contains(&(from, to))
}

/// Dependencies between the crates of a workspace, as they are.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Actual {
    /// `[dependencies]` and `[build-dependencies]`.
    pub normal: Arrows,
    /// `[dev-dependencies]`.
    pub dev: Arrows,
}

/// Asks `cargo metadata` for the crates under `root` and their dependencies on one another.
pub fn actual(root: &Path) -> Result<Actual> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .args([
            "metadata",
            "--format-version",
            "1",
            "--no-deps",
            "--offline",
        ])
        .current_dir(root)
        .output()
        .context("cannot start cargo metadata")?;
    if !output.status.success() {
        bail!(
            "cargo metadata failed: {}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
    from_metadata(
        &serde_json::from_slice(&output.stdout).context("cargo metadata printed no JSON")?,
    )
}

/// Reads the arrows from the JSON of `cargo metadata --no-deps`; `xtask` itself is left out.
pub fn from_metadata(metadata: &serde_json::Value) -> Result<Actual> {
    let packages = metadata["packages"]
        .as_array()
        .context("metadata has no packages")?;
    let text = |v: &serde_json::Value| v.as_str().map(str::to_owned);
    let names: BTreeSet<String> = packages.iter().filter_map(|p| text(&p["name"])).collect();
    let mut arrows = Actual::default();
    for package in packages {
        let name = text(&package["name"]).context("a package without a name")?;
        if name == "xtask" {
            continue;
        }
        arrows.normal.entry(name.clone()).or_default();
        arrows.dev.entry(name.clone()).or_default();
        for dependency in package["dependencies"]
            .as_array()
            .context("a package without dependencies")?
        {
            let to = text(&dependency["name"]).context("a dependency without a name")?;
            if !names.contains(&to) {
                continue;
            }
            let kind = if dependency["kind"] == "dev" {
                &mut arrows.dev
            } else {
                &mut arrows.normal
            };
            kind.entry(name.clone()).or_default().insert(to);
        }
    }
    Ok(arrows)
}

/// Reads the allowed arrows from the table of ARCHITECTURE.md whose header says `may depend on`: a
/// row names a crate, and those that it may depend on, in backticks.
pub fn allowed(markdown: &str) -> Arrows {
    let mut arrows = Arrows::new();
    let mut in_table = false;
    for line in markdown.lines() {
        if !line.starts_with('|') {
            in_table = false;
        } else if in_table {
            let mut names = line.split('`').skip(1).step_by(2).map(str::to_owned);
            if let Some(name) = names.next() {
                arrows.insert(name, names.collect());
            }
        } else {
            in_table = line.contains("may depend on");
        }
    }
    arrows
}

/// Compares what is with what may be; one line a mistake, empty when all is well.
pub fn violations(actual: &Actual, allowed: &Arrows) -> Vec<String> {
    let mut faults = Vec::new();
    for (kind, arrows) in [("", &actual.normal), ("dev-", &actual.dev)] {
        for (from, targets) in arrows {
            let Some(may) = allowed.get(from) else {
                if kind.is_empty() {
                    faults.push(format!("{from} has no row in the table of ARCHITECTURE.md"));
                }
                continue;
            };
            for to in targets {
                let testing = kind == "dev-" && for_tests(from, to);
                if !testing && !may.contains(to) {
                    faults.push(format!("{from} has a {kind}dependency on {to}, which ARCHITECTURE.md does not allow"));
                }
            }
        }
    }
    for name in allowed
        .keys()
        .filter(|name| !actual.normal.contains_key(*name))
    {
        faults.push(format!(
            "ARCHITECTURE.md has a row for {name}, which is not a crate of this workspace"
        ));
    }
    faults
}

/// Checks the workspace at `root` against its ARCHITECTURE.md.
pub fn check(root: &Path) -> Result<()> {
    let path = root.join("ARCHITECTURE.md");
    let markdown = std::fs::read_to_string(&path)
        .with_context(|| format!("cannot read {}", path.display()))?;
    let actual = actual(root)?;
    let faults = violations(&actual, &allowed(&markdown));
    if faults.is_empty() {
        Ok(())
    } else {
        bail!("{}", faults.join("\n"))
    }
}

/// The packages of a Cargo.lock that come from a git repository, each as `name: source`.
pub fn git_sources(lock: &str) -> Vec<String> {
    let mut name = "";
    let mut sources = Vec::new();
    for line in lock.lines() {
        if let Some(value) = line.strip_prefix("name = ") {
            name = value.trim_matches('"');
        } else if let Some(value) = line.strip_prefix("source = ") {
            let source = value.trim_matches('"');
            if source.starts_with("git+") {
                sources.push(format!("{name}: {source}"));
            }
        }
    }
    sources
}

/// Checks the Cargo.lock of the workspace at `root`.
pub fn check_lock(root: &Path) -> Result<()> {
    let path = root.join("Cargo.lock");
    let lock = std::fs::read_to_string(&path)
        .with_context(|| format!("cannot read {}", path.display()))?;
    let sources = git_sources(&lock);
    if sources.is_empty() {
        Ok(())
    } else {
        bail!("packages from git:\n{}", sources.join("\n"))
    }
}
