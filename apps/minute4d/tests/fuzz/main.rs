//! Every reader of files against earlier findings, malformed headers and random mutations, in
//! processes whose memory is limited. `fuzz/` takes the same table through libFuzzer, a target per
//! family; functions here panic where the fixtures are missing.
//!
//! ```text
//! table     all readers of m4_io and of the program itself: a name, a file among others, valid contents, the call
//! reader    one of them: its folder, the bytes put where they belong, the outcome; whether what was read is valid, and if not, the fault
//! files     fixtures, earlier findings, and what bytes are wrapped in so that mutations get past checksums
//! numbers   valid files with an extreme number in each field
//! malformed valid files with extremes in each field of the header, truncated, or mutated at random
//! process   the process that reads within a limit of memory, and the one that watches it
//! ```
//!
//! A panic, an abort, something that is not valid, a message that quotes the file, much memory or
//! much time fails with the name of the reader; the input is saved below `target`. The allocator
//! counts for the whole process, so this is a program of its own.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

mod files;
mod malformed;
mod numbers;
mod process;
mod reader;
mod table;

use files::{CORPUS, corpus};
use m4_testkit::repository;
use malformed::{malformed, mutated};
use peak_alloc::PeakAlloc;
use process::{Meter, Report, watch, work};
use reader::{Outcome, Reader, Stage};
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::{env, fs, thread};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

const READER: &str = "MINUTE4D_FUZZ_READER";
const FOLDER: &str = "MINUTE4D_FUZZ_FOLDER";
const MALFORMED: usize = 300;
const MUTATED: usize = 100;

/// Earlier findings, valid files, and those with extreme numbers and malformed ones made of them.
fn inputs(stage: &Stage<'_>) -> Box<dyn Iterator<Item = (String, Vec<u8>)>> {
    let files = corpus(stage.reader().name).unwrap();
    let inputs = files
        .into_iter()
        .map(|(name, bytes)| (format!("corpus/{name}"), bytes));
    let seeds = stage.seeds().to_vec();
    let (most, mutations) = (MALFORMED / seeds.len().min(3), MUTATED / seeds.len().max(1));
    let valid = seeds
        .clone()
        .into_iter()
        .enumerate()
        .map(|(i, bytes)| (format!("seed {i}"), bytes));
    Box::new(
        inputs
            .chain(valid)
            .chain(
                seeds
                    .clone()
                    .into_iter()
                    .flat_map(|seed| numbers::extremes(&seed)),
            )
            .chain(
                seeds
                    .clone()
                    .into_iter()
                    .flat_map(move |seed| malformed(seed, most)),
            )
            .chain(
                seeds
                    .into_iter()
                    .flat_map(move |seed| mutated(seed, mutations)),
            ),
    )
}

fn named(name: &str) -> Reader {
    table::readers()
        .into_iter()
        .find(|r| r.name == name)
        .unwrap()
}

/// The process that reads: does nothing where it is not asked to.
#[test]
fn one_reader_within_limits() {
    let Ok(name) = env::var(READER) else { return };
    let meter = Meter {
        reset: || MEMORY.reset_peak_usage(),
        peak: || MEMORY.peak_usage(),
        now: || MEMORY.current_usage(),
    };
    let folder = PathBuf::from(env::var(FOLDER).unwrap());
    work(&named(&name), &folder, inputs, meter).unwrap();
}

fn replayed(name: &str, folder: &Path) -> Report {
    let mut command = Command::new(env::current_exe().unwrap());
    command.args(["--exact", "one_reader_within_limits", "--nocapture"]);
    command.env(READER, name).env(FOLDER, folder);
    watch(name, folder, command).unwrap()
}

#[test]
fn no_reader_fails_on_malformed_files() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("findings");
    fs::create_dir_all(&folder).unwrap();
    let names: Vec<&str> = table::readers().iter().map(|r| r.name).collect();
    let (next, reports) = (Mutex::new(names.iter()), Mutex::new(Vec::new()));
    let threads = thread::available_parallelism()
        .map_or(1, usize::from)
        .min(8);
    thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let Some(name) = next.lock().unwrap().next() else {
                        break;
                    };
                    let report = replayed(name, &folder);
                    reports.lock().unwrap().push((*name, report));
                }
            });
        }
    });
    let reports = reports.into_inner().unwrap();
    assert_eq!(reports.len(), names.len());
    let executions: usize = reports.iter().map(|(_, r)| r.executions).sum();
    println!("{} readers, {executions} files", reports.len());
    let findings: Vec<String> = reports
        .iter()
        .flat_map(|(name, r)| r.findings.iter().map(move |f| (name, f)))
        .map(|(name, f)| format!("{name}: {}: {} ({})", f.input, f.why, f.saved.display()))
        .collect();
    assert!(
        findings.is_empty(),
        "{} findings:\n{}",
        findings.len(),
        findings.join("\n")
    );
    // malformed files that are all taken, or all refused with the valid ones, test nothing
    let idle: Vec<String> = reports
        .iter()
        .filter(|(_, r)| r.executions < 60 || r.refused * 10 < r.executions || r.read == 0)
        .map(|(name, r)| {
            format!(
                "{name}: {} files, {} read, {} refused",
                r.executions, r.read, r.refused
            )
        })
        .collect();
    assert!(
        idle.is_empty(),
        "do the mutations reach these readers?\n{}",
        idle.join("\n")
    );
}

#[test]
fn every_valid_file_is_read_and_names_are_unique() {
    let (mut names, mut refused) = (HashSet::new(), Vec::new());
    for reader in table::readers() {
        assert!(names.insert(reader.name), "{} twice", reader.name);
        let stage = reader.stage().unwrap();
        assert!(!stage.seeds().is_empty(), "{}", reader.name);
        for (i, seed) in stage.seeds().iter().enumerate() {
            assert!(!seed.is_empty(), "{}: seed {i} is empty", reader.name);
            let outcome = stage.read(seed).unwrap();
            if outcome != Outcome::Read {
                refused.push(format!("{}, seed {i}: {outcome:?}", reader.name));
            }
        }
    }
    assert!(refused.is_empty(), "{}", refused.join("\n"));
    assert!(names.len() >= 60, "{}", names.len());
}

#[test]
fn every_folder_of_the_corpus_is_of_a_reader_and_every_target_of_a_family() {
    let names: HashSet<String> = table::readers().iter().map(|r| r.name.to_owned()).collect();
    if let Ok(entries) = fs::read_dir(repository().join(CORPUS)) {
        for entry in entries {
            let name = entry.unwrap().file_name().to_string_lossy().into_owned();
            assert!(names.contains(&name), "corpus/{name} is of no reader");
        }
    }
    let families: HashSet<String> = table::families().into_iter().map(str::to_owned).collect();
    let targets: HashSet<String> = fs::read_dir(repository().join("fuzz/fuzz_targets"))
        .unwrap()
        .map(|e| {
            e.unwrap()
                .path()
                .file_stem()
                .unwrap()
                .to_string_lossy()
                .into_owned()
        })
        .collect();
    assert_eq!(targets, families, "a target a family");
}
