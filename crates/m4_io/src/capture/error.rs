//! Errors of reading and writing captures.

use super::pose::PoseFault;
use crate::ErrorKind;
use crate::image::{ReadImageError, WriteImageError};
use crate::reach::OutsideError;
use crate::shortened;
use crate::tracks::ReadTracksError;
use std::io;
use std::path::PathBuf;

/// Why a capture could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadCaptureError {
    /// The list of frames could not be opened or read.
    #[error("cannot read {}: {source}; a capture is a folder with transforms_train.json, or such a file", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The file is not JSON, or a key holds the wrong type.
    #[error("{} is not a list of frames: {reason}", path.display(), reason = shortened(reason))]
    Json {
        /// The file.
        path: PathBuf,
        /// What the parser said, with line and column.
        reason: String,
    },
    /// The list is empty.
    #[error("{} lists no frames", path.display())]
    NoFrames {
        /// The file.
        path: PathBuf,
    },
    /// A key of the whole file has a value that cannot be.
    #[error("{} has {key} = {value}: {expected}", path.display(), value = shortened(value))]
    BadKey {
        /// The file.
        path: PathBuf,
        /// The key.
        key: &'static str,
        /// Its contents.
        value: String,
        /// What was expected and what to do.
        expected: &'static str,
    },
    /// A key of one frame has a value that cannot be, or is missing.
    #[error("{}, frame {frame} ({name}): {what}", path.display(), name = shortened(format!("{name:?}")), what = shortened(what))]
    BadFrame {
        /// The file.
        path: PathBuf,
        /// Index in the list.
        frame: usize,
        /// Its `file_path`, or empty.
        name: String,
        /// The key, what it holds and what was expected.
        what: String,
    },
    /// The matrix of a frame is no pose.
    #[error("{}, frame {frame} ({name}): transform_matrix {fault}", path.display(), name = shortened(format!("{name:?}")), fault = shortened(fault))]
    BadPose {
        /// The file.
        path: PathBuf,
        /// Index in the list.
        frame: usize,
        /// Its `file_path`.
        name: String,
        /// What is wrong with the matrix.
        fault: String,
    },
    /// The lens is not a pinhole.
    #[error("{} has lens distortion ({key} = {value}), which is not supported: undistort the images first (`colmap image_undistorter`, or `ns-process-data`) and set it to 0", path.display())]
    Distorted {
        /// The file.
        path: PathBuf,
        /// The coefficient.
        key: &'static str,
        /// The value.
        value: f64,
    },
    /// An image, depth map or mask could not be read.
    #[error("{}, frame {frame}: {source}", path.display())]
    Image {
        /// The file that names the image.
        path: PathBuf,
        /// Index in the list.
        frame: usize,
        /// What is wrong with the image.
        source: ReadImageError,
    },
    /// An image has another size than the file says.
    #[error("{}, frame {frame}: the image {} is {} x {} pixels but w and h say {} x {}; scale the images or the intrinsics (w, h, fl_x, fl_y, cx, cy) so that they agree", path.display(), shortened(image.display()), found.0, found.1, expected.0, expected.1)]
    ImageSize {
        /// The file that names the image.
        path: PathBuf,
        /// Index in the list.
        frame: usize,
        /// The image.
        image: PathBuf,
        /// `w` and `h`.
        expected: (usize, usize),
        /// The image's own size.
        found: (usize, usize),
    },
    /// A file that the list names lies outside of its folder.
    #[error("{}, {place}: {source}", path.display(), place = shortened(place))]
    Outside {
        /// The file that names it.
        path: PathBuf,
        /// The frame and the key.
        place: String,
        /// Which file, and where it lies.
        source: Box<OutsideError>,
    },
    /// The tracks could not be read.
    #[error("{}: {source}", list.display())]
    Tracks {
        /// The file that names them.
        list: PathBuf,
        /// The fault.
        source: ReadTracksError,
    },
    /// The frames would not fit.
    #[error("{} lists {frames} frames of {} x {} pixels, which take {needed} MiB of memory, above the limit of {limit} MiB; list fewer frames, scale the images down, or raise the limit (max_memory_bytes)", path.display(), size.0, size.1, needed = needed_bytes >> 20, limit = limit_bytes >> 20)]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// How many frames are listed.
        frames: usize,
        /// Width and height of the first.
        size: (usize, usize),
        /// The required memory.
        needed_bytes: u64,
        /// The limit.
        limit_bytes: u64,
    },
    /// The times of a test split mean nothing without the length of the training video.
    #[error("{} has times from 0 to 1 but nothing says how many training frames these span: put transforms_train.json next to it or add \"time_frames\"", path.display())]
    NoTrainingSplit {
        /// The file.
        path: PathBuf,
    },
    /// The caller asked to stop.
    #[error("stopped while reading {}", path.display())]
    Cancelled {
        /// The file.
        path: PathBuf,
    },
}

impl ReadCaptureError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { source, .. } => ErrorKind::of_read(source),
            Self::Image { source, .. } => source.kind(),
            Self::Tracks { source, .. } => source.kind(),
            Self::Distorted { .. } | Self::TooLarge { .. } => ErrorKind::Unsupported,
            Self::Cancelled { .. } => ErrorKind::Cancelled,
            Self::Json { .. }
            | Self::NoFrames { .. }
            | Self::BadKey { .. }
            | Self::BadFrame { .. }
            | Self::BadPose { .. }
            | Self::ImageSize { .. }
            | Self::Outside { .. }
            | Self::NoTrainingSplit { .. } => ErrorKind::BadData,
        }
    }

    pub(super) fn pose(path: PathBuf, frame: usize, name: &str, fault: &PoseFault) -> Self {
        Self::BadPose {
            path,
            frame,
            name: name.to_owned(),
            fault: fault.to_string(),
        }
    }
}

/// Why a capture could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteCaptureError {
    /// The file system refused.
    #[error("cannot write {}: {source}; check the folder's permissions and free space", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// An image could not be written.
    #[error(transparent)]
    Image(#[from] WriteImageError),
    /// A frame holds a number that no file can.
    #[error("frame {frame} ({name:?}) of the capture cannot be written to {}: {what}", path.display())]
    BadFrame {
        /// The JSON file.
        path: PathBuf,
        /// Index in the capture.
        frame: usize,
        /// Its name.
        name: String,
        /// The fault.
        what: String,
    },
    /// The tracks are not of these frames.
    #[error("the capture for {} has {frames} frames but tracks over {tracks}; compute tracks of these frames, or remove them", path.display())]
    Tracks {
        /// The JSON file.
        path: PathBuf,
        /// Frames of the capture.
        frames: usize,
        /// Frames of the tracks.
        tracks: usize,
    },
    /// The caller asked to stop.
    #[error("stopped while writing {}; the folder is incomplete and is not read as a capture", path.display())]
    Cancelled {
        /// The JSON file.
        path: PathBuf,
    },
}

impl WriteCaptureError {
    /// The sort of this failure.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Io { .. } => ErrorKind::CannotWrite,
            Self::Image(e) => e.kind(),
            Self::BadFrame { .. } | Self::Tracks { .. } => ErrorKind::BadData,
            Self::Cancelled { .. } => ErrorKind::Cancelled,
        }
    }
}
