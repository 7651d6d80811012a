//! Errors of reading and writing clips.

use super::decoder::DecoderEnd;
use crate::ErrorKind;
use crate::image::ReadImageError;
use crate::shortened;
use std::io;
use std::path::PathBuf;

/// Why a clip could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadVideoError {
    /// The file could not be opened or read.
    #[error("cannot read the video {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The file has no bytes.
    #[error("the video {} is empty (0 bytes); copy it again from the camera", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The file is none that any decoder knows.
    #[error("{} is not a video: {reason}", path.display(), reason = shortened(reason))]
    NotVideo {
        /// The file.
        path: PathBuf,
        /// The reason.
        reason: String,
    },
    /// The file ends too early.
    #[error("the video {} is incomplete: {what}; copy it again from the camera, or repair the recording (`untrunc`)", path.display(), what = shortened(what))]
    Truncated {
        /// The file.
        path: PathBuf,
        /// What is missing.
        what: String,
    },
    /// The file contradicts itself.
    #[error("the video {} is damaged: {what}; copy it again, or convert it with `ffmpeg -i IN -pix_fmt yuv420p OUT.mp4`", path.display(), what = shortened(what))]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where and what.
        what: String,
    },
    /// There is sound but no image.
    #[error("{} has no video track ({found}); a clip filmed with a moving camera is needed", path.display(), found = shortened(found))]
    NoVideoTrack {
        /// The file.
        path: PathBuf,
        /// What it has instead.
        found: String,
    },
    /// Not one frame came out.
    #[error("the video {} has no frame that can be decoded: {reason}", path.display(), reason = shortened(reason))]
    NoFrames {
        /// The file.
        path: PathBuf,
        /// The reason.
        reason: String,
    },
    /// The part that was asked for is not in the clip.
    #[error("the video {} lasts {duration_s:.2} s and has no frame in {start_s:.2} s to {end_s:.2} s; change the start and the end", path.display())]
    NothingInRange {
        /// The file.
        path: PathBuf,
        /// When its last frame is shown.
        duration_s: f64,
        /// The start that was asked for.
        start_s: f64,
        /// The end that was asked for.
        end_s: f64,
    },
    /// Damaged frames, where none were to be tolerated.
    #[error("{damaged} of {total} frames of {} are damaged (the first at {first_s:.2} s); without --strict-video they are dropped", path.display())]
    DamagedFrames {
        /// The file.
        path: PathBuf,
        /// How many are damaged.
        damaged: usize,
        /// Of how many.
        total: usize,
        /// When the first of them is shown.
        first_s: f64,
    },
    /// The clip needs ffmpeg and there is none.
    #[error("the video {} is {what}, which is decoded by ffmpeg, and `{}` cannot be started ({reason}); install ffmpeg (apt, brew or winget install ffmpeg) or convert the clip to 8-bit H.264 elsewhere: ffmpeg -i IN -c:v libx264 -pix_fmt yuv420p OUT.mp4", path.display(), ffmpeg.display(), what = shortened(what), reason = shortened(reason))]
    NeedsFfmpeg {
        /// The file.
        path: PathBuf,
        /// The codec or container, and why it is not decoded without.
        what: String,
        /// The program that was tried.
        ffmpeg: PathBuf,
        /// The error of the operating system.
        reason: String,
    },
    /// ffmpeg gave up.
    #[error("ffmpeg cannot decode the video {}: {reason}; see whether a player shows it, and copy or export it again", path.display(), reason = shortened(reason))]
    Ffmpeg {
        /// The file.
        path: PathBuf,
        /// Its last messages.
        reason: String,
    },
    /// The process that decodes the clip crashed, was killed, hung, or took more than it may. That may be the machine's fault as
    /// well as the clip's.
    #[error("{decoder} failed on the video {}: {how}; {}", path.display(), how.advice())]
    DecoderFailed {
        /// The file.
        path: PathBuf,
        /// Which decoder, for people.
        decoder: String,
        /// How it failed.
        how: DecoderEnd,
    },
    /// The registered decoder is missing, or the system refuses it.
    #[error("cannot decode the video {}: the decoder program {} cannot be started ({source}); install the program again", path.display(), program.display())]
    DecoderNotStarted {
        /// The file.
        path: PathBuf,
        /// The program.
        program: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The size of the frames changes within the clip.
    #[error("the video {} changes its size from {} x {} to {} x {} at {time_s:.2} s; split it there", path.display(), from.0, from.1, to.0, to.1)]
    SizeChanges {
        /// The file.
        path: PathBuf,
        /// Width and height before.
        from: (usize, usize),
        /// Width and height after.
        to: (usize, usize),
        /// When.
        time_s: f64,
    },
    /// The frames would not fit.
    #[error("{frames} frames of {} at {} x {} pixels take {needed} MiB of memory, above the limit of {limit} MiB; keep fewer frames (max_frames), a shorter part (start_s, end_s) or smaller frames (size), or raise the limit (max_memory_bytes)", path.display(), size.0, size.1, needed = needed_bytes >> 20, limit = limit_bytes >> 20)]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// How many frames would be kept.
        frames: usize,
        /// Width and height they would have.
        size: (usize, usize),
        /// The required memory.
        needed_bytes: u64,
        /// The limit.
        limit_bytes: u64,
    },
    /// An option has a value that cannot be.
    #[error("the video option {option} is {value}: {expected}", value = shortened(value))]
    BadOption {
        /// The option.
        option: &'static str,
        /// The value.
        value: String,
        /// What was expected.
        expected: &'static str,
    },
    /// A folder without images.
    #[error("the folder {} has no image whose name ends in .jpg, .jpeg or .png; give a video file or a folder of frames", path.display())]
    NoImages {
        /// The folder.
        path: PathBuf,
    },
    /// Images of one folder differ in size.
    #[error("the image {} is {} x {} pixels but those before it are {} x {}; frames of one camera must have one size", path.display(), found.0, found.1, expected.0, expected.1)]
    ImageSize {
        /// The first image that differs.
        path: PathBuf,
        /// Width and height of the others.
        expected: (usize, usize),
        /// Its width and height.
        found: (usize, usize),
    },
    /// An image of a folder could not be read.
    #[error(transparent)]
    Image(#[from] ReadImageError),
    /// The caller asked to stop.
    #[error("stopped while reading the video {}", path.display())]
    Cancelled {
        /// The file.
        path: PathBuf,
    },
}

