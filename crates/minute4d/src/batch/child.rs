//! Runs one clip in a child process that ends with its parent and gets no credentials.
//!
//! The parent holds the other end of the child's standard input. The child saves and stops when that ends, whether the parent let
//! go of it or died: a killed process leaves no child behind that keeps writing.

use serde_json::Value;
use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

const LOOK: Duration = Duration::from_millis(50);
/// How long a child may take to save before it is killed. It promises ten seconds.
const PATIENCE: Duration = Duration::from_secs(60);

/// Receives the progress of the run, and may stop it.
pub trait Watch: Sync {
    /// True when the run is to save and stop.
    fn stop(&self) -> bool;
    /// How far it is: a phase, steps done and in all, and a word about them.
    fn progress(&self, phase: &str, done: usize, total: usize, note: &str);
}

/// The end of a child process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Ended {
    /// Its exit code; `None` where a signal ended it.
    pub code: Option<i32>,
    /// Its last message, or the signal.
    pub reason: String,
    /// True when it was asked to stop.
    pub asked: bool,
}

/// Runs a child to its end. What it says on standard error goes to `log`, and which stages it went through.
pub(crate) fn run(mut command: Command, log: File, watch: &dyn Watch) -> io::Result<Ended> {
    let stages = log.try_clone()?;
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(log);
    // Ctrl-C at a terminal goes to the whole group; only the parent forwards it to the child, once.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    let mut child = command.spawn()?;
    let (mut hold, events) = (child.stdin.take(), child.stdout.take());
    let last_messages = Mutex::new(None);
    thread::scope(|scope| {
        let reader = scope.spawn(|| read_events(events, watch, &last_messages, stages));
        let mut asked: Option<Instant> = None;
        let status = loop {
            if let Some(status) = child.try_wait()? {
                break status;
            }
            if asked.is_none() && watch.stop() {
                asked = Some(Instant::now());
                hold = None;
            }
            if asked.is_some_and(|since| since.elapsed() > PATIENCE) {
                child.kill()?;
            }
            thread::sleep(LOOK);
        };
        drop(hold);
        let _ = reader.join();
        let message = last_messages.lock().map(|message| message.clone()).unwrap_or_default();
        Ok(Ended {
            code: status.code(),
            reason: message.filter(|_| status.code().is_some()).unwrap_or_else(|| exit_message(status)),
            asked: asked.is_some(),
        })
    })
    .inspect_err(|_: &io::Error| end(&mut child))
}

fn end(child: &mut Child) {
    // It may have ended by itself.
    let _ = child.kill();
    let _ = child.wait();
}

#[cfg(unix)]
fn exit_message(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match status.signal() {
        Some(9) => "killed by signal 9; unless it was sent by hand, the machine was out of memory".to_owned(),
        Some(6) => "aborted (signal 6), as a program that runs out of memory; .log has its last messages".to_owned(),
        Some(signal) => format!("ended by signal {signal}"),
        None => format!("ended without a message ({status})"),
    }
}

#[cfg(not(unix))]
fn exit_message(status: ExitStatus) -> String {
    format!("ended without a message ({status})")
}

/// Passes progress on, notes stages, and keeps the reason of the last event.
fn read_events(
    events: Option<ChildStdout>,
    watch: &dyn Watch,
    last_messages: &Mutex<Option<String>>,
    mut stages: File,
) {
    let Some(events) = events else { return };
    for line in BufReader::new(events).lines() {
        let Ok(line) = line else { return };
        let Ok(event) = serde_json::from_str::<Value>(&line) else {
            continue;
        };
        let text = |name: &str| event[name].as_str().unwrap_or_default();
        let count = |name: &str| event[name].as_u64().unwrap_or_default() as usize;
        match text("event") {
            "progress" => watch.progress(text("phase"), count("done"), count("total"), text("note")),
            "stage" => {
                // The log is a help, and a full disk is noticed by the run itself.
                let _ = stages.write_all(format!("{line}\n").as_bytes());
            }
            "end" => {
                if let Ok(mut message) = last_messages.lock() {
                    *message = Some(text("reason").to_owned());
                }
            }
            _ => {}
        }
    }
}

/// Beginnings of names that belong to services, whose variables are accounts or lead to them.
const SERVICES: &[&str] =
    &["AWS_", "AZURE_", "GOOGLE_", "GCP_", "GCLOUD_", "CLOUDSDK_", "GITHUB_", "GITLAB_", "VAULT_"];
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
const ENDS: &[&str] = &["_KEY", "_PASS", "_PAT", "_JWT"];
/// Whole names: agents that sign, and files of passwords.
const NAMES: &[&str] =
    &["SSH_AUTH_SOCK", "SSH_AGENT_PID", "GPG_AGENT_INFO", "DOCKER_AUTH_CONFIG", "KUBECONFIG", "NETRC", "PGPASSFILE"];

/// Takes the variables of this process that look like credentials from a command.
pub(crate) fn remove_credentials(command: &mut Command) {
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
#[cfg(unix)]
mod tests {
    use super::{Ended, Watch, run};
    use std::fs::File;
    use std::process::Command;
    use std::sync::atomic::{AtomicBool, Ordering};

    /// Asks to stop at the first progress.
    #[derive(Default)]
    struct Impatient(AtomicBool);

    impl Watch for Impatient {
        fn stop(&self) -> bool {
            self.0.load(Ordering::SeqCst)
        }
        fn progress(&self, phase: &str, done: usize, _: usize, _: &str) {
            assert_eq!((phase, done), ("train", 3));
            self.0.store(true, Ordering::SeqCst);
        }
    }

    fn shell(script: &str) -> Ended {
        let dir = tempfile::tempdir().unwrap();
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        let log = File::create(dir.path().join("log")).unwrap();
        run(command, log, &Impatient::default()).unwrap()
    }

    #[test]
    fn exit_codes_last_stderr_lines_and_signals_are_reported() {
        let ended = shell(r#"echo '{"event":"end","code":65,"reason":"no frames"}'; exit 65"#);
        assert_eq!((ended.code, ended.reason.as_str()), (Some(65), "no frames"));
        assert!(!ended.asked);
        let ended = shell("kill -9 $$");
        assert!(ended.code.is_none() && ended.reason.contains("signal 9"), "{ended:?}");
    }

    #[test]
    fn stop_request_closes_the_input_of_the_child() {
        let event = r#"{"event":"progress","phase":"train","done":3,"total":9,"note":""}"#;
        let ended = shell(&format!("echo '{event}'; cat >/dev/null; exit 143"));
        assert_eq!((ended.code, ended.asked), (Some(143), true));
    }
}

#[cfg(test)]
mod credentials_tests {
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
