//! Child processes that do not outlive their owner.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Ends the child when dropped: a reader that stops early must not leave a decoder running.
pub struct Guard(pub Child);

impl Drop for Guard {
    fn drop(&mut self) {
        // Both fail when the child has ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// `ffprobe` beside `ffmpeg`.
pub fn probe_beside(ffmpeg: &Path) -> PathBuf {
    let name = ffmpeg.file_name().and_then(|n| n.to_str()).unwrap_or("ffmpeg");
    ffmpeg.with_file_name(name.replacen("ffmpeg", "ffprobe", 1))
}

/// A command that reads one local file and nothing else: no standard input, no network, and the file
/// name cannot be taken for an option or a protocol.
pub fn command(program: &Path, options: &[&str], input: &Path) -> Command {
    let mut name = std::ffi::OsString::from("file:");
    name.push(input);
    let mut command = Command::new(program);
    command
        .args(["-hide_banner", "-protocol_whitelist", "file,pipe"])
        .args(options)
        .arg("-i")
        .arg(name)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

#[cfg(test)]
mod tests {
    use super::probe_beside;
    use std::path::Path;

    #[test]
    fn the_probe_is_looked_for_beside_the_decoder() {
        assert_eq!(probe_beside(Path::new("ffmpeg")), Path::new("ffprobe"));
        assert_eq!(
            probe_beside(Path::new("/opt/bin/ffmpeg")),
            Path::new("/opt/bin/ffprobe")
        );
        assert_eq!(probe_beside(Path::new("ffmpeg.exe")), Path::new("ffprobe.exe"));
    }
}
