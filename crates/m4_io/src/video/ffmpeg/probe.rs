//! What `ffprobe` says about a clip: codec, colours, and when each frame is shown.

use super::child::{Guard, command, probe_beside};
use crate::video::ReadVideoError;
use crate::video::colour::Hdr;
use serde::Deserialize;
use std::io::Read;
use std::path::Path;

/// Longest description that is read, bytes: some 100 a frame, so a million frames.
const MAX_OUTPUT_BYTES: u64 = 256 << 20;

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
    /// Pictures are woven from two fields.
    pub interlaced: bool,
    /// Rows as coded, which the guess of the YUV matrix depends on.
    pub height: usize,
    /// Seconds, in order; `None` where some packets have no time stamp.
    pub times_s: Option<Vec<f64>>,
    /// Pictures that will be shown.
    pub packets: usize,
}

/// Describes the first video stream of `path`, or `None` when there is no such stream.
pub fn describe(path: &Path, ffmpeg: &Path, what: &str) -> Result<Option<Description>, ReadVideoError> {
    let program = probe_beside(ffmpeg);
    // V: no cover pictures.
    let entries = "stream=codec_name,pix_fmt,color_space,color_transfer,height,field_order:packet=pts_time,flags";
    let options = [
        "-v",
        "error",
        "-of",
        "json",
        "-select_streams",
        "V:0",
        "-show_entries",
        entries,
    ];
    let child = command(&program, &options, path).spawn();
    let mut child = Guard(child.map_err(|e| ReadVideoError::NeedsFfmpeg {
        path: path.to_path_buf(),
        what: what.to_owned(),
        ffmpeg: program.clone(),
        reason: e.to_string(),
    })?);
    let failed = |reason: String| ReadVideoError::Ffmpeg {
        path: path.to_path_buf(),
        reason,
    };
    let stderr = child.0.stderr.take();
    let complaints = std::thread::spawn(move || {
        let mut text = Vec::new();
        if let Some(stderr) = stderr {
            // A pipe that breaks is a child that ended, which its exit status tells.
            let _ = stderr.take(1 << 20).read_to_end(&mut text);
        }
        String::from_utf8_lossy(&text).into_owned()
    });
    let mut text = Vec::new();
    if let Some(stdout) = child.0.stdout.take() {
        let read = stdout.take(MAX_OUTPUT_BYTES + 1).read_to_end(&mut text);
        read.map_err(|e| failed(format!("ffprobe's answer could not be read: {e}")))?;
    }
    if text.len() as u64 > MAX_OUTPUT_BYTES {
        return Err(failed("it has more than two million frames".into()));
    }
    let status = child.0.wait().map_err(|e| failed(e.to_string()))?;
    let complaints = complaints.join().unwrap_or_default();
    if !status.success() {
        let last = complaints
            .lines()
            .rev()
            .find(|l| !l.trim().is_empty())
            .unwrap_or("no reason given");
        let name = format!("file:{}: ", path.display());
        return Err(ReadVideoError::NotVideo {
            path: path.to_path_buf(),
            reason: format!("ffprobe says {:?}", last.trim().trim_start_matches(&name)),
        });
    }
    let output: Output = serde_json::from_slice(&text).map_err(|e| failed(format!("ffprobe's answer: {e}")))?;
    Ok(output.streams.first().map(|stream| summary(stream, &output.packets)))
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
        interlaced: matches!(stream.field_order.as_deref(), Some("tt" | "bb" | "tb" | "bt")),
        height: stream.height,
        times_s,
        packets: shown.len(),
    }
}
