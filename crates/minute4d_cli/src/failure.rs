//! Turns library errors into an exit code and one line of text.

use std::error::Error;

/// The failure of a command.
#[derive(Debug)]
pub struct Failure {
    /// The exit code.
    pub code: u8,
    /// What was wrong and what to do next.
    pub reason: String,
}

impl Failure {
    /// Returns the failure for arguments that contradict each other.
    pub fn usage(reason: &str) -> Self {
        Self { code: 2, reason: reason.to_owned() }
    }
}

impl From<minute4d::Error> for Failure {
    fn from(error: minute4d::Error) -> Self {
        Self { code: error.category().exit_code(), reason: chain(&error) }
    }
}

impl From<minute4d::settings::SettingsError> for Failure {
    fn from(error: minute4d::settings::SettingsError) -> Self {
        minute4d::Error::from(error).into()
    }
}

/// Joins an error and its causes in one line, without causes that the text already quotes.
pub fn chain(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        let more = inner.to_string();
        if !text.contains(&more) {
            text += ": ";
            text += &more;
        }
        cause = inner.source();
    }
    text
}
