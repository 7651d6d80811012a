//! Progress reports and cancellation of long work.

/// Receives the progress of one stage. Implementations must be cheap: stages call them often.
pub trait Progress: Sync {
    /// `done` of `total` steps of `phase` are finished (both in units of the phase: frames,
    /// iterations). `note` is a short figure for people, such as `"loss 0.031, 41,210 splats"`; it
    /// may be empty.
    fn update(&self, phase: &str, done: usize, total: usize, note: &str);

    /// Something that the user should know; reported once, kept in the run's record.
    fn warn(&self, message: &str);

    /// True once the user asked to stop. Stages check it between steps and return what they have or
    /// an error that says they were stopped.
    fn cancelled(&self) -> bool;
}

/// Discards progress and never stops, for tests and callers that need neither.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn update(&self, _phase: &str, _done: usize, _total: usize, _note: &str) {}

    fn warn(&self, _message: &str) {}

    fn cancelled(&self) -> bool {
        false
    }
}
