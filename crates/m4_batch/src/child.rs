//! The run of one clip, as a child that ends when its parent does.
//!
//! The parent holds the other end of the child's standard input. The child stops in good order when that ends, whether the
//! parent let go of it or died; so a worker that was killed leaves nobody behind who writes on.

use serde_json::Value;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

/// How often a child is looked at.
const LOOK: Duration = Duration::from_millis(50);
/// How long a child may take to save before it is killed. It promises ten seconds.
const PATIENCE: Duration = Duration::from_secs(60);

/// Who watches over a child.
pub trait Watch: Sync {
    /// True when the child is to save and stop.
    fn stop(&self) -> bool;
    /// True when the child must not write any more.
    fn lost(&self) -> bool;
    /// How far it is: a phase, steps done and in all, and a word about them.
    fn progress(&self, phase: &str, done: usize, total: usize, note: &str);
}

/// How a child ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Ended {
    /// Its exit code; `None` where a signal ended it.
    pub code: Option<i32>,
    /// Its last words, or the signal.
    pub reason: String,
    /// True when it was asked to stop.
    pub asked: bool,
}

/// Runs a child to its end. What it says on standard error goes to `log`, and which stages it went through.
///
/// # Errors
///
/// The failure to start it or to wait for it.
pub(crate) fn run(mut command: Command, log: File, watch: &dyn Watch) -> io::Result<Ended> {
    let stages = log.try_clone()?;
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(log);
    apart(&mut command);
    let mut child = command.spawn()?;
    let (mut hold, events) = (child.stdin.take(), child.stdout.take());
    let last_words = Mutex::new(None);
    thread::scope(|scope| {
        let reader = scope.spawn(|| read_events(events, watch, &last_words, stages));
        let mut asked = None;
        let status = loop {
            if let Some(status) = child.try_wait()? {
                break status;
            }
            if watch.lost() {
                child.kill()?;
            } else if asked.is_none() && watch.stop() {
                asked = Some(Instant::now());
                hold = None;
            }
            if asked.is_some_and(|since: Instant| since.elapsed() > PATIENCE) {
                child.kill()?;
            }
            thread::sleep(LOOK);
        };
        drop(hold);
        let _ = reader.join();
        let said = last_words.lock().map(|said| said.clone()).unwrap_or_default();
        Ok(Ended {
            code: status.code(),
            reason: said
                .filter(|_| status.code().is_some())
                .unwrap_or_else(|| words(status)),
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

/// Ctrl-C at a terminal goes to the whole group; the child is told by its parent alone, and once.
#[cfg(unix)]
fn apart(command: &mut Command) {
    use std::os::unix::process::CommandExt;
    command.process_group(0);
}

#[cfg(not(unix))]
fn apart(_: &mut Command) {}

#[cfg(unix)]
fn words(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match status.signal() {
        Some(9) => "killed by signal 9; where nobody sent it, the machine was out of memory".to_owned(),
        Some(6) => "aborted (signal 6), as a program that gets no more memory is; .log has its last words".to_owned(),
        Some(signal) => format!("ended by signal {signal}"),
        None => format!("ended without a word ({status})"),
    }
}

#[cfg(not(unix))]
fn words(status: ExitStatus) -> String {
    format!("ended without a word ({status})")
}

/// Passes progress on, notes stages, and keeps the reason of the last event.
fn read_events(events: Option<ChildStdout>, watch: &dyn Watch, last_words: &Mutex<Option<String>>, mut stages: File) {
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
                if let Ok(mut said) = last_words.lock() {
                    *said = Some(text("reason").to_owned());
                }
            }
            _ => {}
        }
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use super::{Watch, run};
    use std::fs::File;
    use std::process::Command;
    use std::sync::atomic::{AtomicBool, Ordering};

    #[derive(Default)]
    struct Told {
        stop: AtomicBool,
        lost: AtomicBool,
    }

    impl Watch for Told {
        fn stop(&self) -> bool {
            self.stop.load(Ordering::SeqCst)
        }
        fn lost(&self) -> bool {
            self.lost.load(Ordering::SeqCst)
        }
        fn progress(&self, phase: &str, done: usize, _: usize, _: &str) {
            assert_eq!((phase, done), ("train", 3));
            self.stop.store(true, Ordering::SeqCst);
        }
    }

    fn shell(script: &str, watch: &Told) -> super::Ended {
        let dir = tempfile::tempdir().unwrap();
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        run(command, File::create(dir.path().join("log")).unwrap(), watch).unwrap()
    }

    #[test]
    fn code_and_last_words_are_kept() {
        let ended = shell(
            r#"echo '{"event":"end","code":65,"reason":"no frames"}'; exit 65"#,
            &Told::default(),
        );
        assert_eq!(
            (ended.code, ended.reason.as_str(), ended.asked),
            (Some(65), "no frames", false)
        );
    }

    #[test]
    fn a_signal_is_named() {
        let ended = shell("kill -9 $$", &Told::default());
        assert_eq!(ended.code, None);
        assert!(ended.reason.contains("signal 9"), "{}", ended.reason);
    }

    #[test]
    fn a_child_that_is_asked_to_stop_sees_the_end_of_its_input() {
        let script =
            r#"echo '{"event":"progress","phase":"train","done":3,"total":9,"note":""}'; cat >/dev/null; exit 143"#;
        let ended = shell(script, &Told::default());
        assert_eq!((ended.code, ended.asked), (Some(143), true));
    }

    #[test]
    fn a_child_without_its_lease_is_killed() {
        let watch = Told::default();
        watch.lost.store(true, Ordering::SeqCst);
        assert_eq!(shell("sleep 60", &watch).code, None);
    }
}
