//! Parses the output of `ffprobe`: codec, colours, and the time of each frame.

use super::{command, probe_beside, start};
use crate::Fault;
use crate::video::VideoOptions;
use crate::video::colour::Hdr;
use crate::video::decoder::{Child, DecoderEnd, DecoderProgram, Halt, NOT_STARTED, Work, is_of_data};
use crate::video::read::not_video;
use m4_core::Progress;
use serde::Deserialize;
use std::path::Path;

/// Longest description that is read, bytes: some 100 per frame, so a million frames.
const MAX_OUTPUT_BYTES: usize = 256 << 20;
/// Most bytes of complaints.
const MESSAGE_BYTES: u64 = 64 << 20;
/// Pixels of 8K, since the size is not known before: finding the format may take decoding some images.
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

/// Describes the first video stream of `path`, or `None` when there is no such stream.
pub fn describe(
    path: &Path,
    what: &str,
    options: &VideoOptions,
    launcher: Option<&DecoderProgram>,
    progress: &dyn Progress,
) -> Result<Option<Description>, Fault> {
    let program = probe_beside(&options.ffmpeg);
    // V: no cover images.
    let entries = "stream=codec_name,pix_fmt,color_space,color_transfer,width,height,field_order:packet=pts_time,flags";
    let arguments = ["-v", "error", "-of", "json", "-select_streams", "V:0", "-show_entries", entries];
    let work = Work { pixels: MAX_PIXELS, frames: 0, bytes: std::fs::metadata(path).map_or(0, |m| m.len()) };
    let allowed = options.decoder.allowed(work);
    let child = command((launcher, &program), &allowed, &arguments, path).and_then(|mut command| {
        let on_line = Box::new(|_: &str| true);
        Child::start(&mut command, start(launcher), allowed, MESSAGE_BYTES, on_line, progress)
    });
    let mut child = child.map_err(|e| needed(what, &program, &e.to_string()))?;
    let text = child.read_to_end(MAX_OUTPUT_BYTES).map_err(|halt| halt.fault("ffprobe"))?;
    let Some(text) = text else {
        return Err(undecoded("it has more than two million frames"));
    };
    let exit = child.finish().map_err(|halt| halt.fault("ffprobe"))?;
    if !exit.status.success() {
        let how = child.why(&exit);
        if !matches!(how, DecoderEnd::Answer { .. }) {
            return Err(Halt::Failed(how).fault("ffprobe"));
        }
        let message = child.message();
        let last = message.last().map_or("no reason given", String::as_str);
        if let Some((_, reason)) = last.split_once(NOT_STARTED).filter(|_| launcher.is_some()) {
            return Err(needed(what, &program, reason));
        }
        if !message.iter().any(|line| is_of_data(line)) {
            let what = format!("it says {:?}", last.trim());
            return Err(Halt::Failed(DecoderEnd::Answer { what }).fault("ffprobe"));
        }
        let name = format!("file:{}: ", path.display());
        return Err(not_video(&format!("ffprobe says {:?}", last.trim().trim_start_matches(&name))));
    }
    let output: Output = serde_json::from_slice(&text).map_err(|e| undecoded(&format!("ffprobe answered: {e}")))?;
    Ok(output.streams.first().map(|stream| summary(stream, &output.packets)))
}

/// The clip needs `program` of ffmpeg, and there is none.
pub fn needed(what: &str, program: &Path, reason: &str) -> Fault {
    let what =
        format!("it is {what}, which is decoded by ffmpeg, and `{}` cannot be started ({reason})", program.display());
    let hint = "install ffmpeg (apt, brew or winget install ffmpeg) or convert the clip to 8-bit H.264 elsewhere: ffmpeg -i IN \
                -c:v libx264 -pix_fmt yuv420p OUT.mp4";
    Fault::unavailable(what, hint)
}

/// ffmpeg gave up.
pub fn undecoded(reason: &str) -> Fault {
    let what = format!("ffmpeg cannot decode it: {reason}");
    Fault::bad(what, "see whether a player shows it, and copy or export it again")
}

fn summary(stream: &Stream, packets: &[Packet]) -> Description {
    // D: decoded, but outside of the edit list.
    let shown: Vec<&Packet> = packets.iter().filter(|p| !p.flags.contains('D')).collect();
    let times: Option<Vec<f64>> = shown.iter().map(|p| p.pts_time.as_deref()?.parse().ok()).collect();
    let times_s = times.map(|mut times| {
        times.sort_by(f64::total_cmp);
        let first = times.first().copied().unwrap_or(0.0);
        times.iter_mut().for_each(|t| *t -= first);
        times
    });
    let rgb = stream.pix_fmt.as_deref().is_some_and(|f| f.contains("rgb") || f.contains("gbr"));
    Description {
        codec: stream.codec_name.clone(),
        hdr: stream.color_transfer.as_deref().and_then(Hdr::from_name),
        matrix_known: rgb || stream.color_space.as_deref().is_some_and(|s| s != "unknown" && s != "reserved"),
        interlaced: matches!(stream.field_order.as_deref(), Some("tt" | "bb" | "tb" | "bt")),
        pixels: (stream.width as u64).saturating_mul(stream.height as u64),
        height: stream.height,
        times_s,
        packets: shown.len(),
    }
}
