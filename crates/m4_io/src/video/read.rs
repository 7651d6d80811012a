//! Chooses the decoder of a clip.

use super::decoder::{DecoderProgram, decoder_program};
use super::mp4::{Movie, Mp4Error};
use super::{ReadVideoError, VideoOptions, ffmpeg, folder, h264, mp4, plan};
use m4_core::{Progress, Video};
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;

/// Bytes of a file's start that tell what it is.
const START_BYTES: u64 = 512;

/// Said of a file that ffmpeg may still know.
const UNKNOWN: &str = "its first bytes are those of no known container; give an MP4, MOV, MKV, WebM or AVI file";

/// Reads a clip: a video file or a folder of images. Frames come upright (display matrix applied),
/// in sRGB, in order of time, all of one size; what the user should know is in [`Video::warnings`].
/// H.264 is decoded by the program of [`super::set_decoder_program`], and in this process where there is none.
///
/// # Errors
///
/// [`ReadVideoError`], which names the file, what is wrong with it and what to do.
pub fn read(path: &Path, options: &VideoOptions, progress: &dyn Progress) -> Result<Video, ReadVideoError> {
    read_with(decoder_program(), path, options, progress)
}

/// As [`read()`], with H.264 decoded, and on Linux ffmpeg started, by the given program, or by this process.
///
/// # Errors
///
/// As [`read()`].
pub fn read_with(
    decoder: Option<&DecoderProgram>,
    path: &Path,
    options: &VideoOptions,
    progress: &dyn Progress,
) -> Result<Video, ReadVideoError> {
    plan::check_options(options)?;
    if path.is_dir() {
        return folder::read(path, options, progress);
    }
    let io = |source| ReadVideoError::Io {
        path: path.to_path_buf(),
        source,
    };
    let mut file = File::open(path).map_err(io)?;
    let meta = file.metadata().map_err(io)?;
    if !meta.is_file() {
        return Err(ReadVideoError::NotVideo {
            path: path.to_path_buf(),
            reason: "it is a device or a pipe; give a file or a folder of images".into(),
        });
    }
    if meta.len() == 0 {
        return Err(ReadVideoError::Empty {
            path: path.to_path_buf(),
        });
    }
    let mut start = Vec::new();
    (&mut file).take(START_BYTES).read_to_end(&mut start).map_err(io)?;
    if mp4::looks_like_mp4(&start) {
        return mp4(path, &mut file, meta.len(), options, decoder, progress);
    }
    match container(&start) {
        Ok(what) => ffmpeg::read(path, what, options, decoder, progress),
        Err(reason) => match ffmpeg::read(path, "of no kind that is known", options, decoder, progress) {
            // Without ffmpeg what is known of its first bytes must do.
            Err(ReadVideoError::NeedsFfmpeg { .. }) if reason != UNKNOWN => Err(ReadVideoError::NotVideo {
                path: path.to_path_buf(),
                reason: reason.to_owned(),
            }),
            Err(ReadVideoError::NotVideo { path, reason: message }) => Err(ReadVideoError::NotVideo {
                path,
                reason: format!("{reason} ({message})"),
            }),
            other => other,
        },
    }
}

/// The name of a container that only ffmpeg reads, or why the file is none that is known.
fn container(start: &[u8]) -> Result<&'static str, &'static str> {
    let known: [(&[u8], &str); 6] = [
        (&[0x1a, 0x45, 0xdf, 0xa3], "a Matroska or WebM file"),
        (b"FLV\x01", "a Flash video"),
        (b"OggS", "an Ogg file"),
        (b"GIF8", "an animated GIF"),
        (&[0x00, 0x00, 0x01, 0xba], "an MPEG program stream"),
        (&[0x30, 0x26, 0xb2, 0x75], "a Windows Media file"),
    ];
    if let Some((_, name)) = known.iter().find(|(magic, _)| start.starts_with(magic)) {
        return Ok(name);
    }
    if start.starts_with(b"RIFF") && start.get(8..11) == Some(b"AVI") {
        return Ok("an AVI file");
    }
    if start.first() == Some(&0x47) && start.get(188) == Some(&0x47) {
        return Ok("an MPEG transport stream");
    }
    let images: [&[u8]; 2] = [b"\x89PNG", &[0xff, 0xd8, 0xff]];
    if images.iter().any(|magic| start.starts_with(magic)) {
        return Err("it is a single image; give a video or the folder that holds all frames");
    }
    if start.iter().all(|&b| b == 0) {
        return Err("it starts with zeros, as after a copy that was interrupted; copy it again");
    }
    Err(UNKNOWN)
}

fn mp4(
    path: &Path,
    file: &mut File,
    len: u64,
    options: &VideoOptions,
    decoder: Option<&DecoderProgram>,
    progress: &dyn Progress,
) -> Result<Video, ReadVideoError> {
    let movie = match Movie::read(file, len) {
        Ok(movie) => movie,
        Err(Mp4Error::Fragmented) => return ffmpeg::read(path, "a fragmented MP4 file", options, decoder, progress),
        Err(error) => {
            return Err(match error {
                Mp4Error::Io(source) if source.kind() != ErrorKind::UnexpectedEof => ReadVideoError::Io {
                    path: path.to_path_buf(),
                    source,
                },
                Mp4Error::Truncated(what) => ReadVideoError::Truncated {
                    path: path.to_path_buf(),
                    what,
                },
                other => ReadVideoError::Damaged {
                    path: path.to_path_buf(),
                    what: other.to_string(),
                },
            });
        }
    };
    let Some(track) = movie.video() else {
        let kinds: Vec<String> = movie.tracks.iter().map(|t| mp4::kind_name(t.handler)).collect();
        return Err(ReadVideoError::NoVideoTrack {
            path: path.to_path_buf(),
            found: if kinds.is_empty() {
                "it has no tracks at all".into()
            } else {
                format!("it has {}", kinds.join(", "))
            },
        });
    };
    if track.samples.is_empty() {
        return Err(ReadVideoError::NoFrames {
            path: path.to_path_buf(),
            reason: "its video track is empty; record it again".into(),
        });
    }
    let codec = track.entries[0].codec;
    let h264::Unsupported(what) = if matches!(&codec, b"avc1" | b"avc3") {
        match h264::read(path, file, track, options, decoder, progress)? {
            h264::Outcome::Decoded(video) => return Ok(video),
            h264::Outcome::Unsupported(unsupported) => unsupported,
        }
    } else {
        h264::Unsupported(mp4::codec_name(codec))
    };
    ffmpeg::read(path, &what, options, decoder, progress)
}
