//! Clips decoded by `ffmpeg`, a child process that sends raw images through a pipe.
//!
//! The child is a separate program of the user's machine: nothing is linked, and a decoder that
//! crashes on a damaged file takes only itself down. It turns images upright itself.

mod read;

pub use read::read;

use super::colour::Hdr;
use super::decoder::{self, Allowed, Child, DecoderProgram, NOT_STARTED, Start, Work, is_of_data};
use super::read::{Request, not_video};
use crate::{DecoderEnd, Fault};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::process::Command;

/// `ffprobe` beside `ffmpeg`.
pub fn probe_beside(ffmpeg: &Path) -> PathBuf {
    let name = ffmpeg
        .file_name()
        .and_then(|n| n.to_str())
        .unwrap_or("ffmpeg");
    ffmpeg.with_file_name(name.replacen("ffmpeg", "ffprobe", 1))
}

/// Containers that hold their images themselves: no lists of other files (`hls`, `concat`, `dash`,
/// ...), no `sdp`.
const FORMATS: &str = "3g2,apng,asf,av1,avi,dv,flv,gif,h264,hevc,ivf,m4v,matroska,mj2,mjpeg,mov,mp4,mpeg,mpegts,mpegtsraw,\
                       mpegvideo,mxf,nut,obu,ogg,rm,vc1,vvc,webm,wtv,yuv4mpegpipe";

/// A command that reads one local file and nothing else: no network, no file that the clip names,
/// no option or protocol.
pub fn command(
    request: Request<'_>,
    program: &Path,
    allowed: &Allowed,
    options: &[&str],
) -> Command {
    let mut name = std::ffi::OsString::from("file:");
    name.push(request.path);
    let mut command = decoder::command(request.decoder, program, allowed);
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
    command
}

/// How such a command is started.
pub fn start(decoder: &'static str, launcher: Option<&DecoderProgram>) -> Start {
    Start {
        decoder,
        talks: false,
        bare: launcher.is_none(),
    }
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
    match ["[error]", "[fatal]", "[panic]"]
        .iter()
        .find_map(|tag| line.split_once(tag))
    {
        Some((_, message)) => Line::Error(message.trim().to_owned()),
        None => Line::Other,
    }
}

fn frame(line: &str) -> Option<FrameInfo> {
    let value = |key: &str| {
        line.split_once(key)
            .and_then(|(_, rest)| rest.split_whitespace().next())
    };
    let (width, height) = value(" s:")?.split_once('x')?;
    let aspect = value(" sar:").and_then(|v| v.split_once('/'));
    let aspect = aspect.and_then(|(n, d)| Some(n.parse::<f64>().ok()? / d.parse::<f64>().ok()?));
    Some(FrameInfo {
        time_s: value(" pts_time:")
            .and_then(|v| v.parse().ok())
            .filter(|t: &f64| t.is_finite()),
        width: width.parse().ok()?,
        height: height.parse().ok()?,
        // 0/1 and 0/0 mean that the file does not say.
        pixel_aspect: aspect.filter(|a| (0.1..=10.0).contains(a)).unwrap_or(1.0),
    })
}

/// Longest description that is read, bytes: some 100 per frame, so a million frames.
const MAX_OUTPUT_BYTES: usize = 256 << 20;
/// Most bytes of complaints.
const MESSAGE_BYTES: u64 = 64 << 20;
/// Pixels of 8K, since the size is not known before: finding the format may take decoding some
/// images.
const MAX_PIXELS: u64 = 7680 * 4320;

#[derive(Debug, Deserialize)]
struct Output {
    #[serde(default)]
    streams: Vec<Stream>,
    #[serde(default)]
    packets: Vec<Packet>,
}

#[derive(Debug, Default, Deserialize)]
struct Stream {
    #[serde(default)]
    codec_name: String,
    color_space: Option<String>,
    color_transfer: Option<String>,
    #[serde(default)]
    width: usize,
    #[serde(default)]
    height: usize,
    field_order: Option<String>,
    pix_fmt: Option<String>,
}

#[derive(Debug, Deserialize)]
struct Packet {
    pts_time: Option<String>,
    #[serde(default)]
    flags: String,
}

/// A clip as it is described before decoding.
#[derive(Debug)]
pub struct Description {
    /// As in `hevc`.
    pub codec: String,
    /// Set for PQ and HLG.
    pub hdr: Option<Hdr>,
    /// The stream says which YUV matrix it has.
    pub matrix_known: bool,
    /// Images are woven from two fields.
    pub interlaced: bool,
    /// Pixels of an image as coded.
    pub pixels: u64,
    /// Rows as coded, which the guess of the YUV matrix depends on.
    pub height: usize,
    /// Seconds, in order; `None` where some packets have no time stamp.
    pub times_s: Option<Vec<f64>>,
    /// Images that will be shown.
    pub packets: usize,
}

