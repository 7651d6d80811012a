//! `cargo xtask check`: every check that CI runs, in one program.
#![forbid(unsafe_code)]
#![expect(clippy::print_stderr, reason = "a program that reports to a terminal")]

use anyhow::{Context, Result, bail};
use std::path::Path;
use std::process::{Command, ExitCode};
use std::time::Instant;

const USAGE: &str = "usage: cargo xtask <test [--full] [--require NEED,...] [-- ARGUMENT...] | check [--skip-tests] | arrows | text | lock | deny | page | settings [--check] | wheel | archive>

  test    the tests of the default program, and at the end what could not run here and why; --full: what networks and GPUs add to
          them; --require ffmpeg,chromium,vulkan,...: fail where a test was skipped for want of these (docs/building.md)
  check   fmt, clippy, docs, arrows, lock, deny and tests, as CI does
  arrows  dependencies between crates against the table of ARCHITECTURE.md, and no cycle among the modules of a crate
  text    widths of comments and Markdown, lengths of files
  lock    no git sources in Cargo.lock
  deny    cargo-deny: licences, sources, duplicate versions, and advisories where their database can be fetched
  page    build the viewer's page from crates/m4_viewer/page (needs npm)
  settings  write the ranges and defaults in docs/settings.md from the code; --check: fail where it is not up to date
  wheel   build the Python package with the program as it is shipped, and test it in a fresh environment (needs Python with venv)
  archive build the same program, and pack it with licences, man pages and completions";

/// The features that are linted and documented beside the default ones.
const FULL: [&str; 2] = [
    "--features",
    "minute4d_cli/full,minute4d_lab/full,m4_nets/gpu",
];

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let root = xtask::root();
    let result = match args[..] {
        ["test", ref words @ ..] => {
            xtask::tests::Tests::of_arguments(words).and_then(|t| xtask::tests::run(&root, &t))
        }
        ["check"] => check(&root, true),
        ["check", "--skip-tests"] => check(&root, false),
        ["arrows"] => step("arrows", || arrows(&root)),
        ["text"] => step("text", || xtask::text::check(&root)),
        ["lock"] => step("lock", || xtask::arrows::check_lock(&root)),
        ["deny"] => step("deny", || deny(&root)),
        ["page"] => step("page", || {
            xtask::page::build(&root, &root.join("target/page"))
        }),
        ["settings"] => step("settings", || settings(&root, true)),
        ["settings", "--check"] => step("settings", || settings(&root, false)),
        ["wheel"] => step("wheel", || show(xtask::wheel::make(&root))),
        ["archive"] => step("archive", || show(xtask::archive::make(&root))),
        _ => {
            eprintln!("{USAGE}");
            return ExitCode::from(2);
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("xtask: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Everything that CI runs. Tests come last, so that a log ends with their summary.
fn check(root: &Path, tests: bool) -> Result<()> {
    step("fmt", || {
        cargo(root, &["fmt", "--all", "--", "--check"], &[])
    })?;
    step("arrows", || arrows(root))?;
    step("text", || xtask::text::check(root))?;
    step("lock", || xtask::arrows::check_lock(root))?;
    step("deny", || deny(root))?;
    let lints = ["clippy", "--workspace", "--all-targets"];
    let deny_warnings = ["--", "-D", "warnings"];
    // Of all features: without them, what the compiler warns of is an error when the tests are
    // built.
    step("clippy", || {
        cargo(root, &[&lints[..], &FULL, &deny_warnings].concat(), &[])
    })?;
    let docs = [
        "doc",
        "--workspace",
        "--no-deps",
        "--document-private-items",
    ];
    // The browser is not documented: with its feature, packages of others have the features that
    // clippy checked them with.
    let features = [FULL[0], &format!("{},m4_testkit/browser", FULL[1])];
    step("docs", || {
        cargo(
            root,
            &[&docs[..], &features].concat(),
            &[("RUSTDOCFLAGS", "-D warnings")],
        )
    })?;
    if tests {
        for full in [false, true] {
            let tests = xtask::tests::Tests {
                full,
                ..Default::default()
            };
            step(
                if full {
                    "tests of all features"
                } else {
                    "tests"
                },
                || xtask::tests::run(root, &tests),
            )?;
        }
    }
    Ok(())
}

/// The page of settings, by the tests of the crate whose settings they are.
fn settings(root: &Path, write: bool) -> Result<()> {
    let env: &[(&str, &str)] = if write {
        &[("MINUTE4D_WRITE_SETTINGS", "1")]
    } else {
        &[]
    };
    cargo(
        root,
        &[
            "test",
            "--quiet",
            "-p",
            "minute4d",
            "--lib",
            "settings::page",
        ],
        env,
    )
}

/// Between crates, and between the modules of each.
fn arrows(root: &Path) -> Result<()> {
    xtask::arrows::check(root)?;
    xtask::modules::check(root)
}

/// Prints the path of what was built.
fn show(built: Result<std::path::PathBuf>) -> Result<()> {
    eprintln!("    {}", built?.display());
    Ok(())
}

fn step(name: &str, run: impl FnOnce() -> Result<()>) -> Result<()> {
    eprintln!("==> {name}");
    let start = Instant::now();
    run().with_context(|| format!("{name} failed"))?;
    eprintln!("==> {name} ok, {:.1} s", start.elapsed().as_secs_f64());
    Ok(())
}

fn cargo(root: &Path, args: &[&str], env: &[(&str, &str)]) -> Result<()> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let status = Command::new(cargo)
        .args(args)
        .envs(env.iter().copied())
        .current_dir(root)
        .status()
        .context("cannot start cargo")?;
    if status.success() {
        Ok(())
    } else {
        bail!("cargo {} ended with {status}", args.join(" "))
    }
}

/// Runs cargo-deny, and says so where its database of advisories cannot be fetched.
fn deny(root: &Path) -> Result<()> {
    let installed = Command::new("cargo-deny")
        .arg("--version")
        .output()
        .is_ok_and(|o| o.status.success());
    if !installed {
        bail!(
            "cargo-deny is not installed: cargo install cargo-deny --locked, or let .ci/run fetch it"
        );
    }
    let checked = |what: &[&str]| {
        cargo(
            root,
            &[
                &["deny", "--locked", "check", "--hide-inclusion-graph"],
                what,
            ]
            .concat(),
            &[],
        )
    };
    checked(&["bans", "licenses", "sources"])?;
    let fetched = Command::new("cargo-deny")
        .args(["fetch", "db"])
        .current_dir(root)
        .output();
    match fetched.context("cannot start cargo-deny")? {
        output if output.status.success() => checked(&["advisories"]),
        output => {
            let reason = String::from_utf8_lossy(&output.stderr).trim().to_owned();
            eprintln!(
                "    NOT CHECKED on this machine: advisories, whose database cannot be fetched:\n{reason}"
            );
            Ok(())
        }
    }
}
