//! H.264 is decoded by this same program, started once more: what breaks the decoder breaks that process alone.

use minute4d::io::video::{DecoderProgram, serve_decoder, set_decoder_program};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// The first argument of such a start. It is no command for people.
const ARGUMENT: &str = "__decode-h264";

/// Decodes, where that is what this process was started for.
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

/// Has clips decoded by processes of this program.
pub fn register(args: &[OsString]) {
    // On Linux the very file that runs, even when another version was installed over it since.
    let running = Path::new("/proc/self/exe");
    let program = if cfg!(target_os = "linux") && running.exists() {
        running.to_path_buf()
    } else {
        let by_name = || PathBuf::from(args.first().cloned().unwrap_or_else(|| "minute4d".into()));
        std::env::current_exe().unwrap_or_else(|_| by_name())
    };
    // Nothing else registers one.
    let _ = set_decoder_program(DecoderProgram::new(program, ARGUMENT));
}
