//! The Python package around this program: its own tests, in an environment of its own.

use crate::common::Scratch;
use m4_testkit::{Need, repository, skip};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};

/// What a wheel says of itself, besides its files. The shipped one is made by maturin
/// (`cargo xtask wheel`), which would compile the program again.
const TAG: &str =
    "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: false\nTag: py3-none-any\n";

/// Packs the modules of `python/src` and the program of this build as a wheel in `folder`.
fn wheel(folder: &Path) -> PathBuf {
    let version = env!("CARGO_PKG_VERSION");
    let path = folder.join(format!("minute4d-{version}-py3-none-any.whl"));
    let mut zip = ZipWriter::new(std::fs::File::create(&path).unwrap());
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    let info = format!("minute4d-{version}.dist-info");
    let program = Path::new(env!("CARGO_BIN_EXE_minute4d"));
    let name = program.file_name().unwrap().to_str().unwrap();

    let mut files = vec![(
        format!("minute4d-{version}.data/scripts/{name}"),
        std::fs::read(program).unwrap(),
        0o755,
    )];
    for entry in std::fs::read_dir(repository().join("python/src/minute4d")).unwrap() {
        let source = entry.unwrap().path();
        if source.is_file() {
            let name = source.file_name().unwrap().to_str().unwrap();
            let bytes = std::fs::read(&source).unwrap();
            files.push((format!("minute4d/{name}"), bytes, 0o644));
        }
    }
    let metadata = format!(
        "Metadata-Version: 2.1\nName: minute4d\nVersion: {version}\nRequires-Dist: numpy\n"
    );
    files.push((format!("{info}/METADATA"), metadata.into_bytes(), 0o644));
    files.push((format!("{info}/WHEEL"), TAG.as_bytes().to_vec(), 0o644));
    // Installers do not compare hashes, and write the list anew.
    let mut record = format!("{info}/RECORD,,\n");
    for (name, _, _) in &files {
        let _ = writeln!(record, "{name},,");
    }
    files.push((format!("{info}/RECORD"), record.into_bytes(), 0o644));
    for (name, bytes, mode) in files {
        zip.start_file(name, options.unix_permissions(mode))
            .unwrap();
        zip.write_all(&bytes).unwrap();
    }
    zip.finish().unwrap();
    path
}

/// Runs a command; its output where it fails.
fn run(command: &mut Command) -> Result<(), String> {
    let output = command.output().map_err(|error| error.to_string())?;
    if output.status.success() {
        return Ok(());
    }
    let text = [output.stdout, output.stderr].map(|b| String::from_utf8_lossy(&b).into_owned());
    Err(format!("{command:?}: {}", text.concat()))
}

#[test]
fn python_package_passes_its_tests_with_this_program() {
    let dir = Scratch::new();
    let environment = dir.path("environment");
    let (name, python) = if cfg!(windows) {
        ("python", "Scripts/python.exe")
    } else {
        ("python3", "bin/python")
    };
    let package = repository().join("python");
    let in_environment = |module: &str| {
        let mut command = Command::new(environment.join(python));
        command.current_dir(&package).args(["-m", module]);
        command
    };
    let ready = run(Command::new(name).args(["-m", "venv"]).arg(&environment)).and_then(|()| {
        let tools = [
            "install",
            "--quiet",
            "-r",
            "tests/requirements.txt",
            "numpy",
        ];
        run(in_environment("pip").args(tools))
    });
    if let Err(why) = ready {
        skip(Need::Pip, &why);
        return;
    }
    let wheel = wheel(&dir.path(""));
    run(in_environment("pip")
        .args(["install", "--quiet", "--no-index"])
        .arg(&wheel))
    .unwrap();
    let cache = format!("--cache-dir={}", dir.at("mypy"));
    let types = run(in_environment("mypy").arg(&cache));
    types.unwrap_or_else(|text| panic!("{text}"));
    let tests = run(in_environment("pytest").args(["--quiet", "-p", "no:cacheprovider", "tests"]));
    tests.unwrap_or_else(|text| panic!("{text}"));
}
