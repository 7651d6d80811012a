//! Decodes a clip through `ffmpeg`.

use super::{Description, FrameInfo, Line, command, describe, needed, parse, start, undecoded};
use crate::video::VideoOptions;
use crate::video::colour::ToneMap;
use crate::video::decoder::{Child, Work, is_of_data, is_of_memory};
use crate::video::plan::{self, Collector};
use crate::video::read::{Request, no_frames, no_video_track};
use crate::{DecoderEnd, Fault};
use m4_core::{Plane, Progress, RgbImage, Video};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, PoisonError};

/// Largest image that is taken from the pipe, pixels: 16384 x 16384.
const MAX_PIXELS: usize = 1 << 28;
/// Complaints that are kept for a message.
const KEPT_COMPLAINTS: usize = 8;
/// Bytes of messages that are read at most, and more for every image: a line on each takes some
/// 300.
const MESSAGE_BYTES: u64 = 64 << 20;
const MESSAGE_BYTES_PER_IMAGE: u64 = 8 << 10;
/// Most threads for one clip, as ffmpeg itself would take.
const MAX_THREADS: usize = 16;

/// What went wrong inside the decoder.
#[derive(Default)]
struct Complaints {
    count: usize,
    first: Vec<String>,
    /// One of them says that memory ran out.
    of_memory: bool,
    /// One of them says that the bytes of the clip are bad.
    of_data: bool,
}

/// Reads a clip; `what` names the codec or container and why it is not decoded without ffmpeg.
pub fn read(request: Request<'_>, what: &str) -> Result<Video, Fault> {
    let description = describe(request, what)?;
    let Some(description) = description.filter(|d| !d.codec.is_empty()) else {
        return Err(no_video_track("ffprobe finds no video stream"));
    };
    if description.packets == 0 {
        return Err(no_frames(&format!(
            "its {} stream is empty",
            description.codec
        )));
    }
    let decode = |every_frame_once| {
        Decoder::start(request, what, &description, every_frame_once)?.run(request.progress)
    };
    match decode(["-fps_mode", "passthrough"]) {
        // Before ffmpeg 5.1 the option had another name.
        Err(Fault::Decoder {
            how: DecoderEnd::Answer { what },
            ..
        }) if what.contains("fps_mode") => decode(["-vsync", "passthrough"]),
        other => other,
    }
}

struct Decoder<'a> {
    options: &'a VideoOptions,
    description: &'a Description,
    child: Child<'a>,
    frames: Receiver<FrameInfo>,
    complaints: Arc<Mutex<Complaints>>,
    tone_map: Option<ToneMap>,
    /// Frames between the start and the end.
    in_range: usize,
    /// Indices among the frames in the range, in order.
    keep: Vec<usize>,
}

