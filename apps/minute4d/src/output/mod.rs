//! Output of the program: the result on stdout and messages on stderr, or events as JSON lines.

mod progress;
mod stop;
mod text;

use stop::StopSignal;
pub use stop::{stop_at_eof, watch_signals};
pub use text::{delivered, lost, to_stderr};

use crate::advice::with_options;
use crate::memory::FreedMemory;
use minute4d::{Category, Error, Observer, Progress, StageEvent, plain_json};
pub use progress::end_of_json;
use progress::{Bars, Events, Lines};
use serde::Serialize;
use std::fmt::Display;
use std::io::IsTerminal;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

enum Mode {
    /// One JSON object per line on stdout.
    Json(Events),
    /// Bars on the terminal.
    Bars(Bars),
    /// A line every ten seconds on stderr.
    Lines(Lines),
    /// Nowhere; warnings and errors still go to stderr.
    NoWarnings,
}

/// The program's output; shared by the stages, the signal watcher and the end of `main`.
pub struct Output {
    mode: Mode,
    stop: StopSignal,
    warned: Mutex<Vec<String>>,
    memory: FreedMemory,
}

impl Output {
    /// Chooses the mode: `json` or `quiet` as requested, else bars if stderr is a terminal that can
    /// show them, else lines.
    pub fn new(json: bool, quiet: bool) -> Arc<Self> {
        let dumb = std::env::var_os("TERM").is_some_and(|term| term == "dumb");
        let mode = if json {
            Mode::Json(Events::start())
        } else if quiet {
            Mode::NoWarnings
        } else if std::io::stderr().is_terminal() && !dumb {
            Mode::Bars(Bars::default())
        } else {
            Mode::Lines(Lines::default())
        };
        Arc::new(Self {
            mode,
            stop: StopSignal::default(),
            warned: Mutex::new(Vec::new()),
            memory: FreedMemory::default(),
        })
    }

    /// Returns the signal to stop.
    pub fn stop(&self) -> &StopSignal {
        &self.stop
    }

    fn talks(&self) -> bool {
        matches!(self.mode, Mode::Bars(_) | Mode::Lines(_))
    }

    /// Prints a message that is neither progress nor result; `--json` and `--quiet` omit it.
    pub fn note(&self, message: &str) {
        if self.talks() {
            self.say(&with_options(message));
        }
    }

    /// Reports the address of the viewer page during work: an event, or a line on stderr even with
    /// `--quiet`.
    pub fn address(&self, url: &str) {
        match &self.mode {
            Mode::Json(events) => events.emit("view", &[("url", url.into())]),
            _ => self.say(&format!("the scene is shown at {url}")),
        }
    }

    /// Returns whether events are printed.
    pub fn is_json(&self) -> bool {
        matches!(self.mode, Mode::Json(_))
    }

    /// Prints the result: `text` on stdout, or `value` in a `result` event.
    ///
    /// # Errors
    ///
    /// [`Error::Internal`] if the value cannot be written as JSON.
    pub fn result(&self, text: impl Display, value: &impl Serialize) -> Result<(), Error> {
        match &self.mode {
            Mode::Json(events) => events.emit("result", &[("result", plain_json(value)?)]),
            Mode::Bars(bars) => {
                bars.clear();
                print_result(&text.to_string());
            }
            Mode::Lines(_) | Mode::NoWarnings => print_result(&text.to_string()),
        }
        Ok(())
    }

    /// Prints where a result is as [`result`](Self::result), in events with its record.
    ///
    /// # Errors
    ///
    /// As [`result`](Self::result).
    pub fn made(&self, path: &Path, record: &impl Serialize) -> Result<(), Error> {
        self.result(path.display(), &Made { path, record })
    }

    /// Writes the last event of `--json`, and the reason of a failure on stderr; returns the exit
    /// code, which is another one where the result or this event was not delivered.
    pub fn end(&self, code: u8, reason: &str) -> u8 {
        let (code, reason) = delivery(code, reason);
        match &self.mode {
            Mode::Json(events) => events.end(code, reason),
            Mode::Bars(bars) => bars.clear(),
            Mode::Lines(_) | Mode::NoWarnings => {}
        }
        let (code, reason) = delivery(code, reason);
        if code != 0 {
            self.say(&format!("minute4d: {reason}"));
        }
        code
    }

    fn say(&self, message: &str) {
        match &self.mode {
            Mode::Bars(bars) => bars.say(message),
            _ => to_stderr(message),
        }
    }
}

#[derive(Serialize)]
struct Made<'a, R> {
    path: &'a Path,
    record: &'a R,
}

impl Progress for Output {
    fn update(&self, phase: &str, done: usize, total: usize, note: &str) {
        self.memory.give_back();
        match &self.mode {
            Mode::Json(events) => events.progress(phase, done, total, note),
            Mode::Bars(bars) => bars.update(phase, done, total, note),
            Mode::Lines(lines) => {
                if let Some(line) = lines.update(phase, done, total, note) {
                    to_stderr(&line);
                }
            }
            Mode::NoWarnings => {}
        }
    }

    fn warn(&self, message: &str) {
        let mut warned = self.warned.lock().unwrap_or_else(PoisonError::into_inner);
        if warned.iter().any(|w| w == message) {
            return;
        }
        warned.push(message.to_owned());
        drop(warned);
        let message = with_options(message);
        if let Mode::Json(events) = &self.mode {
            events.emit("warning", &[("message", message.as_str().into())]);
        }
        self.say(&format!("warning: {message}"));
    }

    fn cancelled(&self) -> bool {
        self.stop.code().is_some()
    }
}

impl Observer for Output {
    fn stage(&self, name: &str, event: StageEvent<'_>) {
        if let Mode::Json(events) = &self.mode {
            events.stage(name, event);
        }
        if let Mode::Bars(bars) = &self.mode {
            bars.clear();
        }
        if !self.talks() {
            return;
        }
        match event {
            StageEvent::Started { because: None } => self.say(&format!("{name}: started")),
            StageEvent::Started { because: Some(why) } => {
                self.say(&format!("{name}: started again: {why}"))
            }
            StageEvent::Resumed { done, total } => {
                self.say(&format!("{name}: resumed at {done} of {total}"))
            }
            StageEvent::Reused => self.say(&format!("{name}: already done, nothing changed")),
            StageEvent::Finished { seconds } => {
                self.say(&format!("{name}: done in {}", duration(seconds)))
            }
            _ => {}
        }
    }
}

/// Turns success into the failure to deliver the result, if that is so.
fn delivery(code: u8, reason: &str) -> (u8, &str) {
    match lost() {
        Some(lost) if code == 0 => (Category::CannotWrite.exit_code(), lost),
        _ => (code, reason),
    }
}

/// Formats seconds: `8.3 s`, `2m05s`, `1h02m`.
pub fn duration(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    match whole {
        0..60 => format!("{seconds:.1} s"),
        60..3600 => format!("{}m{:02}s", whole / 60, whole % 60),
        _ => format!("{}h{:02}m", whole / 3600, whole % 3600 / 60),
    }
}

/// Prints a result to stdout, with a line feed at its end.
fn print_result(text: &str) {
    text::to_stdout(&format!(
        "{}\n",
        text::visible(text.strip_suffix('\n').unwrap_or(text))
    ));
}

#[cfg(test)]
mod tests {
    use super::duration;

    #[test]
    fn durations_are_formatted_briefly() {
        assert_eq!(duration(8.26), "8.3 s");
        assert_eq!(duration(125.4), "2m05s");
        assert_eq!(duration(3720.0), "1h02m");
    }
}
