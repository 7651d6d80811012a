//! Which part of a clip is read, how large, and within which limits: the options, the frames to
//! keep, and their memory.

use super::decoder::DecoderLimits;
use crate::Fault;
use m4_core::{ResizeFilter, RgbImage, Video, VideoFrame, evenly, resize_rgb};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Slack when comparing times that went through text with microseconds.
const TIME_SLACK_S: f64 = 1e-5;

/// Fails unless every option can be.
pub fn check_options(options: &VideoOptions) -> Result<(), Fault> {
    let bad = |option: &str, value: String, expected: &str| {
        Fault::option(format!("the video option {option} is {value}"), expected)
    };
    if options.max_frames == Some(0) {
        return Err(bad(
            "max_frames",
            "0".into(),
            "at least 1 frame must be kept",
        ));
    }
    if let Some(size) = options.size.filter(|&s| !(16..=16_384).contains(&s)) {
        return Err(bad(
            "size",
            size.to_string(),
            "16 to 16384 pixels were expected",
        ));
    }
    for (option, value) in [("start_s", options.start_s), ("end_s", options.end_s)] {
        if let Some(value) = value.filter(|v| !(v.is_finite() && *v >= 0.0)) {
            return Err(bad(
                option,
                value.to_string(),
                "seconds, not below 0, were expected",
            ));
        }
    }
    if let (Some(start), Some(end)) = (options.start_s, options.end_s)
        && start > end
    {
        return Err(bad(
            "start_s",
            start.to_string(),
            "the start must come before the end (end_s)",
        ));
    }
    if !(options.folder_fps.is_finite() && options.folder_fps > 0.0) {
        let expected = "frames per second, above 0, were expected";
        return Err(bad("folder_fps", options.folder_fps.to_string(), expected));
    }
    options.decoder.check()
}

/// True for a moment between the start and the end that were asked for.
pub fn in_range(time_s: f64, options: &VideoOptions) -> bool {
    options.start_s.is_none_or(|s| time_s >= s - TIME_SLACK_S)
        && options.end_s.is_none_or(|s| time_s <= s + TIME_SLACK_S)
}

/// Indices of the frames to keep, given when each is shown: seconds from the first, in order.
pub fn select(times_s: &[f64], options: &VideoOptions) -> Result<Vec<usize>, Fault> {
    let inside: Vec<usize> = (0..times_s.len())
        .filter(|&i| in_range(times_s[i], options))
        .collect();
    if inside.is_empty() {
        return Err(nothing_in_range(
            times_s.last().copied().unwrap_or(0.0),
            options,
        ));
    }
    let inside_s: Vec<f64> = inside.iter().map(|&i| times_s[i]).collect();
    Ok(among(&inside_s, options)
        .into_iter()
        .map(|i| inside[i])
        .collect())
}

/// Indices of the frames to keep among those in the range, which are shown at `inside_s`.
pub fn among(inside_s: &[f64], options: &VideoOptions) -> Vec<usize> {
    let Some(times_s) = &options.times_s else {
        return evenly(inside_s.len(), options.max_frames);
    };
    let nearest = |time_s: &f64| {
        let after = inside_s.partition_point(|t| t < time_s);
        let near = [after.checked_sub(1), Some(after)].into_iter().flatten();
        near.filter(|&i| i < inside_s.len()).min_by(|&a, &b| {
            (inside_s[a] - time_s)
                .abs()
                .total_cmp(&(inside_s[b] - time_s).abs())
        })
    };
    let mut chosen: Vec<usize> = times_s.iter().filter_map(nearest).collect();
    chosen.sort_unstable();
    chosen.dedup();
    chosen
}

/// The error of a range that holds no frame.
pub fn nothing_in_range(duration_s: f64, options: &VideoOptions) -> Fault {
    let (start, end) = (
        options.start_s.unwrap_or(0.0),
        options.end_s.unwrap_or(duration_s),
    );
    let what = format!("it lasts {duration_s:.2} s and has no frame in {start:.2} s to {end:.2} s");
    Fault::bad(what, "change the start and the end")
}

/// The fault of a clip whose frames change their size.
pub fn size_changes(from: (usize, usize), to: (usize, usize), time_s: f64) -> Fault {
    let what = format!(
        "its size changes from {} x {} to {} x {} at {time_s:.2} s",
        from.0, from.1, to.0, to.1
    );
    Fault::unsupported(what, "split it there")
}

/// The size of kept frames: `width` x `height` as displayed, shrunk so that the longest side fits.
pub fn target_size(width: f64, height: f64, options: &VideoOptions) -> (usize, usize) {
    let longest = width.max(height);
    let scale = match options.size {
        Some(size) if (size as f64) < longest => size as f64 / longest,
        _ => 1.0,
    };
    let side = |v: f64| ((v * scale).round() as usize).max(1);
    (side(width), side(height))
}

