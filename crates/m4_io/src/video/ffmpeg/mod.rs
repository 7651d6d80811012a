//! Clips decoded by `ffmpeg`, a child process that sends raw images through a pipe.
//!
//! The child is a separate program of the user's machine: nothing is linked, and a decoder that
//! crashes on a damaged file takes only itself down. It turns images upright itself.

mod probe;
mod read;

pub use read::read;

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
        .args(["-hide_banner", "-protocol_whitelist", "file", "-format_whitelist", FORMATS])
        .args(options)
        .arg("-i")
        .arg(name);
    Ok(command)
}

/// How such a command is started.
pub fn start(launcher: Option<&DecoderProgram>) -> Start {
    Start { talks: false, bare: launcher.is_none() }
}

/// A frame that is about to come through the pipe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameInfo {
    /// Seconds; `None` where the stream has no time stamps.
    pub time_s: Option<f64>,
    pub width: usize,
    pub height: usize,
    /// Width of a pixel over its height, upright.
    pub pixel_aspect: f64,
}

/// One line of the log.
#[derive(Debug, Clone, PartialEq)]
pub enum Line {
    Frame(FrameInfo),
    Error(String),
    Other,
}

/// Reads a line written with `-loglevel level+info`.
pub fn parse(line: &str) -> Line {
    if line.contains("Parsed_showinfo") && line.contains(" n:") && line.contains(" pts_time:") {
        return frame(line).map_or(Line::Other, Line::Frame);
    }
    match ["[error]", "[fatal]", "[panic]"].iter().find_map(|tag| line.split_once(tag)) {
        Some((_, message)) => Line::Error(message.trim().to_owned()),
        None => Line::Other,
    }
}

fn frame(line: &str) -> Option<FrameInfo> {
    let value = |key: &str| line.split_once(key).and_then(|(_, rest)| rest.split_whitespace().next());
    let (width, height) = value(" s:")?.split_once('x')?;
    let aspect = value(" sar:").and_then(|v| v.split_once('/'));
    let aspect = aspect.and_then(|(n, d)| Some(n.parse::<f64>().ok()? / d.parse::<f64>().ok()?));
    Some(FrameInfo {
        time_s: value(" pts_time:").and_then(|v| v.parse().ok()).filter(|t: &f64| t.is_finite()),
        width: width.parse().ok()?,
        height: height.parse().ok()?,
        // 0/1 and 0/0 mean that the file does not say.
        pixel_aspect: aspect.filter(|a| (0.1..=10.0).contains(a)).unwrap_or(1.0),
    })
}

#[cfg(test)]
mod tests {
    use super::{FrameInfo, Line, parse, probe_beside};
    use std::path::Path;

    #[test]
    fn the_probe_is_looked_for_beside_the_decoder() {
        assert_eq!(probe_beside(Path::new("ffmpeg")), Path::new("ffprobe"));
        assert_eq!(probe_beside(Path::new("/opt/bin/ffmpeg")), Path::new("/opt/bin/ffprobe"));
        assert_eq!(probe_beside(Path::new("ffmpeg.exe")), Path::new("ffprobe.exe"));
    }

    #[test]
    fn lines_of_ffmpeg_5_are_understood() {
        let line = "[Parsed_showinfo_0 @ 0x5581] [info] n:   3 pts:   1536 pts_time:0.125   pos:    36872 fmt:yuv420p sar:4/3 s:480x360 i:P iskey:0 type:B checksum:0 plane_checksum:[] mean:[96 ] stdev:[ 1.0 ]";
        let want = FrameInfo { time_s: Some(0.125), width: 480, height: 360, pixel_aspect: 4.0 / 3.0 };
        assert_eq!(parse(line), Line::Frame(want));
        let line = "[Parsed_showinfo_0 @ 0x5581] [info] n:   3 pts: NOPTS pts_time:NOPTS pos: -1 fmt:yuv420p sar:0/1 s:48x36 i:P";
        assert_eq!(parse(line), Line::Frame(FrameInfo { time_s: None, width: 48, height: 36, pixel_aspect: 1.0 }));
        assert_eq!(
            parse("[h264 @ 0x1] [error] error while decoding MB 1 2"),
            Line::Error("error while decoding MB 1 2".into())
        );
        assert_eq!(
            parse("[Parsed_showinfo_0 @ 0x5581] [info] config in time_base: 1/12288, frame_rate: 24/1"),
            Line::Other
        );
        assert_eq!(parse("  Stream #0:0: Video: hevc [error-free]"), Line::Other);
    }
}
