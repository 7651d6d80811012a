//! The registered program that decodes H.264.

use super::Allowed;
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::Command;
use std::sync::OnceLock;

static REGISTERED: OnceLock<DecoderProgram> = OnceLock::new();

/// A program that calls [`super::super::serve_decoder`], and what it must be told to do so. The limits are
/// two more arguments, behind these; on Linux a command line may follow, which the program becomes under these limits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DecoderProgram {
    /// Its file, or a name on the PATH.
    pub program: PathBuf,
    /// Its first arguments.
    pub arguments: Vec<OsString>,
}

impl DecoderProgram {
    /// A program, and the argument that makes it a decoder.
    pub fn new(program: impl Into<PathBuf>, argument: impl Into<OsString>) -> Self {
        Self {
            program: program.into(),
            arguments: vec![argument.into()],
        }
    }

    /// The command that starts it under these limits.
    pub(crate) fn command(&self, allowed: &Allowed) -> Command {
        let mut command = Command::new(&self.program);
        command
            .args(&self.arguments)
            .arg(allowed.memory_bytes.to_string())
            .arg(allowed.cpu_s.to_string());
        command
    }
}

/// From now on [`super::super::read()`] has H.264 decoded by `program`, in a process of its own, and on Linux ffmpeg
/// started by it, so that it is limited before it reads a byte. A program calls this once, at its start, most often with
/// [`std::env::current_exe`]; without it OpenH264 decodes inside of the calling process.
///
/// # Errors
///
/// The program, if another one was registered before.
pub fn set_decoder_program(program: DecoderProgram) -> Result<(), DecoderProgram> {
    REGISTERED.set(program)
}

/// The program that was registered.
#[must_use]
pub fn decoder_program() -> Option<&'static DecoderProgram> {
    REGISTERED.get()
}
