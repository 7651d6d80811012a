//! Chooses the decoder of a clip.

use super::decoder::{DecoderProgram, decoder_program};
use super::mp4::{self, Movie, Mp4Error};
use super::plan::{self, Collector};
use super::{VideoOptions, ffmpeg, h264};
use crate::error::AtPath;
use crate::files::{self, in_parallel};
use crate::{ErrorKind, Fault, ReadError, image};
use m4_core::{Progress, ResizeFilter, Video, resize_rgb};
use std::fs::File;
use std::io::{self, Read};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

/// Bytes of a file's start that tell what it is.
const START_BYTES: u64 = 512;

const NOT_VIDEO: &str = "it is not a video";

/// Reads a clip: a video file or a folder of images. Frames come upright (display matrix applied),
/// in sRGB, in order of time, all of one size; what the user should know is in [`Video::warnings`].
/// H.264 is decoded by the program of [`super::set_decoder_program`], and in this process where
/// there is none.
pub fn read(
    path: &Path,
    options: &VideoOptions,
    progress: &dyn Progress,
) -> Result<Video, ReadError> {
    read_with(decoder_program(), path, options, progress)
}

/// As [`read()`], with H.264 decoded, and on Linux ffmpeg started, by the given program, or by this
/// process.
pub fn read_with(
    decoder: Option<&DecoderProgram>,
    path: &Path,
    options: &VideoOptions,
    progress: &dyn Progress,
) -> Result<Video, ReadError> {
    clip(Request {
        path,
        options,
        decoder,
        progress,
    })
    .at(path)
}

/// What is read, and how.
#[derive(Clone, Copy)]
pub(super) struct Request<'a> {
    pub path: &'a Path,
    pub options: &'a VideoOptions,
    /// Decodes H.264, and starts ffmpeg on Linux; this process does where there is none.
    pub decoder: Option<&'a DecoderProgram>,
    pub progress: &'a dyn Progress,
}

fn clip(request: Request<'_>) -> Result<Video, Fault> {
    plan::check_options(request.options)?;
    if request.path.is_dir() {
        return folder(request);
    }
    let mut file = files::open(request.path)?;
    let size_bytes = file.metadata()?.len();
    if size_bytes == 0 {
        return Err(Fault::bad(
            "it is empty (0 bytes)",
            "copy it again from the camera",
        ));
    }
    let mut start = Vec::new();
    (&mut file).take(START_BYTES).read_to_end(&mut start)?;
    if mp4::looks_like_mp4(&start) {
        return mp4(request, &mut file, size_bytes);
    }
    match (
        ffmpeg::read(request, "a file of another kind than MP4 and MOV"),
        no_clip(&start),
    ) {
        // Without ffmpeg what is known of its first bytes must do.
        (
            Err(Fault::Content {
                kind: ErrorKind::Unavailable,
                ..
            }),
            Some(reason),
        ) => Err(not_video(reason)),
        (Err(Fault::Content { what, hint, .. }), Some(reason)) if what == NOT_VIDEO => {
            Err(not_video(&format!("{reason} ({hint})")))
        }
        (other, _) => other,
    }
}

/// The file is none that any decoder knows.
pub(super) fn not_video(reason: &str) -> Fault {
    Fault::bad(NOT_VIDEO, reason)
}

/// There is sound but no image.
pub(super) fn no_video_track(contents: &str) -> Fault {
    Fault::bad(
        format!("it has no video track ({contents})"),
        "a clip filmed with a moving camera is needed",
    )
}

/// Not one frame came out.
pub(super) fn no_frames(reason: &str) -> Fault {
    Fault::bad(
        format!("it has no frame that can be decoded: {reason}"),
        "record or export it again",
    )
}

/// Why a file with this start is hardly a clip.
fn no_clip(start: &[u8]) -> Option<&'static str> {
    let images: [&[u8]; 2] = [b"\x89PNG", &[0xff, 0xd8, 0xff]];
    if images.iter().any(|magic| start.starts_with(magic)) {
        return Some("it is a single image; give a video or the folder that holds all frames");
    }
    let zeros = start.iter().all(|&b| b == 0);
    zeros.then_some("it starts with zeros, as after a copy that was interrupted; copy it again")
}

fn mp4(request: Request<'_>, file: &mut File, len: u64) -> Result<Video, Fault> {
    // A panic of its parser, which is not ours, is a fault of the file.
    let index = catch_unwind(AssertUnwindSafe(|| Movie::read(file, len)));
    let movie = match index
        .unwrap_or_else(|_| Err(Mp4Error::Bad("its index breaks the parser".into())))
    {
        Ok(movie) => movie,
        Err(Mp4Error::Fragmented) => return ffmpeg::read(request, "a fragmented MP4 file"),
        Err(Mp4Error::Io(e)) if e.kind() != io::ErrorKind::UnexpectedEof => return Err(e.into()),
        Err(Mp4Error::Truncated(what)) => {
            let hint = "copy it again from the camera, or repair the recording (`untrunc`)";
            return Err(Fault::bad(format!("it is incomplete: {what}"), hint));
        }
        Err(other) => {
            let hint = "copy it again, or convert it with `ffmpeg -i IN -pix_fmt yuv420p OUT.mp4`";
            return Err(Fault::bad(format!("it is damaged: {other}"), hint));
        }
    };
    let Some(track) = movie.video() else {
        let kinds: Vec<String> = movie
            .tracks
            .iter()
            .map(|t| mp4::kind_name(t.handler))
            .collect();
        let contents = if kinds.is_empty() {
            "it has no tracks at all".to_owned()
        } else {
            format!("it has {}", kinds.join(", "))
        };
        return Err(no_video_track(&contents));
    };
    if track.samples.is_empty() {
        return Err(no_frames("its video track is empty"));
    }
    let codec = track.entries[0].codec;
    let what = if matches!(codec.as_ref(), b"avc1" | b"avc3") {
        match h264::read(request, file, track) {
            Ok(video) => return Ok(video),
            Err(h264::Failure::Fault(fault)) => return Err(fault),
            Err(h264::Failure::Unsupported(what)) => what,
        }
    } else {
        mp4::codec_name(codec)
    };
    ffmpeg::read(request, &what)
}

