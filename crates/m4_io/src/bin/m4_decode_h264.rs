//! Decodes H.264 for `m4_io::video` in a separate process: see `m4_io::video::set_decoder_program`.
#![forbid(unsafe_code)]

use std::io::Write;
use std::process::ExitCode;

fn main() -> ExitCode {
    // The first is that of the registration.
    let limits: Vec<_> = std::env::args_os().skip(2).collect();
    match m4_io::video::serve_decoder(&limits, std::io::stdin().lock(), std::io::stdout().lock()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            // If the output is closed, the error cannot be reported.
            let _ = writeln!(std::io::stderr(), "m4_decode_h264: {e}");
            ExitCode::FAILURE
        }
    }
}
