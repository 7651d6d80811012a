//! Runs one clip in a child process that ends with its parent.
//!
//! The parent holds the other end of the child's standard input. The child saves and stops when
//! that ends, whether the parent let go of it or died: a killed process leaves no child behind that
//! keeps writing.

use m4_core::Progress;
use minute4d::environment;
use serde_json::Value;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::process::{ChildStdout, Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

const LOOK: Duration = Duration::from_millis(50);
/// How long a child may take to save before it is killed. It promises ten seconds.
const PATIENCE: Duration = Duration::from_secs(60);

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

/// Runs a child to its end, with what it needs of the environment. What it says on standard error
/// goes to `log`, and which stages it went through.
pub(crate) fn run(mut command: Command, log: File, watch: &dyn Progress) -> io::Result<Ended> {
    let stages = log.try_clone()?;
    environment::pass_on(&mut command);
    command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(log);
    // Ctrl-C at a terminal goes to the whole group; only the parent forwards it to the child, once.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    let mut child = command.spawn()?;
    let (mut hold, events) = (child.stdin.take(), child.stdout.take());
    thread::scope(|scope| {
        let reader = scope.spawn(|| read_events(events, watch, stages));
        let mut asked: Option<Instant> = None;
        let status = loop {
            if let Some(status) = child.try_wait()? {
                break status;
            }
            if asked.is_none() && watch.cancelled() {
                asked = Some(Instant::now());
                hold = None;
            }
            if asked.is_some_and(|since| since.elapsed() > PATIENCE) {
                child.kill()?;
            }
            thread::sleep(LOOK);
        };
        drop(hold);
        let message = reader.join().ok().flatten();
        Ok(Ended {
            code: status.code(),
            reason: message
                .filter(|_| status.code().is_some())
                .unwrap_or_else(|| exit_message(status)),
            asked: asked.is_some(),
        })
    })
    .inspect_err(|_: &io::Error| {
        // It may have ended by itself.
        let _ = child.kill();
        let _ = child.wait();
    })
}

#[cfg(unix)]
fn exit_message(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match status.signal() {
        Some(9) => "killed by signal 9; unless it was sent by hand, the machine was out of memory"
            .to_owned(),
        Some(6) => {
            "aborted (signal 6), as a program that runs out of memory; .log has its last messages"
                .to_owned()
        }
        Some(signal) => format!("ended by signal {signal}"),
        None => format!("ended without a message ({status})"),
    }
}

#[cfg(not(unix))]
fn exit_message(status: ExitStatus) -> String {
    format!("ended without a message ({status})")
}

/// Passes progress on, notes stages, and returns the reason of the last event.
fn read_events(
    events: Option<ChildStdout>,
    watch: &dyn Progress,
    mut stages: File,
) -> Option<String> {
    let mut reason = None;
    for line in BufReader::new(events?).lines().map_while(Result::ok) {
        let Ok(event) = serde_json::from_str::<Value>(&line) else {
            continue;
        };
        let text = |name: &str| event[name].as_str().unwrap_or_default();
        let count = |name: &str| event[name].as_u64().unwrap_or_default() as usize;
        match text("event") {
            "progress" => watch.update(text("phase"), count("done"), count("total"), text("note")),
            "stage" => {
                // The log is a help, and a full disk is noticed by the run itself.
                let _ = stages.write_all(format!("{line}\n").as_bytes());
            }
            "end" => reason = Some(text("reason").to_owned()),
            _ => {}
        }
    }
    reason
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use super::{Ended, run};
    use m4_core::Progress;
    use std::fs::File;
    use std::process::Command;
    use std::sync::atomic::{AtomicBool, Ordering};

    /// Asks to stop at the first progress.
    #[derive(Default)]
    struct Impatient(AtomicBool);

    impl Progress for Impatient {
        fn update(&self, phase: &str, done: usize, _: usize, _: &str) {
            assert_eq!((phase, done), ("train", 3));
            self.0.store(true, Ordering::SeqCst);
        }
        fn warn(&self, _: &str) {}
        fn cancelled(&self) -> bool {
            self.0.load(Ordering::SeqCst)
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
        assert!(
            ended.code.is_none() && ended.reason.contains("signal 9"),
            "{ended:?}"
        );
    }

    #[test]
    fn stop_request_closes_the_input_of_the_child() {
        let event = r#"{"event":"progress","phase":"train","done":3,"total":9,"note":""}"#;
        let ended = shell(&format!("echo '{event}'; cat >/dev/null; exit 143"));
        assert_eq!((ended.code, ended.asked), (Some(143), true));
    }
}