/// Reads the images of a folder in natural order (`2.png` before `10.png`), evenly spaced in time.
/// Damaged ones are left out as the damaged frames of a video are.
fn folder(
    Request {
        path,
        options,
        progress,
        ..
    }: Request<'_>,
) -> Result<Video, Fault> {
    let files = image_files(path)?;
    let times: Vec<f64> = (0..files.len())
        .map(|i| i as f64 / options.folder_fps)
        .collect();
    let indices = plan::select(&times, options)?;
    let expected = one_size(&files)?;
    let longest = expected.0.max(expected.1) as f64;
    let size = plan::target_size(expected.0 as f64, expected.1 as f64, options);
    plan::check_memory(indices.len(), size, options)?;

    let photo = |i: usize| {
        let mut photo = image::read_photo(&files[i])?;
        let (w, h) = photo.rgb.size();
        let (width, height) = plan::target_size(w as f64, h as f64, options);
        if let Some(small) = resize_rgb(&photo.rgb, width, height, ResizeFilter::Triangle) {
            photo.rgb = small;
        }
        Ok(photo)
    };
    let read = in_parallel(
        "read images",
        &indices,
        progress,
        || Fault::Cancelled,
        |_, &i| match photo(i) {
            Err(e) if is_damaged(&e) => Ok(Err(e)),
            other => Ok(Ok(other?)),
        },
    )?;
    let (mut frames, mut damaged) = (Vec::with_capacity(read.len()), Vec::new());
    for (photo, &i) in read.into_iter().zip(&indices) {
        match photo {
            Ok(photo) => frames.push((i, photo)),
            Err(e) => damaged.push(e),
        }
    }
    // Images turned by their EXIF blocks may differ although the files agree.
    let upright = frames.first().map_or(size, |(_, f)| f.rgb.size());
    if let Some((i, photo)) = frames.iter().find(|(_, f)| f.rgb.size() != upright) {
        return Err(other_size(&files[*i], photo.rgb.size(), upright));
    }
    let scale = upright.0.max(upright.1) as f64 / longest;
    let focal_px = frames
        .first()
        .and_then(|(_, f)| f.focal_px)
        .map(|f| f * scale);
    let mut collector = Collector::new(upright);
    for (i, photo) in frames {
        collector.push(photo.rgb, times[i]);
    }
    if let Some(first) = damaged.first() {
        if collector.len() == 0 {
            return Err(no_frames(&first.to_string()));
        }
        collector.warnings.push(plan::damaged(
            damaged.len(),
            indices.len(),
            &format!("of them: {first}"),
            options,
        )?);
    }
    let inside = times
        .iter()
        .filter(|&&t| plan::in_range(t, options))
        .count();
    collector
        .warnings
        .extend(plan::thinned(indices.len(), inside, options));
    collector.finish(inside, focal_px).ok_or_else(no_images)
}

/// Whether the file is at fault, not the machine.
fn is_damaged(error: &ReadError) -> bool {
    error.kind() == ErrorKind::BadData
}

/// The size of the images, by the headers that are intact.
fn one_size(files: &[PathBuf]) -> Result<(usize, usize), Fault> {
    let (mut expected, mut damaged) = (None, None);
    for file in files {
        let image_size = match image::size(file) {
            Err(e) if is_damaged(&e) => {
                damaged.get_or_insert(e);
                continue;
            }
            result => result?,
        };
        let size = *expected.get_or_insert(image_size);
        if image_size != size {
            return Err(other_size(file, image_size, size));
        }
    }
    expected.ok_or_else(|| no_frames(&damaged.map(|e| e.to_string()).unwrap_or_default()))
}

fn no_images() -> Fault {
    let what = "it is a folder that has no image whose name ends in .jpg, .jpeg or .png";
    Fault::bad(what, "give a video file or a folder of frames")
}

fn other_size(file: &Path, (w, h): (usize, usize), (width, height): (usize, usize)) -> Fault {
    let what = format!("it is {w} x {h} pixels but those before it are {width} x {height}");
    Fault::bad(what, "frames of one camera must have one size").of_file(file)
}

/// The images (PNG, JPEG) of a folder in natural order: `2.png` before `10.png`; at least one.
/// Fails if the folder cannot be read or has none.
pub fn image_files(path: &Path) -> Result<Vec<PathBuf>, ReadError> {
    let files = files::listed(path, &["png", "jpg", "jpeg"])?;
    if files.is_empty() {
        return Err(no_images().at(path));
    }
    Ok(files)
}
