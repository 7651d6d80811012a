//! Which decoder reads a clip.

use super::{ReadVideoError, VideoOptions, ffmpeg, plan};
use m4_scene::{Progress, Video};
use std::fs::File;
use std::path::Path;

/// Reads a clip: a video file or a folder of pictures. Frames come upright (display matrix applied),
/// in sRGB, in order of time, all of one size; what the user should know is in [`Video::warnings`].
///
/// # Errors
///
/// [`ReadVideoError`], which names the file, what is wrong with it and what to do.
pub fn read(path: &Path, options: &VideoOptions, progress: &dyn Progress) -> Result<Video, ReadVideoError> {
    plan::check_options(options)?;
    let io = |source| ReadVideoError::Io {
        path: path.to_path_buf(),
        source,
    };
    let file = File::open(path).map_err(io)?;
    let meta = file.metadata().map_err(io)?;
    if meta.len() == 0 {
        return Err(ReadVideoError::Empty {
            path: path.to_path_buf(),
        });
    }
    ffmpeg::read(path, "a video", options, progress)
}