impl<'a> Decoder<'a> {
    fn start(
        request: Request<'a>,
        what: &str,
        description: &'a Description,
        every_frame_once: [&str; 2],
    ) -> Result<Self, Fault> {
        let Request {
            path,
            options,
            decoder: launcher,
            progress,
        } = request;
        let inside_s: Vec<f64> = match &description.times_s {
            Some(times) => {
                let inside = times.iter().filter(|&&t| plan::in_range(t, options));
                let inside: Vec<f64> = inside.copied().collect();
                if inside.is_empty() {
                    let last = times.last().copied().unwrap_or(0.0);
                    return Err(plan::nothing_in_range(last, options));
                }
                inside
            }
            None => (0..description.packets)
                .map(|i| i as f64 / options.folder_fps)
                .collect(),
        };
        let threads = std::thread::available_parallelism()
            .map_or(1, |n| n.get().min(MAX_THREADS))
            .to_string();
        let mut before = vec!["-nostdin", "-nostats", "-loglevel", "level+info"];
        before.extend(["-filter_threads", &threads, "-threads", &threads]);
        if options.strict {
            before.push("-xerror");
        }
        let work = Work {
            pixels: description.pixels,
            frames: description.packets as u64,
            bytes: std::fs::metadata(path).map_or(0, |m| m.len()),
        };
        let message_bytes = MESSAGE_BYTES + MESSAGE_BYTES_PER_IMAGE * work.frames;
        let (sender, frames) = channel();
        let complaints = Arc::new(Mutex::new(Complaints::default()));
        let for_thread = Arc::clone(&complaints);
        let on_line = Box::new(move |line: &str| {
            match parse(line) {
                // The receiver is gone when the reader stopped early; the pipe is still drained.
                Line::Frame(info) => drop(sender.send(info)),
                Line::Error(message) => {
                    let mut complaints = for_thread.lock().unwrap_or_else(PoisonError::into_inner);
                    complaints.count += 1;
                    complaints.of_memory |= is_of_memory(&message);
                    complaints.of_data |= is_of_data(&message);
                    if complaints.first.len() < KEPT_COMPLAINTS {
                        complaints.first.push(message);
                    }
                    return true;
                }
                Line::Other => {}
            }
            // What the loader of shared libraries says has no level.
            line.contains("error while loading")
        });
        let allowed = options.decoder.allowed(work);
        let mut command = command(request, &options.ffmpeg, &allowed, &before);
        command
            .args(["-map", "0:V:0", "-an", "-sn", "-dn"])
            .args(every_frame_once)
            .arg("-vf")
            .arg(filters(description))
            .args(["-f", "rawvideo", "pipe:1"]);
        let child = Child::start(
            &mut command,
            start("ffmpeg", launcher),
            allowed,
            message_bytes,
            on_line,
            progress,
        );
        let child = child.map_err(|e| needed(what, &options.ffmpeg, &e.to_string()))?;
        Ok(Self {
            options,
            description,
            child,
            frames,
            complaints,
            tone_map: description.hdr.map(ToneMap::new),
            in_range: inside_s.len(),
            keep: plan::among(&inside_s, options),
        })
    }

    fn run(mut self, progress: &dyn Progress) -> Result<Video, Fault> {
        let total = self.keep.last().map_or(0, |&i| i + 1);
        let mut collector: Option<Collector> = None;
        let mut first: Option<(FrameInfo, f64)> = None;
        let (mut decoded, mut index, mut next) = (0, 0, 0);
        let mut bytes = Vec::new();
        while next < self.keep.len() {
            if progress.cancelled() {
                return Err(Fault::Cancelled);
            }
            let info = self.child.wait_for(&self.frames)?;
            let Some(info) = info else { break };
            let (start, origin_s) = *first.get_or_insert((info, info.time_s.unwrap_or(0.0)));
            let time_s = info
                .time_s
                .map_or(decoded as f64 / self.options.folder_fps, |t| t - origin_s);
            decoded += 1;
            if (info.width, info.height) != (start.width, start.height) {
                let (from, to) = ((start.width, start.height), (info.width, info.height));
                return Err(plan::size_changes(from, to, time_s));
            }
            if !self.image_bytes(&info, &mut bytes)? {
                break;
            }
            if !plan::in_range(time_s, self.options) {
                continue;
            }
            if index == self.keep[next] {
                let collector = match &mut collector {
                    Some(collector) => collector,
                    None => collector.insert(self.collector(&info)?),
                };
                collector.push(self.image(&info, &bytes)?, time_s);
                next += 1;
                progress.update("decode video", index + 1, total, "");
            }
            index += 1;
        }
        self.finish(collector, decoded, next)
    }

    fn collector(&self, info: &FrameInfo) -> Result<Collector, Fault> {
        let width = info.width as f64 * info.pixel_aspect;
        let size = plan::target_size(width, info.height as f64, self.options);
        plan::check_memory(self.keep.len(), size, self.options)?;
        Ok(Collector::new(size))
    }

