//! The licences of all packages that the shipped program is linked with, in one text.

use crate::command::{cargo, stdout};
use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A linked package.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Linked {
    /// Name and version.
    pub name: String,
    /// SPDX expression.
    pub licence: String,
    /// Where its source is kept, if it says so.
    pub repository: Option<String>,
    /// Its authors, if it says so.
    pub authors: Vec<String>,
    /// The texts in its source: licences, notices.
    pub texts: Vec<String>,
}

/// Returns the packages that `minute4d` is linked with, built with `full` for `target`; packages of
/// the workspace are left out.
///
/// # Errors
///
/// Cargo fails, or the source of a package cannot be read.
pub fn linked(root: &Path, metadata: &Value, target: &str) -> Result<Vec<Linked>> {
    let tree = stdout(cargo(root).args([
        "tree",
        "--locked",
        "--package",
        "minute4d_cli",
        "--features",
        "full",
        "--edges",
        "normal,no-proc-macro",
        "--prefix",
        "none",
        "--format",
        "{p}",
        "--target",
        target,
    ]))?;
    // `name vVERSION`, and the folder of a local package.
    let names: BTreeSet<(&str, &str)> = tree
        .lines()
        .filter_map(|line| line.split_once(" v"))
        .map(|(name, rest)| (name, rest.split(' ').next().unwrap_or(rest)))
        .collect();
    let packages = metadata["packages"].as_array();
    let mut all = Vec::new();
    for package in packages.context("metadata has no packages")? {
        let text = |key: &str| package[key].as_str();
        let (Some(name), Some(version)) = (text("name"), text("version")) else {
            bail!("metadata has a package without a name or version");
        };
        if !names.contains(&(name, version)) || package["source"].is_null() {
            continue;
        }
        let manifest = Path::new(text("manifest_path").context("a package has no folder")?);
        let folder = manifest.parent().context("a package has no folder")?;
        let authors = package["authors"].as_array().into_iter().flatten();
        all.push(Linked {
            name: format!("{name} {version}"),
            licence: text("license")
                .map_or_else(|| "see its text".to_owned(), |l| l.replace('/', " OR ")),
            repository: text("repository").map(str::to_owned),
            authors: authors
                .filter_map(Value::as_str)
                .map(str::to_owned)
                .collect(),
            texts: texts(folder).with_context(|| format!("cannot read the source of {name}"))?,
        });
    }
    all.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(all)
}

/// The texts of licences and notices anywhere in a folder, in order of their paths.
fn texts(folder: &Path) -> Result<Vec<String>> {
    let mut paths = Vec::new();
    list(folder, &mut paths)?;
    paths.sort();
    let mut texts = Vec::new();
    for path in paths {
        let bytes = std::fs::read(&path)?;
        let text = String::from_utf8_lossy(&bytes).replace("\r\n", "\n");
        texts.push(text.trim_matches('\n').to_owned());
    }
    Ok(texts)
}

fn list(folder: &Path, paths: &mut Vec<PathBuf>) -> Result<()> {
    const STARTS: [&str; 6] = [
        "license",
        "licence",
        "copying",
        "notice",
        "unlicense",
        "copyright",
    ];
    const CODE: [&str; 6] = ["rs", "c", "h", "py", "sh", "json"];
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let code = path
            .extension()
            .is_some_and(|e| CODE.iter().any(|c| e == *c));
        if path.is_dir() {
            list(&path, paths)?;
        } else if !code && STARTS.iter().any(|s| name.to_lowercase().starts_with(s)) {
            paths.push(path);
        }
    }
    Ok(())
}

/// Returns one text with all licences: the packages, then each text once with those that have it.
/// `own` are texts of licences by SPDX identifier, for packages whose source has none.
///
/// # Errors
///
/// A package has no text, and no other package has the text of one of its licences.
pub fn document(packages: &[Linked], own: &[(&str, &str)]) -> Result<String> {
    let mut out = String::from(
        "The program minute4d is linked with these packages. Their source, unmodified, is in the \
         registry of\nRust's packages under these names and versions.\n\n",
    );
    for package in packages {
        let place = package.repository.as_deref().unwrap_or("");
        let line = format!("{}: {}  {place}", package.name, package.licence);
        let _ = writeln!(out, "{}", line.trim_end());
    }
    let mut holders: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for package in packages {
        for text in &package.texts {
            holders.entry(text).or_default().push(package.name.clone());
        }
        if package.texts.is_empty() {
            let text = borrowed(package, packages, own)?;
            let authors = match &package.authors[..] {
                [] => "its authors".to_owned(),
                names => names.join(", "),
            };
            let holder = format!(
                "{} (no text in its source; the terms of {}; copyright {authors})",
                package.name, package.licence
            );
            holders.entry(text).or_default().push(holder);
        }
    }
    let mut sections: Vec<(Vec<String>, &str)> = holders.into_iter().map(|(t, n)| (n, t)).collect();
    sections.sort();
    for (mut names, text) in sections {
        names.dedup();
        let _ = write!(
            out,
            "\n{}\n{}\n\n{text}\n",
            "=".repeat(80),
            names.join("\n")
        );
    }
    Ok(out)
}

/// The text of one of the licences of a package that has none: ours, or that of a package under
/// this licence alone.
fn borrowed<'a>(
    package: &Linked,
    packages: &'a [Linked],
    own: &[(&str, &'a str)],
) -> Result<&'a str> {
    let of = |id: &str| {
        let ours = own
            .iter()
            .find(|(own, _)| *own == id)
            .map(|(_, text)| *text);
        let other = || {
            let mut same = packages.iter().filter(|other| other.licence == id);
            same.find_map(|other| other.texts.first())
        };
        ours.or_else(|| other().map(String::as_str))
    };
    let Some(text) = package.licence.split(" OR ").find_map(of) else {
        bail!(
            "{} has no text of its licence ({}), and no other package has it; add it to xtask::licences",
            package.name,
            package.licence
        );
    };
    Ok(text)
}

/// Returns the files about licences that go with the program, by name.
///
/// # Errors
///
/// As [`linked`] and [`document`]; the toolchain lacks the notices of its library.
pub fn files(root: &Path, metadata: &Value, target: &str) -> Result<Vec<(String, Vec<u8>)>> {
    let read = |path: &Path| {
        std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))
    };
    let [mit, apache] = ["LICENSE-MIT", "LICENSE-APACHE"].map(|name| read(&root.join(name)));
    let (mit, apache) = (mit?, apache?);
    let own = String::from_utf8_lossy(&apache);
    let packages = linked(root, metadata, target)?;
    let all = document(&packages, &[("Apache-2.0", own.trim_matches('\n'))])?;
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let sysroot = stdout(
        Command::new(rustc)
            .args(["--print", "sysroot"])
            .current_dir(root),
    )?;
    let library = Path::new(sysroot.trim()).join("share/doc/rust/COPYRIGHT-library.html");
    let library = read(&library)
        .context("the notices of Rust's library are missing; build with a toolchain of rustup")?;
    Ok(vec![
        ("LICENSE-MIT".to_owned(), mit),
        ("LICENSE-APACHE".to_owned(), apache),
        ("LICENSE-THIRD-PARTY.txt".to_owned(), all.into_bytes()),
        ("LICENSE-RUST-LIBRARY.html".to_owned(), library),
    ])
}
