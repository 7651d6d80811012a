//! Progress: one bar for the current phase on a terminal, else one line every ten seconds.

use super::duration;
use indicatif::{ProgressBar, ProgressStyle};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// The bar of the current phase.
#[derive(Default)]
pub struct Bars(Mutex<Option<(String, ProgressBar)>>);

impl Bars {
    /// Shows a step.
    pub fn update(&self, phase: &str, done: usize, total: usize, note: &str) {
        let mut current = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if current.as_ref().is_none_or(|(name, _)| name != phase) {
            if let Some((_, old)) = current.take() {
                old.finish_and_clear();
            }
            let bar = ProgressBar::new(total as u64).with_style(style()).with_prefix(phase.to_owned());
            bar.set_position(done as u64);
            bar.reset_eta();
            bar.enable_steady_tick(Duration::from_millis(200));
            *current = Some((phase.to_owned(), bar));
        }
        if let Some((_, bar)) = current.as_ref() {
            bar.set_length(total as u64);
            bar.set_position(done as u64);
            bar.set_message(note.to_owned());
        }
    }

    /// Prints a line above the bar.
    pub fn say(&self, message: &str) {
        let current = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match current.as_ref() {
            Some((_, bar)) => bar.suspend(|| super::to_stderr(message)),
            None => super::to_stderr(message),
        }
    }

    /// Removes the bar.
    pub fn clear(&self) {
        if let Some((_, bar)) = self.0.lock().unwrap_or_else(PoisonError::into_inner).take() {
            bar.finish_and_clear();
        }
    }
}

/// Returns the style of the bar, without colours, so that `NO_COLOR` needs no handling.
fn style() -> ProgressStyle {
    ProgressStyle::with_template("{prefix:>12} [{bar:28}] {pos}/{len}  {elapsed} elapsed, {eta} left  {wide_msg}")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .progress_chars("=> ")
}

const INTERVAL: Duration = Duration::from_secs(10);

struct Phase {
    name: String,
    started: Instant,
    first_done: usize,
    last_line: Instant,
}

/// Decides which steps are printed.
#[derive(Default)]
pub struct Lines(Mutex<Option<Phase>>);

impl Lines {
    /// Returns the line to print for this step, if ten seconds have passed since the last.
    pub fn update(&self, phase: &str, done: usize, total: usize, note: &str) -> Option<String> {
        self.at(Instant::now(), phase, done, total, note)
    }

    fn at(&self, now: Instant, phase: &str, done: usize, total: usize, note: &str) -> Option<String> {
        let mut current = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let same = current.as_ref().is_some_and(|p| p.name == phase);
        if !same {
            let last_line = current.as_ref().map_or(now, |p| p.last_line);
            *current = Some(Phase { name: phase.to_owned(), started: now, first_done: done, last_line });
        }
        let entry = current.as_mut()?;
        if now.saturating_duration_since(entry.last_line) < INTERVAL {
            return None;
        }
        entry.last_line = now;
        let percent = (100 * done).checked_div(total).unwrap_or(0);
        let mut line = format!("{phase}: {done}/{total} ({percent} %)");
        let elapsed_s = now.saturating_duration_since(entry.started).as_secs_f64();
        if let Some(eta) = eta_s(elapsed_s, done.saturating_sub(entry.first_done), total.saturating_sub(done)) {
            line += &format!(", {} left", duration(eta));
        }
        if !note.is_empty() {
            line += ", ";
            line += note;
        }
        Some(line)
    }
}

/// Estimates the seconds that `left` steps take if `done` took `elapsed_s`; `None` before the first.
pub fn eta_s(elapsed_s: f64, done: usize, left: usize) -> Option<f64> {
    (done > 0).then(|| elapsed_s / done as f64 * left as f64)
}

#[cfg(test)]
mod tests {
    use super::Lines;
    use std::time::{Duration, Instant};

    #[test]
    fn progress_prints_every_ten_seconds_with_the_remaining_time() {
        let (lines, start) = (Lines::default(), Instant::now());
        let at = |s: u64, done| lines.at(start + Duration::from_secs(s), "train", done, 100, "loss 0.1");
        assert_eq!(at(0, 0), None);
        assert_eq!(at(9, 9), None);
        assert_eq!(at(10, 10).as_deref(), Some("train: 10/100 (10 %), 1m30s left, loss 0.1"));
        assert_eq!(at(19, 20), None);
        assert!(at(20, 50).is_some_and(|l| l.contains("50/100 (50 %), 20.0 s left")));
    }

    #[test]
    fn short_phases_do_not_flood_the_log() {
        let (lines, start) = (Lines::default(), Instant::now());
        let printed = (0..100u64).filter(|&s| {
            let phase = format!("phase {s}");
            lines.at(start + Duration::from_secs(s), &phase, 1, 1, "").is_some()
        });
        assert_eq!(printed.count(), 9);
    }
}
