//! `cargo xtask test`: runs the tests and lists the skipped ones.
//!
//! Tests that lack something on this machine return early and add a line to the file that
//! `MINUTE4D_SKIPPED` names (`m4_testkit::skip`). The harness hides what they print; this program
//! prints the lines when everything has run.

#![expect(clippy::print_stderr, reason = "skipped tests are listed")]

use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// What the tests of the default program leave out: networks. Without features nothing of GPUs is
/// compiled.
const DEFAULT: [&str; 3] = ["--workspace", "--exclude", "m4_nets"];
/// What `full` adds to the program, with the crates whose tests it changes.
const FULL: [&str; 16] = [
    "--package",
    "m4_kernels",
    "--package",
    "m4_train",
    "--package",
    "m4_nets",
    "--package",
    "minute4d",
    "--package",
    "minute4d_eval",
    "--package",
    "minute4d_cli",
    "--package",
    "minute4d_lab",
    "--features",
    "minute4d_cli/full,minute4d_lab/full,m4_nets/gpu",
];

/// Compiles in one unit what most of the time of the tests is spent in, so that everything can be
/// inlined. Not in Cargo.toml: who changes one of these crates and runs its tests alone wants only
/// the changed parts compiled.
const ONE_UNIT: [&str; 6] = [
    "--config",
    "profile.dev.package.m4_geometry.codegen-units=1",
    "--config",
    "profile.dev.package.m4_nets.codegen-units=1",
    "--config",
    "profile.dev.package.m4_train.codegen-units=1",
];

/// Programs of the default tests that run at a time: many end with one long test.
const AT_A_TIME: usize = 2;
/// The same of what `full` adds: those of GPUs mostly wait for the one thread that compiles
/// kernels.
const AT_A_TIME_FULL: usize = 3;

/// What to run, and what must not be missing.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Tests {
    /// What `full` adds, instead of the tests of the default program.
    pub full: bool,
    /// Needs (`m4_testkit::Need`) for whose lack no test may be skipped.
    pub required: BTreeSet<String>,
    /// Further arguments of `cargo test`, such as the names of tests.
    pub more: Vec<String>,
}

impl Tests {
    /// Reads `[--full] [--require NEED,...] [-- ARGUMENT...]`.
    pub fn of_arguments(words: &[&str]) -> Result<Self> {
        let mut tests = Self::default();
        let mut words = words.iter();
        while let Some(&word) = words.next() {
            match word {
                "--full" => tests.full = true,
                "--require" => {
                    let needs = words
                        .next()
                        .context("--require wants names, such as ffmpeg,chromium")?;
                    tests.required.extend(needs.split(',').map(str::to_owned));
                }
                "--" => tests
                    .more
                    .extend(words.by_ref().map(|&word| word.to_owned())),
                other => bail!(
                    "{other}: expected --full, --require NEED,... or -- and arguments of cargo test"
                ),
            }
        }
        Ok(tests)
    }
}

/// A test, or a part of one, that could not run.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Skipped {
    /// The missing requirement.
    pub need: String,
    /// How to install it.
    pub hint: String,
    /// The test.
    pub test: String,
    /// File and line.
    pub place: String,
    /// The observation.
    pub why: String,
}

/// Runs the tests and prints the skipped ones.
pub fn run(root: &Path, tests: &Tests) -> Result<()> {
    let list = root.join("target/skipped-tests.tsv");
    // Absent where CARGO_TARGET_DIR names another folder.
    std::fs::create_dir_all(root.join("target")).context("cannot create target")?;
    if let Err(error) = std::fs::remove_file(&list)
        && error.kind() != std::io::ErrorKind::NotFound
    {
        return Err(error).with_context(|| format!("cannot remove {}", list.display()));
    }
    let result = if tests.full {
        what_full_adds(root, &list, &tests.more)
    } else if tests.more.is_empty() {
        default_tests(root, &list)
    } else {
        let mut command = cargo(root, &["test", "--no-fail-fast"]);
        command
            .args(DEFAULT)
            .args(&tests.more)
            .env("MINUTE4D_SKIPPED", &list);
        ended(command, "cargo test")
    };
    let text = match std::fs::read_to_string(&list) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
        text => text.with_context(|| format!("cannot read {}", list.display()))?,
    };
    let skipped = parse(&text)?;
    eprint!("{}", summary(&skipped));
    result?;
    lacking(&skipped, &tests.required)
}

/// Reads the lines that tests left, each once.
pub fn parse(text: &str) -> Result<Vec<Skipped>> {
    let lines: Result<BTreeSet<Skipped>> = text
        .lines()
        .map(|line| match line.split('\t').collect::<Vec<_>>()[..] {
            [need, hint, test, place, why] => Ok(Skipped {
                need: need.to_owned(),
                hint: hint.to_owned(),
                test: test.to_owned(),
                place: place.to_owned(),
                why: why.to_owned(),
            }),
            _ => bail!("{line:?} is not a line of a skipped test"),
        })
        .collect();
    Ok(lines?.into_iter().collect())
}

