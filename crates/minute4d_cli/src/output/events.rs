//! The event stream of `--json`: one object per line, with exactly one `end`, which is the last.

use minute4d::StageEvent;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::Write;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Version of the events; it grows when a field changes its meaning or goes away.
const SCHEMA: u32 = 1;
/// Progress events of one phase are at least this far apart.
const INTERVAL: Duration = Duration::from_millis(500);

#[derive(Default)]
struct State {
    /// Phase, when it started, at which step, when its last event went out.
    phases: BTreeMap<String, Phase>,
    ended: bool,
}

struct Phase {
    started: Instant,
    first_done: usize,
    last_event: Instant,
}

/// Writes events to stdout.
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

    /// Writes one event, unless the stream has ended.
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
        let (first_done, started) = match state.phases.get_mut(phase) {
            Some(entry) => {
                if now - entry.last_event < INTERVAL && done < total {
                    return;
                }
                entry.last_event = now;
                (entry.first_done, entry.started)
            }
            None => {
                let entry = Phase { started: now, first_done: done, last_event: now };
                state.phases.insert(phase.to_owned(), entry);
                (done, now)
            }
        };
        let eta_s = super::terminal::eta_s(
            (now - started).as_secs_f64(),
            done.saturating_sub(first_done),
            total.saturating_sub(done),
        );
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

    /// Writes the start or end of a stage.
    pub fn stage(&self, name: &str, event: StageEvent<'_>) {
        let status = |text: &str| ("status", Value::from(text));
        let more = match event {
            StageEvent::Started { because } => vec![status("started"), ("because", json!(because))],
            StageEvent::Resumed { done, total } => {
                vec![status("resumed"), ("done", json!(done)), ("total", json!(total))]
            }
            StageEvent::Reused => vec![status("reused")],
            StageEvent::Finished { seconds } => vec![status("finished"), ("seconds", json!(seconds))],
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
    let fields = [("ok", json!(code == 0)), ("code", json!(code)), ("reason", json!(reason))];
    write_line("end", &fields);
}

/// Writes one event. The object is assembled by hand so that the event's name comes first.
fn write_line(event: &str, fields: &[(&str, Value)]) {
    let fields = fields.iter().map(|(name, value)| format!(",{}:{value}", Value::from(*name)));
    let line = format!("{{\"event\":{}{}}}\n", Value::from(event), fields.collect::<String>());
    let mut stdout = std::io::stdout().lock();
    // If the reader has closed the pipe, the work continues without events.
    let _ = stdout.write_all(line.as_bytes()).and_then(|()| stdout.flush());
}
