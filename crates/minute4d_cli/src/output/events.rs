//! The event stream of `--json`: one object a line, `end` always last and once.

use minute4d::StageEvent;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::Write;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

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
    /// Writes one event, unless the stream has ended.
    pub fn emit(&self, event: &Value) {
        let state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if !state.ended {
            write_line(event);
        }
    }

    /// A step of a phase; most are left out.
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
                let entry = Phase {
                    started: now,
                    first_done: done,
                    last_event: now,
                };
                state.phases.insert(phase.to_owned(), entry);
                (done, now)
            }
        };
        let eta_s = super::lines::eta_s(
            (now - started).as_secs_f64(),
            done.saturating_sub(first_done),
            total.saturating_sub(done),
        );
        write_line(&json!({
            "event": "progress", "phase": phase, "done": done, "total": total, "note": note, "eta_s": eta_s,
        }));
        if done >= total {
            state.phases.remove(phase);
        }
    }

    /// A stage began or ended.
    pub fn stage(&self, name: &str, event: StageEvent<'_>) {
        let value = match event {
            StageEvent::Started { because } => json!({"status": "started", "because": because}),
            StageEvent::Resumed { done, total } => json!({"status": "resumed", "done": done, "total": total}),
            StageEvent::Reused => json!({"status": "reused"}),
            StageEvent::Finished { seconds } => json!({"status": "finished", "seconds": seconds}),
            _ => return,
        };
        let mut line = json!({"event": "stage", "stage": name});
        if let (Value::Object(line), Value::Object(value)) = (&mut line, value) {
            line.extend(value);
        }
        self.emit(&line);
    }

    /// The last event; later ones are dropped.
    pub fn end(&self, code: u8, reason: &str) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if !state.ended {
            state.ended = true;
            write_line(&end_event(code, reason));
        }
    }
}

/// The whole stream of a program that never got to work.
pub fn end_of_json(code: u8, reason: &str) {
    write_line(&end_event(code, reason));
}

fn end_event(code: u8, reason: &str) -> Value {
    json!({"event": "end", "ok": code == 0, "code": code, "reason": reason})
}

fn write_line(event: &Value) {
    let mut stdout = std::io::stdout().lock();
    // A reader that went away wants no more events; the work goes on.
    let _ = writeln!(stdout, "{event}").and_then(|()| stdout.flush());
}
