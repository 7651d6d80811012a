//! The `minute4d` program: commands, messages, exit codes. The work is done by the library.

mod cli;
mod commands;
mod failure;
mod memory;
mod options;
mod output;

use clap::Parser;
use cli::Cli;
use failure::Failure;
use minute4d::Category;
use minute4d::m4_io::video::{DecoderProgram, serve_decoder, set_decoder_program};
use output::{Output, StopSignal};
use std::ffi::OsString;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

fn main() -> ExitCode {
    let args: Vec<OsString> = std::env::args_os().collect();
    if let Some(code) = serve_as_decoder(&args) {
        return code;
    }
    failure::report_instead_of_abort();
    register_decoder(&args);
    let cli = match Cli::try_parse_from(&args) {
        Ok(cli) => cli,
        Err(error) => return refuse(&error, &args),
    };
    let output = Output::new(cli.common.json, cli.common.quiet, StopSignal::default());
    output::watch_signals(&output);
    if cli.common.stop_at_eof {
        output.stop().of_an_engine();
        output::stop_at_eof(&output);
    }
    let outcome = catch_unwind(AssertUnwindSafe(|| commands::run(&cli, &output)));
    let (code, reason) = match outcome {
        Ok(Ok(())) => (0, "done".to_owned()),
        Ok(Err(Failure { code, reason })) => (code, reason),
        Err(_) => (1, failure::last_report()),
    };
    ExitCode::from(output.end(code, &reason))
}

/// Returns the error without the usage that follows it.
fn first_paragraph(text: &str) -> String {
    let words = text.lines().take_while(|line| !line.trim().is_empty()).flat_map(str::split_whitespace);
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
    let json = args.iter().take_while(|arg| *arg != "--").any(|arg| arg == "--json");
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
    let served = serve_decoder(&args[2..], std::io::stdin().lock(), std::io::stdout().lock());
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
    // On Linux this is the file of the running program, even if another version was installed over it since.
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
