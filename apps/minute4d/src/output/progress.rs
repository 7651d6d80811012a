//! Progress: the events of `--json` (one object per line, with exactly one `end`, which is the
//! last), one bar for the current phase on a terminal, or one line every ten seconds.

use super::duration;
use super::text::{to_stdout, visible_json, visible_line};
use indicatif::{ProgressBar, ProgressStyle};
use minute4d::StageEvent;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Version of the events; it grows when a field changes its meaning or goes away.
const SCHEMA: u32 = 1;
/// Progress events of one phase are at least this far apart.
const EVENT_INTERVAL: Duration = Duration::from_millis(500);
/// The same of lines.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

#[derive(Default)]
struct State {
    /// Phase, when it started, at which step, when its last event went out.
    phases: BTreeMap<String, Phase>,
    ended: bool,
}

struct Phase {
    started: Instant,
    first_done: usize,
    /// When its last event or line was written.
    last: Instant,
}

impl Phase {
    fn begin(now: Instant, first_done: usize, last: Instant) -> Self {
        Self {
            started: now,
            first_done,
            last,
        }
    }

    /// Estimates the seconds to the end; `None` before the first step.
    fn eta_s(&self, now: Instant, done: usize, total: usize) -> Option<f64> {
        let elapsed_s = now.saturating_duration_since(self.started).as_secs_f64();
        let (done, left) = (
            done.saturating_sub(self.first_done),
            total.saturating_sub(done),
        );
        (done > 0).then(|| elapsed_s / done as f64 * left as f64)
    }
}

#[derive(Default)]
pub struct Events(Mutex<State>);

impl Events {
    /// Starts a stream; its first event holds the version of the program and of the schema.
    pub fn start() -> Self {
        let events = Self::default();
        let release = Value::from(env!("CARGO_PKG_VERSION"));
        events.emit("start", &[("schema", SCHEMA.into()), ("minute4d", release)]);
        events
    }

    pub fn emit(&self, event: &str, fields: &[(&str, Value)]) {
        let state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if !state.ended {
            write_line(event, fields);
        }
    }

    /// Writes a step of a phase, at most one per interval.
    pub fn progress(&self, phase: &str, done: usize, total: usize, note: &str) {
        let now = Instant::now();
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if state.ended {
            return;
        }
        let eta_s = match state.phases.get_mut(phase) {
            Some(entry) => {
                if now - entry.last < EVENT_INTERVAL && done < total {
                    return;
                }
                entry.last = now;
                entry.eta_s(now, done, total)
            }
            None => {
                let begun = Phase::begin(now, done, now);
                state.phases.insert(phase.to_owned(), begun);
                None
            }
        };
        let fields = [
            ("phase", json!(phase)),
            ("done", json!(done)),
            ("total", json!(total)),
            ("eta_s", json!(eta_s)),
            ("note", json!(note)),
        ];
        write_line("progress", &fields);
        if done >= total {
            state.phases.remove(phase);
        }
    }

    pub fn stage(&self, name: &str, event: StageEvent<'_>) {
        let status = |text: &str| ("status", Value::from(text));
        let more = match event {
            StageEvent::Started { because } => vec![status("started"), ("because", json!(because))],
            StageEvent::Resumed { done, total } => {
                vec![
                    status("resumed"),
                    ("done", json!(done)),
                    ("total", json!(total)),
                ]
            }
            StageEvent::Reused => vec![status("reused")],
            StageEvent::Finished { seconds } => {
                vec![status("finished"), ("seconds", json!(seconds))]
            }
            _ => return,
        };
        let mut fields = vec![("stage", Value::from(name))];
        fields.extend(more);
        self.emit("stage", &fields);
    }

    /// Writes the last event; later ones are dropped.
    pub fn end(&self, code: u8, reason: &str) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if !state.ended {
            state.ended = true;
            write_end(code, reason);
        }
    }
}

/// Writes the whole stream of a program that failed before any work.
pub fn end_of_json(code: u8, reason: &str) {
    Events::start();
    write_end(code, reason);
}

fn write_end(code: u8, reason: &str) {
    let fields = [
        ("ok", json!(code == 0)),
        ("code", json!(code)),
        ("reason", json!(reason)),
    ];
    write_line("end", &fields);
}

