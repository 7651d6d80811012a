//! Failures of a command: an exit code and one line of text. A panic is a bug: it ends the program
//! with exit code 1 and a report that a user can send.

use crate::BUILD_FULL;
use crate::advice::with_options;
use minute4d::NetworkError;
#[cfg(feature = "nets")]
use minute4d::weights::{self, Entry, WeightsError};
use std::backtrace::{Backtrace, BacktraceStatus};
use std::error::Error;
use std::sync::{Mutex, PoisonError};

/// Why a command failed.
#[derive(Debug)]
pub struct Failure {
    /// The exit code.
    pub code: u8,
    /// One line for the user.
    pub reason: String,
}

impl Failure {
    /// Returns the failure for arguments that contradict each other.
    pub fn usage(reason: &str) -> Self {
        Self {
            code: 2,
            reason: reason.to_owned(),
        }
    }
}

impl From<minute4d::Error> for Failure {
    fn from(error: minute4d::Error) -> Self {
        Self {
            code: error.category().exit_code(),
            reason: chain(&error),
        }
    }
}

impl From<minute4d_eval::Error> for Failure {
    fn from(error: minute4d_eval::Error) -> Self {
        match error {
            minute4d_eval::Error::Minute4d(error) => error.into(),
            error => Self {
                code: error.category().exit_code(),
                reason: chain(&error),
            },
        }
    }
}

#[cfg(feature = "nets")]
impl From<WeightsError> for Failure {
    fn from(error: WeightsError) -> Self {
        minute4d::Error::from(error).into()
    }
}

impl From<minute4d::settings::SettingsError> for Failure {
    fn from(error: minute4d::settings::SettingsError) -> Self {
        minute4d::Error::from(error).into()
    }
}

/// Joins an error and its causes in one line, without causes that the text already quotes, and adds
/// the options and the command that help.
pub fn chain(error: &(dyn Error + 'static)) -> String {
    let mut text = error.to_string();
    #[cfg(feature = "nets")]
    let mut weights = command_for(error);
    let mut cause = error.source();
    while let Some(inner) = cause {
        let more = inner.to_string();
        if !text.contains(&more) {
            text += ": ";
            text += &more;
        }
        #[cfg(feature = "nets")]
        {
            weights = weights.or_else(|| command_for(inner));
        }
        cause = inner.source();
    }
    let mut text = with_options(&text);
    if lacks_a_feature(error) {
        text += &format!("; `{BUILD_FULL}` builds the program with it");
    }
    #[cfg(feature = "nets")]
    if let Some(command) = weights {
        return format!("{text}. `{command}` gets them");
    }
    text
}

/// Whether another build of the program could do it.
fn lacks_a_feature(error: &(dyn Error + 'static)) -> bool {
    matches!(
        error.downcast_ref::<minute4d::Error>(),
        Some(
            minute4d::Error::NoGpuSupport | minute4d::Error::Network(NetworkError::NotBuilt { .. })
        )
    )
}

/// The command that gets weights which an error misses.
#[cfg(feature = "nets")]
fn command_for(error: &(dyn Error + 'static)) -> Option<String> {
    // the library's error stands for that of the weights, and is not its cause
    let weights = match error.downcast_ref::<minute4d::Error>() {
        Some(minute4d::Error::Weights(weights)) => Some(weights),
        _ => error.downcast_ref::<WeightsError>(),
    };
    match weights? {
        WeightsError::Absent { name, .. } => weights::find(name).ok().map(command),
        _ => None,
    }
}

/// The command that gets weights.
#[cfg(feature = "nets")]
pub(crate) fn command(entry: &Entry) -> String {
    let agree = if entry.commercial {
        ""
    } else {
        " --accept-license"
    };
    format!("minute4d weights fetch {}{agree}", entry.name)
}

static LAST: Mutex<Option<String>> = Mutex::new(None);

/// Replaces the standard panic message by a report that a user can act on.
pub fn report_instead_of_abort() {
    std::panic::set_hook(Box::new(|info| {
        let message = info.payload_as_str().unwrap_or("no message");
        let place = info
            .location()
            .map_or_else(|| "an unknown place".to_owned(), ToString::to_string);
        let report = format!(
            "internal error: {message} (at {place}, minute4d {}); this is a bug in minute4d, please report it with the \
             command line and run.json",
            env!("CARGO_PKG_VERSION")
        );
        let backtrace = Backtrace::capture();
        if backtrace.status() == BacktraceStatus::Captured {
            crate::output::to_stderr(&backtrace.to_string());
        }
        let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
        // The first panic is the cause; later ones in other threads follow from it.
        last.get_or_insert(report);
    }));
}

/// Returns the report of the first panic.
pub fn last_report() -> String {
    let last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
    last.clone()
        .unwrap_or_else(|| "internal error without a report".to_owned())
}

#[cfg(test)]
mod tests {

    #[test]
    fn panic_in_any_thread_is_reported() {
        super::report_instead_of_abort();
        let caught = std::panic::catch_unwind(|| {
            let thread = std::thread::spawn(|| panic!("the promise is broken"));
            thread.join().unwrap();
        });
        assert!(caught.is_err());
        let report = super::last_report();
        assert!(
            report.contains("the promise is broken") && report.contains("failure.rs"),
            "{report}"
        );
        assert!(report.contains("please report"), "{report}");
    }
}
