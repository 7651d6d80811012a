//! Writes images as an MP4 file that plays in common players.

use super::colour::{Range, YuvMatrix};
use super::encode::{Coded, Pieces, Refused};
use super::plan;
use super::{VideoOptions, read_with};
use crate::WriteError;
use crate::atomic::AtomicFile;
use m4_core::{RgbImage, Silent};
use muxide::api::{Muxer, MuxerBuilder, MuxerError, VideoCodec};
use std::path::{Path, PathBuf};

/// Sides that the encoder takes, pixels: from one macroblock to level 5.2.
const SIDES_PX: (usize, usize) = (16, 3840);
/// Shorter side of the largest image, pixels.
const SHORT_SIDE_PX: usize = 2160;
/// Quantisation: coding begins to be seen at 26, and below 18 it costs bits without a visible gain.
const QP: (u8, u8) = (20, 22);
/// Seconds from one frame at which a player can enter to the next, and the fewest frames.
const ENTRIES: (f64, usize) = (1.0, 12);
/// Longest side of the frames that a written file is read back in, pixels: they take little memory,
/// however many they are.
const VERIFIED_PX: usize = 64;

/// Writes frames of one size to an MP4 file: H.264 High profile, BT.709, index at the front. The
/// file appears under its name only when [`Mp4Writer::finish`] has read it back.
pub struct Mp4Writer {
    path: PathBuf,
    size: (usize, usize),
    fps: f64,
    frames: usize,
    /// Frames of it that are in the file.
    coded: usize,
    pieces: Pieces,
    muxer: Muxer<AtomicFile>,
}

impl std::fmt::Debug for Mp4Writer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            path,
            size,
            fps,
            frames,
            ..
        } = self;
        write!(
            f,
            "Mp4Writer({path:?}, {size:?}, {fps} fps, {frames} frames)"
        )
    }
}

impl Mp4Writer {
    /// Starts a clip of `width` x `height` pixels (odd sides grow by one column or row) at `fps`
    /// frames a second. Fails for sizes or rates that H.264 does not have, and when the file system
    /// refuses.
    pub fn create(path: &Path, width: usize, height: usize, fps: f64) -> Result<Self, WriteError> {
        let unsupported = |what: String| WriteError::unsupported(path, what);
        let (even_width, even_height) = (width.next_multiple_of(2), height.next_multiple_of(2));
        let (short, long) = (even_width.min(even_height), even_width.max(even_height));
        if short < SIDES_PX.0 || long > SIDES_PX.1 || short > SHORT_SIDE_PX {
            return Err(unsupported(format!(
                "frames are {width} x {height} pixels; {} x {} to {} x {SHORT_SIDE_PX} can be encoded, so render at another size or to a folder of PNG files",
                SIDES_PX.0, SIDES_PX.0, SIDES_PX.1
            )));
        }
        if !(fps.is_finite() && (0.1..=1000.0).contains(&fps)) {
            return Err(unsupported(format!(
                "{fps} frames per second; 0.1 to 1000 were expected"
            )));
        }
        let encode = |reason: String| WriteError::encode(path, reason);
        let matrix = YuvMatrix::from_code(1, height, Range::Limited);
        let matrix = matrix.ok_or_else(|| encode("BT.709 is not known".into()))?;
        let file = AtomicFile::create(path).map_err(|e| WriteError::io(path, e))?;
        let muxer = MuxerBuilder::new(file)
            .video(VideoCodec::H264, even_width as u32, even_height as u32, fps)
            .with_fast_start(true)
            .build()
            .map_err(|e| encode(e.to_string()))?;
        let length = ((ENTRIES.0 * fps).ceil() as usize).max(ENTRIES.1);
        let pieces = Pieces::new((width, height), fps, matrix, QP, length);
        Ok(Self {
            path: path.to_path_buf(),
            size: (width, height),
            fps,
            frames: 0,
            coded: 0,
            pieces,
            muxer,
        })
    }

    /// Adds a frame, which is encoded while others are made. Fails if its size is not that of the
    /// clip or the encoder fails, which may be told with a later frame.
    pub fn push(&mut self, image: RgbImage) -> Result<(), WriteError> {
        if image.size() != self.size {
            let ((w, h), (width, height)) = (image.size(), self.size);
            let what = format!(
                "frame {} is {w} x {h} pixels where {width} x {height} were expected",
                self.frames
            );
            return Err(WriteError::bad(&self.path, what));
        }
        self.frames += 1;
        let coded = self
            .pieces
            .push(image)
            .map_err(|refused| failed(&self.path, self.size, refused))?;
        write_frames(&mut self.muxer, &mut self.coded, self.fps, coded)
            .map_err(|e| WriteError::encode(&self.path, e))
    }

    /// Completes the file, decodes it again, and gives it its name. Fails if there were no frames,
    /// the file system refuses, or the file does not hold as many decodable frames as were pushed.
    pub fn finish(self) -> Result<(), WriteError> {
        let Self {
            path,
            size,
            fps,
            frames,
            mut coded,
            pieces,
            mut muxer,
        } = self;
        if frames == 0 {
            return Err(WriteError::bad(&path, "there are no frames"));
        }
        let rest = pieces
            .finish()
            .map_err(|refused| failed(&path, size, refused))?;
        write_frames(&mut muxer, &mut coded, fps, rest)
            .map_err(|e| WriteError::encode(&path, e))?;
        let io = |e| WriteError::io(&path, e);
        muxer.finish_in_place().map_err(|e| match e {
            MuxerError::Io(source) => io(source),
            other => WriteError::encode(&path, other),
        })?;
        let mut file = muxer.into_writer();
        file.sync().map_err(io)?;
        verify(file.temporary_path(), size, frames)
            .map_err(|reason| WriteError::verify(&path, reason))?;
        file.commit().map_err(io)
    }
}

/// Appends coded frames to a file that holds `before`.
fn write_frames(
    muxer: &mut Muxer<AtomicFile>,
    before: &mut usize,
    fps: f64,
    coded: Vec<Coded>,
) -> Result<(), MuxerError> {
    for Coded { bytes, key } in coded {
        muxer.write_video(*before as f64 / fps, &bytes, key)?;
        *before += 1;
    }
    Ok(())
}

/// The error of an encoder that failed. It says that it could not be set up (1), or got no memory
/// (3), where memory ran out: sizes and rates were checked before.
fn failed(path: &Path, (width, height): (usize, usize), refused: Refused) -> WriteError {
    match refused {
        Refused::Encoder(error) if matches!(error.native_code(), 1 | 3) => {
            WriteError::memory(path, format!("frames of {width} x {height} pixels"))
        }
        Refused::Encoder(error) => WriteError::encode(path, error),
        Refused::Other(reason) => WriteError::encode(path, reason),
    }
}

/// Reads the file back; what differs, if something does.
fn verify(path: &Path, (width, height): (usize, usize), frames: usize) -> Result<(), String> {
    let options = VideoOptions {
        size: Some(VERIFIED_PX),
        strict: true,
        ..VideoOptions::default()
    };
    let back = read_with(None, path, &options, &Silent).map_err(|e| e.to_string())?;
    let even = |side: usize| side.next_multiple_of(2) as f64;
    let expected = plan::target_size(even(width), even(height), &options);
    let actual = (back.frames.len(), back.frames[0].rgb.size());
    if actual != (frames, expected) {
        return Err(format!(
            "{} frames of {:?} where {frames} of {expected:?} were expected",
            actual.0, actual.1
        ));
    }
    Ok(())
}