/// Writes one event. The object is assembled by hand so that the event's name comes first.
fn write_line(event: &str, fields: &[(&str, Value)]) {
    let fields = fields
        .iter()
        .map(|(name, value)| format!(",{}:{value}", Value::from(*name)));
    let line = format!(
        "{{\"event\":{}{}}}\n",
        Value::from(event),
        fields.collect::<String>()
    );
    // If the reader has closed the pipe, the work continues without events.
    to_stdout(&visible_json(&line));
}

#[derive(Default)]
pub struct Bars(Mutex<Option<(String, ProgressBar)>>);

impl Bars {
    pub fn update(&self, phase: &str, done: usize, total: usize, note: &str) {
        let mut current = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if current.as_ref().is_none_or(|(name, _)| name != phase) {
            if let Some((_, old)) = current.take() {
                old.finish_and_clear();
            }
            let bar = ProgressBar::new(total as u64)
                .with_style(style())
                .with_prefix(visible_line(phase).into_owned());
            bar.set_position(done as u64);
            bar.reset_eta();
            bar.enable_steady_tick(Duration::from_millis(200));
            *current = Some((phase.to_owned(), bar));
        }
        if let Some((_, bar)) = current.as_ref() {
            bar.set_length(total as u64);
            bar.set_position(done as u64);
            bar.set_message(visible_line(note).into_owned());
        }
    }

    pub fn say(&self, message: &str) {
        let current = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match current.as_ref() {
            Some((_, bar)) => bar.suspend(|| super::to_stderr(message)),
            None => super::to_stderr(message),
        }
    }

    pub fn clear(&self) {
        if let Some((_, bar)) = self.0.lock().unwrap_or_else(PoisonError::into_inner).take() {
            bar.finish_and_clear();
        }
    }
}

/// Returns the style of the bar, without colours, so that `NO_COLOR` needs no handling.
fn style() -> ProgressStyle {
    ProgressStyle::with_template(
        "{prefix:>12} [{bar:28}] {pos}/{len}  {elapsed} elapsed, {eta} left  {wide_msg}",
    )
    .unwrap_or_else(|_| ProgressStyle::default_bar())
    .progress_chars("=> ")
}

#[derive(Default)]
pub struct Lines(Mutex<Option<(String, Phase)>>);

impl Lines {
    /// Returns the line to print for this step, if ten seconds have passed since the last.
    pub fn update(&self, phase: &str, done: usize, total: usize, note: &str) -> Option<String> {
        self.at(Instant::now(), phase, done, total, note)
    }

    fn at(
        &self,
        now: Instant,
        phase: &str,
        done: usize,
        total: usize,
        note: &str,
    ) -> Option<String> {
        let mut current = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if current.as_ref().is_none_or(|(name, _)| name != phase) {
            let last = current.as_ref().map_or(now, |(_, before)| before.last);
            *current = Some((phase.to_owned(), Phase::begin(now, done, last)));
        }
        let (_, entry) = current.as_mut()?;
        if now.saturating_duration_since(entry.last) < LINE_INTERVAL {
            return None;
        }
        entry.last = now;
        let percent = (100 * done).checked_div(total).unwrap_or(0);
        let mut line = format!("{phase}: {done}/{total} ({percent} %)");
        if let Some(eta) = entry.eta_s(now, done, total) {
            line += &format!(", {} left", duration(eta));
        }
        if !note.is_empty() {
            line += ", ";
            line += &visible_line(note);
        }
        Some(line)
    }
}

#[cfg(test)]
mod tests {
    use super::Lines;
    use std::time::{Duration, Instant};

    #[test]
    fn progress_prints_every_ten_seconds_with_the_remaining_time() {
        let (lines, start) = (Lines::default(), Instant::now());
        let at = |s: u64, done| {
            lines.at(
                start + Duration::from_secs(s),
                "train",
                done,
                100,
                "loss 0.1",
            )
        };
        assert_eq!(at(0, 0), None);
        assert_eq!(at(9, 9), None);
        assert_eq!(
            at(10, 10).as_deref(),
            Some("train: 10/100 (10 %), 1m30s left, loss 0.1")
        );
        assert_eq!(at(19, 20), None);
        assert!(at(20, 50).is_some_and(|l| l.contains("50/100 (50 %), 20.0 s left")));
    }

    #[test]
    fn short_phases_do_not_flood_the_log() {
        let (lines, start) = (Lines::default(), Instant::now());
        let printed = (0..100u64).filter(|&s| {
            let phase = format!("phase {s}");
            lines
                .at(start + Duration::from_secs(s), &phase, 1, 1, "")
                .is_some()
        });
        assert_eq!(printed.count(), 9);
    }
}
