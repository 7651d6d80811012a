//! Submits the script to Slurm.

use crate::batch::error::BatchError;
use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

/// What Slurm allows where it does not say.
const DEFAULT_ARRAY: usize = 1001;

/// Returns the maximum number of tasks of an array: Slurm's setting, or its default.
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

/// Submits the script as the array `tasks` of the jobs from `first` on, asks Slurm for it again, and gives its number.
///
/// # Errors
///
/// [`BatchError`] where Slurm is not here, refuses, or does not know the array afterwards.
pub fn submit(script: &Path, first: usize, tasks: &str) -> Result<String, BatchError> {
    let (array, index) = (format!("--array={tasks}"), first.to_string());
    let mut arguments: Vec<&OsStr> = vec!["--parsable".as_ref()];
    // The script itself has the first array.
    if first > 0 {
        arguments.push(array.as_ref());
    }
    arguments.extend([script.as_os_str(), index.as_ref()]);
    let answer = call("sbatch", &arguments, script)?;
    // The cluster's name follows where there are several.
    let id = answer.trim().split(';').next().unwrap_or_default().to_owned();
    let refused = |program, message| BatchError::Refused {
        program,
        message,
        script: script.to_path_buf(),
    };
    if id.is_empty() || !id.chars().all(|c| c.is_ascii_digit()) {
        let message = format!("it answered {answer:?}, which is not a job id");
        return Err(refused("sbatch", message));
    }
    let known = call("scontrol", &["show".as_ref(), "job".as_ref(), id.as_ref()], script)?;
    if !known.contains(&format!("={id}")) {
        let message = format!("it does not know job {id} although sbatch took it");
        return Err(refused("scontrol", message));
    }
    Ok(id)
}

fn call(program: &'static str, args: &[&OsStr], script: &Path) -> Result<String, BatchError> {
    let output = Command::new(program).args(args).output();
    let output = output.map_err(|source| BatchError::Start { program, source })?;
    if !output.status.success() {
        return Err(BatchError::Refused {
            program,
            message: String::from_utf8_lossy(&output.stderr).trim().to_owned(),
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
