//! The command lines of ffmpeg and ffprobe.

use crate::video::decoder::{self, Allowed, DecoderProgram, Start};
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

/// `ffprobe` beside `ffmpeg`.
pub fn probe_beside(ffmpeg: &Path) -> PathBuf {
    let name = ffmpeg.file_name().and_then(|n| n.to_str()).unwrap_or("ffmpeg");
    ffmpeg.with_file_name(name.replacen("ffmpeg", "ffprobe", 1))
}

/// Containers that are taken apart: those of clips that hold their images themselves. Lists of other files (`hls`,
/// `concat`, `dash`, ...) and descriptions of streams (`sdp`) are not among them. What a build does not know is
/// passed over.
const FORMATS: &str = "3g2,apng,asf,av1,avi,dv,flv,gif,h264,hevc,ivf,m4v,matroska,mj2,mjpeg,mov,mp4,mpeg,mpegts,mpegtsraw,\
                       mpegvideo,mxf,nut,obu,ogg,rm,vc1,vvc,webm,wtv,yuv4mpegpipe";

/// A command that reads one local file and nothing else: no network, no other file that the clip may name, and the
/// file name cannot be taken for an option or a protocol.
///
/// # Errors
///
/// That there is no such program.
pub fn command(
    (launcher, program): (Option<&DecoderProgram>, &Path),
    allowed: &Allowed,
    options: &[&str],
    input: &Path,
) -> io::Result<Command> {
    let mut name = std::ffi::OsString::from("file:");
    name.push(input);
    let mut command = decoder::command(launcher, program, allowed)?;
    command
        .args([
            "-hide_banner",
            "-protocol_whitelist",
            "file",
            "-format_whitelist",
            FORMATS,
        ])
        .args(options)
        .arg("-i")
        .arg(name);
    Ok(command)
}

/// How such a command is started.
pub fn start(launcher: Option<&DecoderProgram>) -> Start {
    Start {
        talks: false,
        bare: launcher.is_none(),
    }
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
