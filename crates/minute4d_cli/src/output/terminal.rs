//! Progress on a terminal: one bar for the current phase.

use indicatif::{ProgressBar, ProgressStyle};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

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
            let bar = ProgressBar::new(total as u64)
                .with_style(style())
                .with_prefix(phase.to_owned());
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
