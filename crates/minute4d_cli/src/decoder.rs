//! Decodes H.264 in a second process of this program, so that a crash of the decoder ends that process alone.

use minute4d::io::video::{DecoderProgram, serve_decoder, set_decoder_program};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// The first argument of a decoder process. It is internal and not shown in the help.
const ARGUMENT: &str = "__decode-h264";

/// Runs the decoder if this process was started as one; returns its exit code.
pub fn serve(args: &[OsString]) -> Option<ExitCode> {
    if args.get(1).is_none_or(|arg| arg != ARGUMENT) {
        return None;
    }
    let served = serve_decoder(&args[2..], std::io::stdin().lock(), std::io::stdout().lock());
    Some(match served {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            crate::output::to_stderr(&format!("minute4d {ARGUMENT}: {error}"));
            ExitCode::FAILURE
        }
    })
}

/// Registers this program as the one to start for decoding.
pub fn register(args: &[OsString]) {
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
