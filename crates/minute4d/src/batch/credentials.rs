//! The environment variables withheld from the run of a job, which reads untrusted clips and needs no credentials.

use std::ffi::OsStr;
use std::process::Command;

/// Beginnings of names that belong to services, whose variables are accounts or lead to them.
const SERVICES: &[&str] = &[
    "AWS_",
    "AZURE_",
    "GOOGLE_",
    "GCP_",
    "GCLOUD_",
    "CLOUDSDK_",
    "GITHUB_",
    "GITLAB_",
    "VAULT_",
];
/// Parts of names.
const WORDS: &[&str] = &[
    "TOKEN",
    "SECRET",
    "PASSWORD",
    "PASSWD",
    "PASSPHRASE",
    "CREDENTIAL",
    "API_KEY",
    "APIKEY",
    "ACCESS_KEY",
    "PRIVATE_KEY",
];
/// Ends of names.
const ENDS: &[&str] = &["_KEY", "_PASS", "_PAT", "_JWT"];
/// Whole names: agents that sign, and files of passwords.
const NAMES: &[&str] = &[
    "SSH_AUTH_SOCK",
    "SSH_AGENT_PID",
    "GPG_AGENT_INFO",
    "DOCKER_AUTH_CONFIG",
    "KUBECONFIG",
    "NETRC",
    "PGPASSFILE",
];

/// Takes the variables of this process that look like credentials from a command.
pub(crate) fn remove(command: &mut Command) {
    for (name, value) in std::env::vars_os() {
        if is_credential(&name, &value) {
            command.env_remove(name);
        }
    }
}

/// Whether a variable looks like a credential, by its name or because it holds an address with a password.
fn is_credential(name: &OsStr, value: &OsStr) -> bool {
    let name = name.to_string_lossy().to_ascii_uppercase();
    SERVICES.iter().any(|start| name.starts_with(start))
        || WORDS.iter().any(|word| name.contains(word))
        || ENDS.iter().any(|end| name.ends_with(end))
        || NAMES.contains(&name.as_str())
        || has_password(&value.to_string_lossy())
}

/// Whether a text holds an address such as `https://name:password@host`.
fn has_password(text: &str) -> bool {
    text.split("://").skip(1).any(|rest| {
        let host = rest.split(['/', '?', '#', ' ']).next().unwrap_or_default();
        host.rsplit_once('@').is_some_and(|(user, _)| user.contains(':'))
    })
}

#[cfg(test)]
mod tests {
    use super::is_credential;
    use std::ffi::OsStr;

    fn is(name: &str, value: &str) -> bool {
        is_credential(OsStr::new(name), OsStr::new(value))
    }

    #[test]
    fn credentials_are_detected_by_name_and_by_passwords_in_urls() {
        for name in [
            "AWS_SECRET_ACCESS_KEY",
            "AWS_PROFILE",
            "AZURE_CLIENT_ID",
            "GOOGLE_APPLICATION_CREDENTIALS",
            "HF_TOKEN",
            "Github_Token",
            "SLURM_JWT",
            "DB_PASSWORD",
            "MYSQL_PWD_SECRET_FILE",
            "OPENAI_API_KEY",
            "SIGNING_KEY",
            "SSH_AUTH_SOCK",
        ] {
            assert!(is(name, "x"), "{name}");
        }
        for name in [
            "PATH",
            "HOME",
            "LD_LIBRARY_PATH",
            "CUDA_VISIBLE_DEVICES",
            "SLURM_JOB_ID",
            "TMPDIR",
            "MINUTE4D_WEIGHTS",
            "KEYBOARD",
            "XDG_CACHE_HOME",
            "RAYON_NUM_THREADS",
        ] {
            assert!(!is(name, "/some/where:/else"), "{name}");
        }
        for value in ["http://me:pw@proxy:3128/", "a=postgres://u:p@db/x"] {
            assert!(is("HTTPS_PROXY", value), "{value}");
        }
        for value in ["http://proxy:3128", "https://host/a:b@c", "http://me@host", "", "://"] {
            assert!(!is("HTTPS_PROXY", value), "{value}");
        }
    }
}
