//! The `minute4d` program: commands, messages, exit codes. The work is done by the library.
#![forbid(unsafe_code)]

mod cli;
mod commands;
mod decoder;
mod failure;
mod options;
mod output;
mod panics;

use clap::Parser;
use cli::Cli;
use failure::Failure;
use output::{Output, StopSignal};
use std::ffi::OsString;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;

fn main() -> ExitCode {
    let args: Vec<OsString> = std::env::args_os().collect();
    if let Some(code) = decoder::serve(&args) {
        return code;
    }
    panics::report_instead_of_abort();
    decoder::register(&args);
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
        Err(_) => (1, panics::last_report()),
    };
    output.end(code, &reason);
    ExitCode::from(code)
}

/// Returns the error without the usage that follows it.
fn first_paragraph(text: &str) -> String {
    let words = text.lines().take_while(|line| !line.trim().is_empty()).flat_map(str::split_whitespace);
    let joined = words.collect::<Vec<_>>().join(" ");
    joined.strip_prefix("error: ").unwrap_or(&joined).to_owned()
}

/// Prints what clap has to say: wrong arguments, `--help` or `--version`.
fn refuse(error: &clap::Error, args: &[OsString]) -> ExitCode {
    // If the terminal is gone, the message is lost.
    let _ = error.print();
    if !error.use_stderr() {
        return ExitCode::SUCCESS;
    }
    let json = args.iter().take_while(|arg| *arg != "--").any(|arg| arg == "--json");
    if json {
        output::end_of_json(2, &first_paragraph(&error.to_string()));
    }
    ExitCode::from(2)
}