/// The skipped tests by missing requirement; the end of a run of tests.
pub fn summary(skipped: &[Skipped]) -> String {
    if skipped.is_empty() {
        return "\nEvery test could run on this machine.\n".to_owned();
    }
    let mut needs: BTreeMap<&str, Vec<&Skipped>> = BTreeMap::new();
    for one in skipped {
        needs.entry(&one.need).or_default().push(one);
    }
    let names: BTreeSet<&str> = skipped.iter().map(|s| s.test.as_str()).collect();
    let mut out = format!(
        "\nNOT TESTED on this machine, wholly or in part: {} tests\n",
        names.len()
    );
    for (need, tests) in needs {
        let hint = tests.first().map_or("", |s| s.hint.as_str());
        // Writing to a string does not fail.
        let _ = writeln!(out, "  for want of {need}: {hint}");
        for test in tests {
            let _ = writeln!(out, "    {} ({}): {}", test.test, test.place, test.why);
        }
    }
    out
}

/// Fails where a test was skipped for the lack of something that must be there.
pub fn lacking(skipped: &[Skipped], required: &BTreeSet<String>) -> Result<()> {
    let missing: BTreeSet<&str> = skipped.iter().map(|s| s.need.as_str()).collect();
    let missing: Vec<&str> = missing
        .into_iter()
        .filter(|need| required.contains(*need))
        .collect();
    if missing.is_empty() {
        return Ok(());
    }
    bail!(
        "tests were skipped for want of {}, which must be there",
        missing.join(", ")
    )
}

/// The programs that run longest, the longest first: they start before others.
const LONGEST: [&str; 8] = [
    "m4_nets (test it)",
    "m4_train (test gpu)",
    "m4_nets (lib m4_nets)",
    "minute4d_cli (test it)",
    "minute4d_lab (test it)",
    "m4_geometry (lib m4_geometry)",
    "m4_geometry (test it)",
    "m4_io (test it)",
];
/// Runs after the others: it moves fingers and the mouse over the page, which a busy machine
/// mistakes for other gestures.
const ALONE: &str = "xtask (test it)";

/// A program of tests.
#[derive(Debug)]
struct Program {
    /// Package and target.
    name: String,
    path: PathBuf,
    /// The package's folder, where cargo would start it.
    folder: PathBuf,
}

/// Runs the tests of the default program, and the examples of its documentation.
fn default_tests(root: &Path, list: &Path) -> Result<()> {
    let programs = programs(root, &DEFAULT, &[])?;
    let ran = run_programs(
        programs
            .into_iter()
            .map(|program| (program, Vec::new()))
            .collect(),
        AT_A_TIME,
        list,
    );
    let mut examples = cargo(root, &["test", "--doc", "--no-fail-fast"]);
    examples.args(DEFAULT);
    let examples = ended(examples, "cargo test --doc");
    ran.and(examples)
}

/// Runs the tests that are not among those of the default program: all of networks and GPUs, and of
/// the program those that exist with its features only.
fn what_full_adds(root: &Path, list: &Path, more: &[String]) -> Result<()> {
    let before: BTreeSet<(String, String)> = programs(root, &DEFAULT, more)?
        .iter()
        .map(|program| {
            Ok(names(program)?
                .into_iter()
                .map(|test| (program.name.clone(), test))
                .collect())
        })
        .collect::<Result<Vec<Vec<_>>>>()?
        .into_iter()
        .flatten()
        .collect();
    let mut waiting = Vec::new();
    for program in programs(root, &FULL, more)? {
        let new: Vec<String> = names(&program)?
            .into_iter()
            .filter(|test| !before.contains(&(program.name.clone(), test.clone())))
            .collect();
        if !new.is_empty() {
            waiting.push((program, new));
        }
    }
    run_programs(waiting, AT_A_TIME_FULL, list)
}

/// Runs tests of programs, all where none are named: the longest first, and at last the program
/// that needs the machine for itself.
fn run_programs(
    programs: Vec<(Program, Vec<String>)>,
    at_a_time: usize,
    list: &Path,
) -> Result<()> {
    let (alone, others): (Vec<_>, Vec<_>) = programs
        .into_iter()
        .partition(|(program, _)| program.name == ALONE);
    let first = run_several(others, at_a_time, list);
    first.and(run_several(alone, 1, list))
}

/// Runs programs, `at_a_time` at once.
fn run_several(
    mut waiting: Vec<(Program, Vec<String>)>,
    at_a_time: usize,
    list: &Path,
) -> Result<()> {
    // The last is taken first.
    waiting.sort_by_key(|(program, _)| LONGEST.iter().rev().position(|&name| name == program.name));
    let waiting = Mutex::new(waiting);
    let failed = Mutex::new(Vec::new());
    let next = || waiting.lock().unwrap_or_else(PoisonError::into_inner).pop();
    std::thread::scope(|scope| {
        for _ in 0..at_a_time {
            scope.spawn(|| {
                while let Some((program, names)) = next() {
                    if let Err(error) = run_alone(&program, &names, list) {
                        eprintln!("{error:#}");
                        failed
                            .lock()
                            .unwrap_or_else(PoisonError::into_inner)
                            .push(program.name);
                    }
                }
            });
        }
    });
    let failed = failed.into_inner().unwrap_or_else(PoisonError::into_inner);
    match failed.is_empty() {
        true => Ok(()),
        false => bail!("tests failed in {}", failed.join(", ")),
    }
}

