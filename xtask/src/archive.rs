//! `cargo xtask archive`: the program with its licences, man pages and completions in one file, the
//! same bytes for the same commit.

use crate::command::{host, metadata, run, stdout, target_folder};
use crate::{licences, wheel};
use anyhow::{Context, Result, bail};
use flate2::{Compression, write::GzEncoder};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::io::{Cursor, Write as _};
use std::path::{Path, PathBuf};
use std::process::Command;

/// A file in an archive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Item {
    /// Path inside the archive's folder, with `/`.
    pub name: String,
    /// The contents.
    pub bytes: Vec<u8>,
    /// Whether it is a program.
    pub program: bool,
}

impl Item {
    fn mode(&self) -> u32 {
        if self.program { 0o755 } else { 0o644 }
    }
}

/// The date of a commit, UTC.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Date {
    /// Seconds since 1970.
    pub unix_s: u64,
    /// Year, month, day, hour, minute, second.
    pub parts: [u16; 6],
}

/// Builds the program as it is shipped ([`wheel::build`], which compiles it once for both) for this
/// machine, and packs it. Returns the archive's path.
///
/// # Errors
///
/// The build or git fails, or a file cannot be read or written.
pub fn make(root: &Path) -> Result<PathBuf> {
    let target = host()?;
    let metadata = metadata(root)?;
    let folder = target_folder(&metadata)?.join("archive");
    let version = metadata["packages"]
        .as_array()
        .and_then(|all| all.iter().find(|p| p["name"] == "minute4d_cli"))
        .and_then(|package| package["version"].as_str())
        .context("metadata has no version of minute4d_cli")?;
    let program = wheel::build(root, &metadata, &target)?.program;

    let file = program.file_name().and_then(|name| name.to_str());
    let mut items = vec![item(file.context("the program has no name")?, &program)?];
    items[0].program = true;
    for name in ["README.md", "CHANGELOG.md"] {
        items.push(item(name, &root.join(name))?);
    }
    for (name, bytes) in licences::files(root, &metadata, &target)? {
        items.push(Item {
            name,
            bytes,
            program: false,
        });
    }
    let manual = folder.join("manual");
    if manual.exists() {
        std::fs::remove_dir_all(&manual).context("cannot empty the folder of the manual")?;
    }
    run(Command::new(&program)
        .args(["--quiet", "manual"])
        .arg(&manual)
        .stdout(std::process::Stdio::null()))?;
    add_folder(&mut items, &manual, "manual")?;
    items.sort_by(|a, b| a.name.cmp(&b.name));
    let sums = items
        .iter()
        .map(|i| sum_line(&i.name, &i.bytes))
        .collect::<String>();
    items.push(Item {
        name: "SHA256SUMS".to_owned(),
        bytes: sums.into_bytes(),
        program: false,
    });

    let (name, file) = names(version, &target);
    let date = commit_date(root)?;
    let bytes = if file.ends_with("zip") {
        zip(&name, &items, date)?
    } else {
        tar_gz(&name, &items, date)?
    };
    let path = folder.join(file);
    std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
    Ok(path)
}

/// The names of the folder in an archive and of the archive, for a version and a target.
pub fn names(version: &str, target: &str) -> (String, String) {
    let folder = format!("minute4d-{version}-{target}");
    let extension = if target.contains("windows") {
        "zip"
    } else {
        "tar.gz"
    };
    let file = format!("{folder}.{extension}");
    (folder, file)
}

fn item(name: &str, path: &Path) -> Result<Item> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(Item {
        name: name.to_owned(),
        bytes,
        program: false,
    })
}

fn add_folder(items: &mut Vec<Item>, folder: &Path, name: &str) -> Result<()> {
    let entries = std::fs::read_dir(folder);
    for entry in entries.with_context(|| format!("cannot list {}", folder.display()))? {
        let path = entry?.path();
        let last = path.file_name().and_then(|name| name.to_str());
        let inner = format!("{name}/{}", last.context("a name is not Unicode")?);
        if path.is_dir() {
            add_folder(items, &path, &inner)?;
        } else {
            items.push(item(&inner, &path)?);
        }
    }
    Ok(())
}

/// A line as `sha256sum` prints and checks it.
pub fn sum_line(name: &str, bytes: &[u8]) -> String {
    let mut line = String::new();
    for byte in Sha256::digest(bytes) {
        let _ = write!(line, "{byte:02x}");
    }
    format!("{line}  {name}\n")
}

/// The date of the commit that is checked out.
fn commit_date(root: &Path) -> Result<Date> {
    let mut git = Command::new("git");
    git.current_dir(root).env("TZ", "UTC0").args(["log", "-1"]);
    git.args(["--date=format-local:%Y %m %d %H %M %S", "--format=%ct %cd"]);
    let text = stdout(&mut git)?;
    let numbers = text.split_whitespace().map(str::parse::<u64>);
    let numbers = numbers
        .collect::<Result<Vec<_>, _>>()
        .context("git printed no date")?;
    let &[unix_s, ref parts @ ..] = &numbers[..] else {
        bail!("git printed no date");
    };
    let parts: Vec<u16> = parts.iter().map(|&part| part as u16).collect();
    let parts = parts.try_into().ok().context("git printed no date")?;
    Ok(Date { unix_s, parts })
}

/// Packs files in a folder, in this order; nothing of this machine is in it.
///
/// # Errors
///
/// A name is too long.
pub fn tar_gz(folder: &str, items: &[Item], date: Date) -> Result<Vec<u8>> {
    let mut builder = tar::Builder::new(GzEncoder::new(Vec::new(), Compression::best()));
    for item in items {
        let mut header = tar::Header::new_gnu();
        header.set_entry_type(tar::EntryType::Regular);
        header.set_mode(item.mode());
        header.set_mtime(date.unix_s);
        header.set_size(item.bytes.len() as u64);
        header.set_uid(0);
        header.set_gid(0);
        builder.append_data(
            &mut header,
            format!("{folder}/{}", item.name),
            &item.bytes[..],
        )?;
    }
    Ok(builder.into_inner()?.finish()?)
}

/// The same as a zip file, for Windows.
///
/// # Errors
///
/// A date before 1980.
pub fn zip(folder: &str, items: &[Item], date: Date) -> Result<Vec<u8>> {
    let [year, rest @ ..] = date.parts;
    let [month, day, hour, minute, second] = rest.map(|part| part as u8);
    let time = zip::DateTime::from_date_and_time(year, month, day, hour, minute, second)?;
    let mut writer = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for item in items {
        let options = zip::write::SimpleFileOptions::default()
            .last_modified_time(time)
            .unix_permissions(item.mode());
        writer.start_file(format!("{folder}/{}", item.name), options)?;
        writer.write_all(&item.bytes)?;
    }
    Ok(writer.finish()?.into_inner())
}