    /// Reads one image; false when the child ended before it was whole.
    fn image_bytes(&mut self, info: &FrameInfo, bytes: &mut Vec<u8>) -> Result<bool, Fault> {
        let pixels = info.width.saturating_mul(info.height);
        if pixels == 0 || pixels > MAX_PIXELS {
            return Err(undecoded(&format!(
                "its frames are {} x {} pixels",
                info.width, info.height
            )));
        }
        bytes.resize(pixels * if self.tone_map.is_some() { 6 } else { 3 }, 0);
        self.child.read_exact(bytes)
    }

    fn image(&self, info: &FrameInfo, bytes: &[u8]) -> Result<RgbImage, Fault> {
        let image = match &self.tone_map {
            Some(map) => map.image_16(info.width, info.height, bytes),
            None => {
                let pixels = bytes.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
                Plane::from_vec(info.width, info.height, pixels).ok()
            }
        };
        image.ok_or_else(|| undecoded("an image has the wrong length"))
    }

    fn finish(
        mut self,
        collector: Option<Collector>,
        decoded: usize,
        n_kept: usize,
    ) -> Result<Video, Fault> {
        let complete = n_kept == self.keep.len();
        // What remains of a clip of which enough was read is not needed.
        let exit = if complete {
            None
        } else {
            Some(self.child.finish()?)
        };
        let description = self.description;
        let complaints = std::mem::take(
            &mut *self
                .complaints
                .lock()
                .unwrap_or_else(PoisonError::into_inner),
        );
        if let Some(exit) = &exit
            && (!exit.status.success() || complaints.of_memory)
        {
            let how = self.child.why(exit);
            // An early end by its own decision is reported below, and what it decoded is kept.
            if !matches!(how, DecoderEnd::Answer { .. }) {
                return Err(self.child.failed(how));
            }
        }
        let message = complaints
            .first
            .first()
            .cloned()
            .unwrap_or_else(|| "no reason given".into());
        if self.options.strict && (complaints.count > 0 || !complete) {
            return Err(undecoded(&format!(
                "{} errors with `strict`, the first: {message}",
                complaints.count.max(1)
            )));
        }
        let Some(mut collector) = collector else {
            let reason = complaints.first.join("; ");
            let reason = if reason.is_empty() { message } else { reason };
            if !complaints.of_data {
                // It shows no frame, and says nothing against the clip: it may not have been able
                // to read it.
                return Err(self.child.failed(DecoderEnd::Answer { what: reason }));
            }
            return Err(undecoded(&reason));
        };
        if let Some(hdr) = description.hdr {
            let name = hdr.name();
            collector.warnings.push(format!(
                "high dynamic range ({name}) was tone-mapped to sRGB"
            ));
        }
        if description.interlaced {
            collector
                .warnings
                .push("interlaced video was deinterlaced".to_owned());
        }
        if complaints.count > 0 {
            collector.warnings.push(format!(
                "ffmpeg met {} errors while decoding, so frames may be damaged; the first: {message}",
                complaints.count
            ));
        }
        if !complete {
            let ended = exit.map_or_else(String::new, |e| e.status.to_string());
            collector.warnings.push(format!(
                "only {decoded} of {} frames could be decoded ({ended})",
                description.packets
            ));
        }
        collector
            .warnings
            .extend(plan::thinned(self.keep.len(), self.in_range, self.options));
        collector
            .finish(self.in_range, None)
            .ok_or_else(|| no_frames(&message))
    }
}

/// What happens to an image before it enters the pipe.
fn filters(description: &Description) -> String {
    let mut filters = String::new();
    if description.interlaced {
        filters.push_str("bwdif=mode=send_frame,");
    }
    filters.push_str("showinfo=checksum=0,scale=flags=accurate_rnd+full_chroma_int+bicubic");
    if !description.matrix_known {
        // As players guess: see `YuvMatrix::from_code`.
        filters.push_str(match description.hdr {
            Some(_) => ":in_color_matrix=bt2020",
            None if description.height >= 720 => ":in_color_matrix=bt709",
            None => ":in_color_matrix=bt601",
        });
    }
    filters.push_str(if description.hdr.is_some() {
        ",format=rgb48le"
    } else {
        ",format=rgb24"
    });
    filters
}
