//! Runs of the program, each kept with the machine and commit that it belongs to, so that a second
//! call continues.

use super::machine::{output, printed};
use super::page;
use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A scene or a clip.
#[derive(Clone)]
pub(super) struct Input {
    /// That of its folder, or of its file without the extension.
    pub name: String,
    pub path: PathBuf,
    /// The folder of what is made of it.
    pub dir: PathBuf,
}

/// The inputs at `paths`, of different names, and what is made of them under `work`.
pub(super) fn inputs(paths: Vec<PathBuf>, work: &Path) -> Result<Vec<Input>> {
    let mut names = BTreeSet::new();
    let input = |path: PathBuf| match name(&path) {
        name if names.insert(name.clone()) => Ok(Input {
            dir: work.join(&name),
            name,
            path,
        }),
        name => bail!("two inputs are named {name}"),
    };
    paths.into_iter().map(input).collect()
}

/// The last part of a path, without an extension.
pub(super) fn name(path: &Path) -> String {
    path.file_stem()
        .unwrap_or(path.as_os_str())
        .to_string_lossy()
        .into_owned()
}

/// The runs behind the tables. Until [`Runs::begin`] they are counted, and every value is null.
#[derive(Default)]
pub(super) struct Runs {
    root: PathBuf,
    origin: String,
    program: Option<Program>,
    counted: BTreeSet<PathBuf>,
    paths: BTreeSet<PathBuf>,
    /// The last day on which a value was measured (UTC).
    pub date: String,
}

impl Runs {
    pub(super) fn new(root: &Path, origin: &str) -> Self {
        Self {
            root: root.to_owned(),
            origin: origin.to_owned(),
            ..Self::default()
        }
    }

    /// Builds the program; from now on runs are made.
    pub(super) fn begin(&mut self) -> Result<()> {
        let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
        let args = [
            "build",
            "--release",
            "--package",
            "minute4d_lab",
            "--message-format=json",
        ];
        let messages = output(&self.root, &cargo, &args)?;
        let mut messages = messages
            .lines()
            .filter_map(|line| serde_json::from_str::<Value>(line).ok());
        let path = messages.find_map(|m| m["executable"].as_str().map(PathBuf::from));
        self.program = Some(Program(path.context("cargo named no program")?));
        Ok(())
    }

    /// What `measure` gives for an input, or gave in an earlier call at the same commit. `folder`,
    /// in that of the input, is what it makes; one that was made at another commit is removed.
    #[expect(
        clippy::print_stderr,
        reason = "progress of a command that takes hours"
    )]
    pub(super) fn of(
        &mut self,
        input: &Input,
        what: &str,
        folder: &str,
        measure: impl FnOnce(&Program) -> Result<Value>,
    ) -> Result<Value> {
        let path = input.dir.join(format!(
            "{}.json",
            what.replace(", ", "-").replace(' ', "-")
        ));
        let Some(program) = &self.program else {
            self.counted.insert(path);
            return Ok(Value::Null);
        };
        let key = json!(format!("{}, {}", self.origin, input.path.display()));
        let mut record = read(&path).unwrap_or_default();
        if record["key"] != key {
            let stale = input.dir.join(folder);
            if stale.exists() {
                std::fs::remove_dir_all(&stale)
                    .with_context(|| format!("cannot remove {}", stale.display()))?;
            }
            std::fs::create_dir_all(&input.dir)
                .with_context(|| format!("cannot make {}", input.dir.display()))?;
            record = json!({"key": key});
            page::write(&path, &record.to_string())?;
        }
        let is_kept = !record["value"].is_null();
        if self.paths.insert(path.clone()) {
            let note = if is_kept { " (kept)" } else { "" };
            eprintln!(
                "[{}/{}] {}: {what}{note}",
                self.paths.len(),
                self.counted.len(),
                input.name
            );
        }
        if !is_kept {
            record["value"] = measure(program)?;
            record["date"] = json!(output(&self.root, "date", &["-u", "+%F"])?.trim());
            page::write(&path, &record.to_string())?;
        }
        self.date = record["date"]
            .as_str()
            .unwrap_or_default()
            .max(&self.date)
            .to_owned();
        Ok(record["value"].take())
    }
}

/// The laboratory, which is also the program that it measures.
pub(super) struct Program(PathBuf);

impl Program {
    /// What `minute4d` prints with the arguments that `arguments` adds.
    pub(super) fn run(
        &self,
        arguments: impl FnOnce(&mut Command) -> &mut Command,
    ) -> Result<String> {
        printed(arguments(
            Command::new(&self.0).arg(crate::program::MINUTE4D),
        ))
    }

    /// What the laboratory prints with the arguments that `arguments` adds.
    pub(super) fn lab(
        &self,
        arguments: impl FnOnce(&mut Command) -> &mut Command,
    ) -> Result<String> {
        printed(arguments(&mut Command::new(&self.0)))
    }

    /// The result among the events that the laboratory prints with `--json`.
    pub(super) fn result(
        &self,
        arguments: impl FnOnce(&mut Command) -> &mut Command,
    ) -> Result<Value> {
        let lines = self.lab(|c| arguments(c).arg("--json"))?;
        let mut events = lines
            .lines()
            .filter_map(|line| serde_json::from_str::<Value>(line).ok());
        let event = events
            .find(|event| event["event"] == "result")
            .context("the program printed no result")?;
        Ok(event["result"].clone())
    }
}

/// The option for a run that leaves `record`: to continue where there is one, which is of the same
/// commit.
pub(super) fn continuing(record: &Path) -> &'static str {
    if record.is_file() {
        "--resume"
    } else {
        "--force"
    }
}

/// A file of JSON.
pub(super) fn read(path: &Path) -> Result<Value> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{} is not JSON", path.display()))
}
