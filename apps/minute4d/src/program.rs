//! What all programs of this project do: arguments, signals, panics, exit codes, decoding in a
//! process of its own.

use crate::failure::{self, Failure};
use crate::options::Common;
use crate::output::{self, Output};
use crate::run;
use clap::Parser;
use m4_io::video::{DecoderProgram, serve_decoder, set_decoder_program};
use minute4d::Category;
use std::ffi::OsString;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// A command line of a program of ours.
pub trait Program: Parser + Sync {
    /// The options that all commands have.
    fn common(&self) -> &Common;

    /// Runs the command.
    ///
    /// # Errors
    ///
    /// [`Failure`] with the exit code and the message for the user.
    fn run(&self, output: &Output) -> Result<(), Failure>;
}

/// Parses the arguments of this process, the name of the program first, and runs their command;
/// returns its exit code.
#[must_use]
pub fn start<P: Program>(args: Vec<OsString>) -> ExitCode {
    if let Some(code) = serve_as_decoder(&args) {
        return code;
    }
    failure::report_instead_of_abort();
    register_decoder(&args);
    let program = match P::try_parse_from(&args) {
        Ok(program) => program,
        Err(error) => return refuse(&error, &args),
    };
    let common = program.common();
    let output = Output::new(common.json, common.quiet);
    output::watch_signals(&output);
    if common.stop_at_eof {
        output.stop().of_an_engine();
        output::stop_at_eof(&output);
    }
    let threads = common.threads.map(usize::from);
    let command = || run::with_threads(threads, || program.run(&output))?;
    let outcome = catch_unwind(AssertUnwindSafe(command))
        .map(|ended| ended.map_err(|failure| stopped(failure, &output)));
    let (code, reason) = match outcome {
        Ok(Ok(())) => (0, "done".to_owned()),
        Ok(Err(Failure { code, reason })) => (code, reason),
        Err(_) => (1, failure::last_report()),
    };
    ExitCode::from(output.end(code, &reason))
}

/// Gives a command that ended because of a signal the exit code of that signal.
fn stopped(failure: Failure, output: &Output) -> Failure {
    match output.stop().code() {
        Some(code) if failure.code == Category::Stopped.exit_code() => Failure { code, ..failure },
        _ => failure,
    }
}

/// Returns the path of this program, which runs parts of some commands in processes of their own.
///
/// # Errors
///
/// [`Failure`] where the system does not know it.
pub fn program() -> Result<PathBuf, Failure> {
    std::env::current_exe().map_err(|e| {
        minute4d::Error::internal(format!("the path of this program is unknown: {e}")).into()
    })
}

/// Returns the error without the usage that follows it.
fn first_paragraph(text: &str) -> String {
    let words = text
        .lines()
        .take_while(|line| !line.trim().is_empty())
        .flat_map(str::split_whitespace);
    let joined = words.collect::<Vec<_>>().join(" ");
    joined.strip_prefix("error: ").unwrap_or(&joined).to_owned()
}

/// Prints what clap has to say: wrong arguments, `--help` or `--version`.
fn refuse(error: &clap::Error, args: &[OsString]) -> ExitCode {
    if !error.use_stderr() {
        output::delivered(error.print().and_then(|()| std::io::stdout().flush()));
        return output::lost().map_or(ExitCode::SUCCESS, |lost| {
            output::to_stderr(&format!("minute4d: {lost}"));
            ExitCode::from(Category::CannotWrite.exit_code())
        });
    }
    output::to_stderr(error.to_string().trim_end());
    let json = args
        .iter()
        .take_while(|arg| *arg != "--")
        .any(|arg| arg == "--json");
    if json {
        output::end_of_json(2, &first_paragraph(&error.to_string()));
    }
    ExitCode::from(2)
}

/// The first argument of a decoder process. It is internal and not shown in the help.
const ARGUMENT: &str = "__decode-h264";

/// Runs the decoder if this process was started as one; returns its exit code.
fn serve_as_decoder(args: &[OsString]) -> Option<ExitCode> {
    if args.get(1).is_none_or(|arg| arg != ARGUMENT) {
        return None;
    }
    let served = serve_decoder(
        &args[2..],
        std::io::stdin().lock(),
        std::io::stdout().lock(),
    );
    Some(match served {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::to_stderr(&format!("minute4d {ARGUMENT}: {error}"));
            ExitCode::FAILURE
        }
    })
}

/// Registers this program as the one to start for decoding.
fn register_decoder(args: &[OsString]) {
    // On Linux this is the file of the running program, even if another version was installed over
    // it since.
    let running = Path::new("/proc/self/exe");
    let program = if cfg!(target_os = "linux") && running.exists() {
        running.to_path_buf()
    } else {
        let by_name = || PathBuf::from(args.first().cloned().unwrap_or_else(|| "minute4d".into()));
        std::env::current_exe().unwrap_or_else(|_| by_name())
    };
    // No other code registers a program, so this cannot fail.
    let _ = set_decoder_program(DecoderProgram::new(program, ARGUMENT));
}
