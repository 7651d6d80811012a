//! Handing the script to Slurm.

use m4_io::ErrorKind;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What Slurm allows where it does not say.
const DEFAULT_ARRAY: usize = 1001;

/// Why a batch was not submitted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SubmitError {
    /// A value that no script can hold.
    #[error("{text:?} cannot be used: {reason}")]
    Text {
        /// The value.
        text: String,
        /// Why not.
        reason: &'static str,
    },
    /// A program of Slurm did not start.
    #[error(
        "cannot start {program}: {source}; submit on a machine that has Slurm, or use --dry-run for the script alone"
    )]
    Start {
        /// The program.
        program: &'static str,
        /// What the system said.
        source: io::Error,
    },
    /// A program of Slurm refused.
    #[error("{program} refused: {said}; the script is {}", script.display())]
    Refused {
        /// The program.
        program: &'static str,
        /// What it said.
        said: String,
        /// The script.
        script: PathBuf,
    },
}

impl SubmitError {
    /// What sort of failure this is.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Text { .. } => ErrorKind::BadData,
            Self::Start { .. } => ErrorKind::NotFound,
            Self::Refused { .. } => ErrorKind::Io,
        }
    }
}

/// Most tasks that an array may have here: what Slurm is set to, or what it is set to where nobody changed it.
#[must_use]
pub fn largest_array() -> usize {
    let told = Command::new("scontrol").args(["show", "config"]).output();
    let text = told
        .ok()
        .filter(|o| o.status.success())
        .and_then(|o| String::from_utf8(o.stdout).ok());
    text.as_deref().and_then(max_array_size).unwrap_or(DEFAULT_ARRAY)
}

/// `MaxArraySize`, which is one more than the highest index: as many tasks as it says fit.
fn max_array_size(config: &str) -> Option<usize> {
    let line = config.lines().find_map(|l| l.trim().strip_prefix("MaxArraySize"))?;
    line.trim_start()
        .strip_prefix('=')?
        .trim()
        .parse()
        .ok()
        .filter(|&n| n > 0)
}

/// Submits the script, asks Slurm for the job again, and gives its number.
///
/// # Errors
///
/// [`SubmitError`] where Slurm is not here, refuses, or does not know the job afterwards.
pub fn submit(script: &Path) -> Result<String, SubmitError> {
    let answer = call("sbatch", &["--parsable".as_ref(), script.as_os_str()], script)?;
    // The cluster's name follows where there are several.
    let id = answer.trim().split(';').next().unwrap_or_default().to_owned();
    if id.is_empty() || !id.chars().all(|c| c.is_ascii_digit()) {
        return Err(SubmitError::Refused {
            program: "sbatch",
            said: format!("it answered {answer:?}, which is no number of a job"),
            script: script.to_path_buf(),
        });
    }
    let known = call("scontrol", &["show".as_ref(), "job".as_ref(), id.as_ref()], script)?;
    if !known.contains(&format!("={id}")) {
        return Err(SubmitError::Refused {
            program: "scontrol",
            said: format!("it does not know job {id} although sbatch took it"),
            script: script.to_path_buf(),
        });
    }
    Ok(id)
}

fn call(program: &'static str, args: &[&std::ffi::OsStr], script: &Path) -> Result<String, SubmitError> {
    let output = Command::new(program).args(args).output();
    let output = output.map_err(|source| SubmitError::Start { program, source })?;
    if !output.status.success() {
        return Err(SubmitError::Refused {
            program,
            said: String::from_utf8_lossy(&output.stderr).trim().to_owned(),
            script: script.to_path_buf(),
        });
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

#[cfg(test)]
mod tests {
    use super::max_array_size;

    #[test]
    fn the_limit_is_read_from_the_configuration() {
        let config = "MailProg                = /bin/mail\nMaxArraySize            = 501\nMaxDBDMsgs = 20010\n";
        assert_eq!(max_array_size(config), Some(501));
        assert_eq!(max_array_size("MaxArraySize = none"), None);
        assert_eq!(max_array_size(""), None);
    }
}
