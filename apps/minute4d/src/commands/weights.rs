//! `minute4d weights`: lists, downloads, adds and verifies network weights.

use crate::failure::Failure;
use crate::output::Output;
use clap::{Args, Subcommand};
use minute4d::weights::{self, Condition, Entry, Network, Record, Store, WeightsError};
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
    /// Download weights from their authors' hosts, verify and install them
    ///
    /// An interrupted download continues with the same command. Variables of the environment:
    /// HTTPS_PROXY, ALL_PROXY and NO_PROXY; HF_ENDPOINT (a mirror of Hugging Face), HF_TOKEN (sent
    /// there alone) and HF_HUB_OFFLINE.
    Fetch {
        /// Names from the list, or a set: `recommended` (for most clips; commercial use is
        /// allowed), `paper` (the paper's own chain)
        #[arg(required = true, value_name = "NAME")]
        names: Vec<String>,
        /// Agree to a licence that forbids commercial use
        #[arg(long)]
        accept_license: bool,
        /// Say what would be downloaded, and use no network
        #[arg(long)]
        dry_run: bool,
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
    let store = Store::of_user()?;
    match &args.action {
        WeightsAction::List => list(&store, output),
        WeightsAction::Fetch {
            names,
            accept_license,
            dry_run,
        } => {
            let entries = select(names)?;
            match dry_run {
                true => plan(&entries, &store, *accept_license, output),
                false => fetch(&entries, &store, *accept_license, output),
            }
        }
        WeightsAction::Add {
            name,
            file,
            accept_license,
        } => {
            let record = weights::add(weights::find(name)?, &store, file, *accept_license)?;
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

/// The entries of names and sets, each once.
fn select(names: &[String]) -> Result<Vec<&'static Entry>, Failure> {
    let mut entries: Vec<&Entry> = Vec::new();
    for name in names {
        for entry in weights::select(name)? {
            if !entries.iter().any(|other| other.name == entry.name) {
                entries.push(entry);
            }
        }
    }
    Ok(entries)
}

fn fetch(
    entries: &[&'static Entry],
    store: &Store,
    accept_license: bool,
    output: &Output,
) -> Result<(), Failure> {
    // every licence before the first download
    for entry in entries {
        weights::check_licence(entry, accept_license)?;
    }
    let network = Network::of_user();
    let mut records = Vec::new();
    for entry in entries {
        if store.installed(entry).is_none() {
            let url = network.url(&entry.origin);
            let (name, licence) = (entry.name, entry.licence);
            output.note(&format!(
                "{name}: {} from {url}, licence: {licence}",
                size(entry)
            ));
        }
        let record = weights::fetch(entry, store, &network, accept_license, output);
        records.push(record.map_err(|error| or_by_hand(entry, error))?);
    }
    report_installed(store, &records, output)
}

/// The size in MB, which is an estimate where only the number of weights is known.
fn size(entry: &Entry) -> String {
    match entry.bytes {
        Some(bytes) => format!("{:.1} MB", bytes as f64 / 1e6),
        None => format!("about {} MB", entry.megabytes),
    }
}

/// A row of a `fetch --dry-run`.
#[derive(Debug, Serialize)]
struct Planned {
    #[serde(flatten)]
    entry: &'static Entry,
    url: String,
    installed: bool,
    /// Whether its licence forbids commercial use and was not accepted.
    needs_consent: bool,
}

fn plan(
    entries: &[&'static Entry],
    store: &Store,
    accept_license: bool,
    output: &Output,
) -> Result<(), Failure> {
    let network = Network::of_user();
    let planned: Vec<Planned> = entries
        .iter()
        .map(|entry| Planned {
            entry,
            url: network.url(&entry.origin),
            installed: store.installed(entry).is_some(),
            needs_consent: weights::check_licence(entry, accept_license).is_err(),
        })
        .collect();
    let mut text = String::new();
    for row in &planned {
        let Entry { name, licence, .. } = row.entry;
        let what = match row.installed {
            true => "is installed, and would be fetched again if it is damaged".to_owned(),
            false => format!("{} from {}", size(row.entry), row.url),
        };
        let checksum = match row.entry.sha256 {
            Some(sha256) => format!("SHA-256 {sha256}"),
            None => "no checksum is known here: the host's counts, or else the first download is trusted"
                .to_owned(),
        };
        let consent = match row.needs_consent {
            true => ", which forbids commercial use (--accept-license)",
            false => "",
        };
        text += &format!("{name}: {what}; licence: {licence}{consent}; {checksum}\n");
    }
    let missing = planned.iter().filter(|row| !row.installed);
    let megabytes: u32 = missing.map(|row| row.entry.megabytes).sum();
    text += &format!(
        "about {megabytes} MB to download into {}\n",
        store.root().display()
    );
    Ok(output.result(&text, &planned)?)
}

/// The failure of a download, with the command that installs a file got by hand.
fn or_by_hand(entry: &Entry, error: WeightsError) -> Failure {
    let helps = matches!(
        &error,
        WeightsError::Refused(refusal)
            if matches!(refusal.category, Category::NoInput | Category::TryAgain)
    );
    let mut failure = Failure::from(error);
    if helps {
        failure.reason += &format!(
            "; `minute4d weights add {} FILE` installs a file",
            entry.name
        );
    }
    failure
}

#[derive(Debug, Serialize)]
struct Row {
    #[serde(flatten)]
    entry: &'static Entry,
    /// The command that installs it.
    command: String,
    origin: String,
    /// The file, if it is installed.
    path: Option<PathBuf>,
}

fn list(store: &Store, output: &Output) -> Result<(), Failure> {
    let row = |entry: &'static Entry| Row {
        entry,
        command: crate::failure::command(entry),
        origin: entry.origin.description(),
        path: store.installed(entry),
    };
    let rows: Vec<Row> = weights::all().iter().map(row).collect();
    let mut text = format!(
        "{:<24} {:>7}  {:<4} {:<38} used for\n",
        "name", "MB", "here", "licence"
    );
    for Row { entry, path, .. } in &rows {
        let size = match entry.bytes {
            Some(bytes) => format!("{:.1}", bytes as f64 / 1e6),
            None => format!("~{}", entry.megabytes),
        };
        let here = if path.is_some() { "yes" } else { "no" };
        let only = if entry.commercial {
            ""
        } else {
            "non-commercial: "
        };
        let licence = format!("{only}{}", entry.licence);
        text += &format!(
            "{:<24} {size:>7}  {here:<4} {licence:<38} {}\n",
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
    for (set, names) in weights::SETS {
        text += &format!("set {set}: {}\n", names.join(", "));
    }
    text += &format!("folder: {}\n", store.root().display());
    Ok(output.result(&text, &rows)?)
}

/// Reports which weights were installed, where, and under which licence.
fn report_installed(store: &Store, records: &[Record], output: &Output) -> Result<(), Failure> {
    let mut text = String::new();
    for record in records {
        let path = store.root().join(&record.name).join(&record.file);
        let checked = match record.published {
            true => "as published",
            false => "which nobody published: trusted, recorded and compared from now on",
        };
        text += &format!(
            "{}: {} ({} bytes, SHA-256 {} {checked}), licence: {}\n",
            record.name,
            path.display(),
            record.bytes,
            record.sha256,
            record.licence
        );
    }
    Ok(output.result(&text, &records)?)
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
            .map(|name| weights::find(name))
            .collect::<Result<_, _>>()?,
    };
    let mut files = Vec::new();
    for entry in entries {
        let (condition, reason) = match store.verify(entry)? {
            Condition::Published => ("published", None),
            Condition::AsAdded => ("as added", None),
            Condition::Unknown => ("unknown", None),
            Condition::Damaged { reason } => ("damaged", Some(reason)),
            Condition::Absent => {
                return Err(store
                    .require(entry)
                    .err()
                    .unwrap_or(WeightsError::NoFolder)
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
        &files,
    )?;
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