impl ReadVideoError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { source, .. } => ErrorKind::of_read(source),
            Self::Image(e) => e.kind(),
            Self::NeedsFfmpeg { .. } | Self::DecoderFailed { .. } => ErrorKind::Unavailable,
            Self::SizeChanges { .. } | Self::TooLarge { .. } => ErrorKind::Unsupported,
            Self::DecoderNotStarted { .. } => ErrorKind::Io,
            Self::Cancelled { .. } => ErrorKind::Cancelled,
            Self::Empty { .. }
            | Self::NotVideo { .. }
            | Self::Truncated { .. }
            | Self::Damaged { .. }
            | Self::NoVideoTrack { .. }
            | Self::NoFrames { .. }
            | Self::NothingInRange { .. }
            | Self::DamagedFrames { .. }
            | Self::Ffmpeg { .. }
            | Self::BadOption { .. }
            | Self::NoImages { .. }
            | Self::ImageSize { .. } => ErrorKind::BadData,
        }
    }
}

/// Why a clip could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteVideoError {
    /// The file system refused.
    #[error("cannot write the video {}: {source}; check the folder's permissions and free space", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A size or rate that cannot be encoded.
    #[error("cannot write the video {}: {what}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// The value and its limit.
        what: String,
    },
    /// A frame of another size.
    #[error("frame {frame} of {} is {} x {} pixels where {} x {} were expected", path.display(), found.0, found.1, expected.0, expected.1)]
    FrameSize {
        /// The file.
        path: PathBuf,
        /// Index of the frame.
        frame: usize,
        /// Width and height of the clip.
        expected: (usize, usize),
        /// Width and height of the frame.
        found: (usize, usize),
    },
    /// No frame was pushed.
    #[error("cannot write the video {}: there are no frames", path.display())]
    NoFrames {
        /// The file.
        path: PathBuf,
    },
    /// The encoder or the muxer failed.
    #[error("cannot encode the video {}: {reason}", path.display())]
    Encode {
        /// The file.
        path: PathBuf,
        /// Its message.
        reason: String,
    },
    /// The file that was written does not read back; it was removed.
    #[error("the video {} was written but does not read back ({reason}) and was removed; check the disk", path.display())]
    Verify {
        /// The file.
        path: PathBuf,
        /// The findings.
        reason: String,
    },
}

impl WriteVideoError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { .. } | Self::Encode { .. } | Self::Verify { .. } => ErrorKind::CannotWrite,
            Self::Unsupported { .. } => ErrorKind::Unsupported,
            Self::FrameSize { .. } | Self::NoFrames { .. } => ErrorKind::BadData,
        }
    }
}