/// Refuses before anything is decoded.
pub fn check_memory(
    frames: usize,
    size: (usize, usize),
    options: &VideoOptions,
) -> Result<(), Fault> {
    let needed_bytes = [size.0, size.1, 3]
        .iter()
        .fold(frames as u64, |n, &side| n.saturating_mul(side as u64));
    if needed_bytes <= options.max_memory_bytes {
        return Ok(());
    }
    let (needed, limit) = (needed_bytes >> 20, options.max_memory_bytes >> 20);
    let what = format!(
        "{frames} frames of {} x {} pixels take {needed} MiB of memory, above the limit of {limit} MiB",
        size.0, size.1
    );
    let hint = "keep fewer frames (max_frames), a shorter part (start_s, end_s) or smaller frames (size), or raise the limit \
                (max_memory_bytes)";
    Err(Fault::unsupported(what, hint))
}

/// Gathers kept frames at the target size.
pub struct Collector {
    size: (usize, usize),
    frames: Vec<VideoFrame>,
    /// For [`Video::warnings`].
    pub warnings: Vec<String>,
}

impl Collector {
    pub fn new(size: (usize, usize)) -> Self {
        Self {
            size,
            frames: Vec::new(),
            warnings: Vec::new(),
        }
    }

    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Takes an upright frame of any size.
    pub fn push(&mut self, rgb: RgbImage, time_s: f64) {
        let rgb = if rgb.size() == self.size {
            Some(rgb)
        } else {
            resize_rgb(&rgb, self.size.0, self.size.1, ResizeFilter::Triangle)
        };
        // Both sizes are at least one pixel and at most what a decoder allows.
        if let Some(rgb) = rgb {
            self.frames.push(VideoFrame { rgb, time_s });
        }
    }

    /// The clip, in order of time; `None` without frames.
    pub fn finish(mut self, in_range: usize, focal_px: Option<f64>) -> Option<Video> {
        self.frames.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        (!self.frames.is_empty()).then_some(Video {
            frames: self.frames,
            in_range,
            warnings: self.warnings,
            focal_px,
        })
    }
}

/// The warning of a clip that was thinned; none where the caller chose the frames.
pub fn thinned(n_kept: usize, of: usize, options: &VideoOptions) -> Option<String> {
    (n_kept < of && options.times_s.is_none())
        .then(|| format!("read {n_kept} of {of} frames, evenly spaced"))
}

/// The warning of a clip of which `n` of `of` frames are damaged and were left out; its fault with
/// [`VideoOptions::strict`].
pub fn damaged(n: usize, of: usize, first: &str, options: &VideoOptions) -> Result<String, Fault> {
    if options.strict {
        let what = format!("{n} of {of} frames are damaged (the first {first})");
        return Err(Fault::bad(
            what,
            "they are left out unless reading is strict",
        ));
    }
    Ok(format!(
        "{n} of {of} frames are damaged or missing and were left out, the first {first}"
    ))
}

/// Settings of [`super::read()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VideoOptions {
    /// Keep at most this many frames, evenly spaced from the first to the last. Default: all.
    pub max_frames: Option<usize>,
    /// Keep the frames that are shown nearest to these times, seconds from the first frame, in
    /// place of evenly spaced ones. For callers in Rust.
    #[serde(skip)]
    pub times_s: Option<Vec<f64>>,
    /// Shrink frames so that their longest side has this many pixels; smaller frames stay as they
    /// are. Default 640, between the 480 of the paper's DyCheck runs and the width of 360p video.
    /// `None` keeps the size of the file.
    pub size: Option<usize>,
    /// Leave out what is shown before, seconds from the first frame. Default: nothing.
    pub start_s: Option<f64>,
    /// Leave out what is shown after, seconds from the first frame. Default: nothing.
    pub end_s: Option<f64>,
    /// Damaged frames are an error, in place of being left out with a warning. Default false.
    pub strict: bool,
    /// Bytes that the frames (3 per pixel, after shrinking) may take before reading is refused.
    /// Default 4 GiB: half of the memory of a small laptop.
    pub max_memory_bytes: u64,
    /// Frames per second of a folder of images, which has no times of its own. Default 30.
    pub folder_fps: f64,
    /// The program that decodes what this one does not (all but 8-bit H.264 in MP4 and MOV files);
    /// `ffprobe` is expected beside it. Default `ffmpeg`, looked up on the PATH.
    pub ffmpeg: PathBuf,
    /// What the processes that decode may take.
    pub decoder: DecoderLimits,
}

impl Default for VideoOptions {
    fn default() -> Self {
        Self {
            max_frames: None,
            times_s: None,
            size: Some(640),
            start_s: None,
            end_s: None,
            strict: false,
            max_memory_bytes: 4 << 30,
            folder_fps: 30.0,
            ffmpeg: PathBuf::from("ffmpeg"),
            decoder: DecoderLimits::default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{VideoOptions, among};

    #[test]
    fn frames_at_given_times_are_the_nearest() {
        let shown = [0.0, 0.1, 0.2, 0.5, 0.9];
        let at = |times: &[f64]| {
            let options = VideoOptions {
                times_s: Some(times.to_vec()),
                ..VideoOptions::default()
            };
            among(&shown, &options)
        };
        assert_eq!(at(&[0.1, 0.5]), [1, 3]);
        assert_eq!(at(&[-1.0, 0.1004, 0.36, 7.0]), [0, 1, 3, 4]);
        assert_eq!(at(&[0.9, 0.1, 0.1]), [1, 4]);
        assert!(at(&[]).is_empty());
    }
}
