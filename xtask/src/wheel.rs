//! `cargo xtask wheel`: the Python package with the program, and its tests in an environment that
//! has nothing else.

use crate::command::{host, metadata, run, target_folder};
use crate::licences;
use anyhow::{Context, Result};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What builds the wheel.
const MATURIN: &str = "maturin==1.16.0";
/// What compiles and links for the C library of old systems.
const ZIG: &str = "ziglang==0.17.1";
/// Intel since 2008, AMD since 2011; what newer ones add is chosen when the program runs.
const X86_64: &str = "-C target-cpu=x86-64-v2";
/// What tests the wheel, in the folder of the package.
const TESTS: &str = "tests/requirements.txt";

/// What a build gives.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Built {
    /// The wheel.
    pub wheel: PathBuf,
    /// The program in it, as the compiler left it.
    pub program: PathBuf,
}

/// Builds the wheel and installs it in a fresh environment, where it must pass its tests. Returns
/// the wheel's path.
///
/// # Errors
///
/// As [`build`]; a test fails.
pub fn make(root: &Path) -> Result<PathBuf> {
    let metadata = metadata(root)?;
    let wheel = build(root, &metadata, &host()?)?.wheel;
    let python = root.join("python");
    let listed = python.join(TESTS);
    let tests = environment(
        &folder(&metadata)?.join("tests"),
        &["-r", &listed.to_string_lossy()],
    )?;
    let in_tests = || {
        let mut command = Command::new(program_in(&tests, "python"));
        command.current_dir(&python).arg("-m");
        command
    };
    run(in_tests().args(["pip", "install", "--quiet"]).arg(&wheel))?;
    run(in_tests().arg("mypy"))?;
    run(in_tests().args(["pytest", "--quiet", "tests"]))?;
    Ok(wheel)
}

/// Builds the program as it is shipped, with `full` and the profile `dist`, and the wheel around
/// it, for this machine (`target`). On Linux they run with glibc 2.17 or newer, whatever this
/// machine has.
///
/// # Errors
///
/// Python 3.10 or newer with venv is missing, packages cannot be installed, or the build fails.
pub fn build(root: &Path, metadata: &Value, target: &str) -> Result<Built> {
    let python = root.join("python");
    // Beside pyproject.toml, which names them; not kept.
    let licences = python.join("licences");
    std::fs::create_dir_all(&licences).context("cannot make the folder of licences")?;
    for (name, bytes) in licences::files(root, metadata, target)? {
        std::fs::write(licences.join(name), bytes).context("cannot write a licence")?;
    }

    let linux = target.contains("linux");
    let tools = if linux {
        &[MATURIN, ZIG][..]
    } else {
        &[MATURIN]
    };
    let tools = environment(&folder(metadata)?.join("tools"), tools)?;
    let wheels = folder(metadata)?.join("wheels");
    if wheels.exists() {
        std::fs::remove_dir_all(&wheels).context("cannot empty the folder of wheels")?;
    }
    let mut maturin = Command::new(program_in(&tools, "maturin"));
    maturin.current_dir(&python);
    maturin
        .args(["build", "--target", target, "--out"])
        .arg(&wheels);
    if target.starts_with("x86_64") {
        maturin.env("RUSTFLAGS", X86_64);
    }
    if linux {
        maturin.args(["--zig", "--compatibility", "manylinux2014"]);
        // maturin looks for zig in the Python of its environment.
        let path = std::env::var_os("PATH").unwrap_or_default();
        let all = std::iter::once(programs(&tools)).chain(std::env::split_paths(&path));
        maturin.env("PATH", std::env::join_paths(all)?);
    }
    run(&mut maturin)?;
    let mut wheel = None;
    for entry in std::fs::read_dir(&wheels).context("no wheel was built")? {
        wheel = Some(entry?.path());
    }
    let file = if target.contains("windows") {
        "minute4d.exe"
    } else {
        "minute4d"
    };
    Ok(Built {
        wheel: wheel.context("no wheel was built")?,
        program: target_folder(metadata)?
            .join(target)
            .join("dist")
            .join(file),
    })
}

/// The folder of wheels and of environments.
fn folder(metadata: &Value) -> Result<PathBuf> {
    Ok(target_folder(metadata)?.join("wheel"))
}

/// Makes an environment of Python anew, with these packages; returns its folder.
fn environment(folder: &Path, packages: &[&str]) -> Result<PathBuf> {
    let python = if cfg!(windows) { "python" } else { "python3" };
    run(Command::new(python)
        .args(["-m", "venv", "--clear"])
        .arg(folder))?;
    let mut pip = Command::new(program_in(folder, "python"));
    run(pip.args(["-m", "pip", "install", "--quiet"]).args(packages))?;
    Ok(folder.to_path_buf())
}

/// The folder of the programs of an environment.
fn programs(environment: &Path) -> PathBuf {
    environment.join(if cfg!(windows) { "Scripts" } else { "bin" })
}

fn program_in(environment: &Path, name: &str) -> PathBuf {
    programs(environment).join(name)
}