/// Describes the first video stream, or `None` when there is no such stream.
pub fn describe(request: Request<'_>, what: &str) -> Result<Option<Description>, Fault> {
    let Request {
        path,
        options,
        decoder: launcher,
        progress,
    } = request;
    let program = probe_beside(&options.ffmpeg);
    // V: no cover images.
    let entries = "stream=codec_name,pix_fmt,color_space,color_transfer,width,height,field_order:packet=pts_time,flags";
    let arguments = [
        "-v",
        "error",
        "-of",
        "json",
        "-select_streams",
        "V:0",
        "-show_entries",
        entries,
    ];
    let work = Work {
        pixels: MAX_PIXELS,
        frames: 0,
        bytes: std::fs::metadata(path).map_or(0, |m| m.len()),
    };
    let allowed = options.decoder.allowed(work);
    let mut command = command(request, &program, &allowed, &arguments);
    let on_line = Box::new(|_: &str| true);
    let child = Child::start(
        &mut command,
        start("ffprobe", launcher),
        allowed,
        MESSAGE_BYTES,
        on_line,
        progress,
    );
    let mut child = child.map_err(|e| needed(what, &program, &e.to_string()))?;
    let text = child.read_to_end(MAX_OUTPUT_BYTES)?;
    let Some(text) = text else {
        return Err(undecoded("it has more than two million frames"));
    };
    let exit = child.finish()?;
    if !exit.status.success() {
        let how = child.why(&exit);
        if !matches!(how, DecoderEnd::Answer { .. }) {
            return Err(child.failed(how));
        }
        let message = child.message();
        let last = message.last().map_or("no reason given", String::as_str);
        if let Some((_, reason)) = last.split_once(NOT_STARTED).filter(|_| launcher.is_some()) {
            return Err(needed(what, &program, reason));
        }
        if !message.iter().any(|line| is_of_data(line)) {
            let what = format!("it says {:?}", last.trim());
            return Err(child.failed(DecoderEnd::Answer { what }));
        }
        let name = format!("file:{}: ", path.display());
        return Err(not_video(&format!(
            "ffprobe says {:?}",
            last.trim().trim_start_matches(&name)
        )));
    }
    let output: Output =
        serde_json::from_slice(&text).map_err(|e| undecoded(&format!("ffprobe answered: {e}")))?;
    Ok(output
        .streams
        .first()
        .map(|stream| summary(stream, &output.packets)))
}

/// The clip needs `program` of ffmpeg, and there is none.
pub fn needed(what: &str, program: &Path, reason: &str) -> Fault {
    let what = format!(
        "it is {what}, which is decoded by ffmpeg, and `{}` cannot be started ({reason})",
        program.display()
    );
    let hint = "install ffmpeg (apt, brew or winget install ffmpeg) or convert the clip to 8-bit H.264 elsewhere: ffmpeg -i IN \
                -c:v libx264 -pix_fmt yuv420p OUT.mp4";
    Fault::unavailable(what, hint)
}

/// ffmpeg gave up.
pub fn undecoded(reason: &str) -> Fault {
    let what = format!("ffmpeg cannot decode it: {reason}");
    Fault::bad(
        what,
        "see whether a player shows it, and copy or export it again",
    )
}

fn summary(stream: &Stream, packets: &[Packet]) -> Description {
    // D: decoded, but outside of the edit list.
    let shown: Vec<&Packet> = packets.iter().filter(|p| !p.flags.contains('D')).collect();
    let times: Option<Vec<f64>> = shown
        .iter()
        .map(|p| p.pts_time.as_deref()?.parse().ok())
        .collect();
    let times_s = times.map(|mut times| {
        times.sort_by(f64::total_cmp);
        let first = times.first().copied().unwrap_or(0.0);
        times.iter_mut().for_each(|t| *t -= first);
        times
    });
    let rgb = stream
        .pix_fmt
        .as_deref()
        .is_some_and(|f| f.contains("rgb") || f.contains("gbr"));
    Description {
        codec: stream.codec_name.clone(),
        hdr: stream.color_transfer.as_deref().and_then(Hdr::from_name),
        matrix_known: rgb
            || stream
                .color_space
                .as_deref()
                .is_some_and(|s| s != "unknown" && s != "reserved"),
        interlaced: matches!(
            stream.field_order.as_deref(),
            Some("tt" | "bb" | "tb" | "bt")
        ),
        pixels: (stream.width as u64).saturating_mul(stream.height as u64),
        height: stream.height,
        times_s,
        packets: shown.len(),
    }
}

#[cfg(test)]
mod tests {
    use super::{FrameInfo, Line, parse, probe_beside};
    use std::path::Path;

    #[test]
    fn the_probe_is_looked_for_beside_the_decoder() {
        assert_eq!(probe_beside(Path::new("ffmpeg")), Path::new("ffprobe"));
        assert_eq!(
            probe_beside(Path::new("/opt/bin/ffmpeg")),
            Path::new("/opt/bin/ffprobe")
        );
        assert_eq!(
            probe_beside(Path::new("ffmpeg.exe")),
            Path::new("ffprobe.exe")
        );
    }

    #[test]
    fn lines_of_ffmpeg_5_are_understood() {
        let line = "[Parsed_showinfo_0 @ 0x5581] [info] n:   3 pts:   1536 pts_time:0.125   pos:    36872 fmt:yuv420p sar:4/3 s:480x360 i:P iskey:0 type:B checksum:0 plane_checksum:[] mean:[96 ] stdev:[ 1.0 ]";
        let want = FrameInfo {
            time_s: Some(0.125),
            width: 480,
            height: 360,
            pixel_aspect: 4.0 / 3.0,
        };
        assert_eq!(parse(line), Line::Frame(want));
        let line = "[Parsed_showinfo_0 @ 0x5581] [info] n:   3 pts: NOPTS pts_time:NOPTS pos: -1 fmt:yuv420p sar:0/1 s:48x36 i:P";
        assert_eq!(
            parse(line),
            Line::Frame(FrameInfo {
                time_s: None,
                width: 48,
                height: 36,
                pixel_aspect: 1.0
            })
        );
        assert_eq!(
            parse("[h264 @ 0x1] [error] error while decoding MB 1 2"),
            Line::Error("error while decoding MB 1 2".into())
        );
        assert_eq!(
            parse(
                "[Parsed_showinfo_0 @ 0x5581] [info] config in time_base: 1/12288, frame_rate: 24/1"
            ),
            Line::Other
        );
        assert_eq!(
            parse("  Stream #0:0: Video: hevc [error-free]"),
            Line::Other
        );
    }
}