/// Runs these tests of a program, or all, and prints its output when it ends, so that outputs of
/// several programs do not mix.
fn run_alone(program: &Program, names: &[String], list: &Path) -> Result<()> {
    eprintln!("     Running {}", program.name);
    let mut command = Command::new(&program.path);
    if !names.is_empty() {
        command.arg("--exact").args(names);
    }
    let started = Instant::now();
    let output = command
        .current_dir(&program.folder)
        .env("CARGO_MANIFEST_DIR", &program.folder)
        .env("MINUTE4D_SKIPPED", list)
        .output()
        .with_context(|| format!("cannot start {}", program.name))?;
    let text =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    let seconds = started.elapsed().as_secs();
    eprintln!(
        "     Ended: {} after {seconds} s\n{}",
        program.name,
        text.concat()
    );
    if output.status.success() {
        Ok(())
    } else {
        bail!("{} ended with {}", program.name, output.status)
    }
}

/// Builds the programs of tests of a selection of packages; warnings are errors.
fn programs(root: &Path, selection: &[&str], more: &[String]) -> Result<Vec<Program>> {
    let mut command = cargo(
        root,
        &[
            "test",
            "--lib",
            "--bins",
            "--tests",
            "--no-run",
            "--message-format=json",
        ],
    );
    command
        .args(selection)
        .args(more)
        .stdout(Stdio::piped())
        .stderr(Stdio::inherit());
    let mut build = command.spawn().context("cannot start cargo")?;
    let (mut programs, mut warned) = (Vec::new(), false);
    for line in BufReader::new(build.stdout.take().context("cargo has no output")?).lines() {
        let Ok(message) =
            serde_json::from_str::<Value>(&line.context("cannot read the output of cargo")?)
        else {
            continue;
        };
        if let Some(rendered) = message["message"]["rendered"].as_str() {
            eprint!("{rendered}");
            warned |= message["message"]["level"] == "warning";
        }
        programs.extend(program(root, &message));
    }
    let status = build.wait().context("cargo did not end")?;
    if !status.success() {
        bail!("the tests cannot be built: cargo ended with {status}");
    }
    if warned {
        bail!("the compiler warns (above); warnings are errors here");
    }
    Ok(programs)
}

/// The program of tests that a message of cargo announces.
fn program(root: &Path, message: &Value) -> Option<Program> {
    let is_test = message["reason"] == "compiler-artifact" && message["profile"]["test"] == true;
    let text = |value: &Value| value.as_str().map(str::to_owned);
    let path = text(&message["executable"]).filter(|_| is_test)?;
    let folder = Path::new(message["manifest_path"].as_str()?)
        .parent()
        .unwrap_or(root)
        .to_path_buf();
    let (target, kind) = (
        text(&message["target"]["name"])?,
        text(&message["target"]["kind"][0])?,
    );
    // `path+file:///folder#name@version`, or `...#version` where the folder has the package's name
    let id = text(&message["package_id"])?;
    let name = id
        .rsplit_once('#')
        .and_then(|(_, name)| name.split_once('@'));
    let package = match name {
        Some((name, _)) => name.to_owned(),
        None => folder.file_name()?.to_string_lossy().into_owned(),
    };
    Some(Program {
        name: format!("{package} ({kind} {target})"),
        path: path.into(),
        folder,
    })
}

/// The names of a program's tests that are not ignored.
fn names(program: &Program) -> Result<Vec<String>> {
    let listed = |ignored: bool| -> Result<BTreeSet<String>> {
        let mut command = Command::new(&program.path);
        command.args(["--list", "--format", "terse"]);
        if ignored {
            command.arg("--ignored");
        }
        let output = command
            .current_dir(&program.folder)
            .output()
            .with_context(|| format!("cannot start {}", program.path.display()))?;
        if !output.status.success() {
            bail!("{} cannot list its tests", program.name);
        }
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        Ok(text
            .lines()
            .filter_map(|line| line.strip_suffix(": test"))
            .map(str::to_owned)
            .collect())
    };
    Ok(listed(false)?.difference(&listed(true)?).cloned().collect())
}

fn cargo(root: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.args(ONE_UNIT).args(arguments).current_dir(root);
    command
}

fn ended(mut command: Command, name: &str) -> Result<()> {
    let status = command
        .status()
        .with_context(|| format!("cannot start {name}"))?;
    if status.success() {
        Ok(())
    } else {
        bail!("{name} ended with {status}")
    }
}
