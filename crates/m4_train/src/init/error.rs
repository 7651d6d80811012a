//! Errors of the initialisation.

/// What was wrong with a capture or the settings.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InitError {
    /// The capture has no frame at all.
    #[error("the capture has no frames; nothing can be initialised from it")]
    NoFrames,
    /// No frame has depth.
    #[error(
        "none of the {frames} frames has a depth map, and splats start from depth; run the geometry stage first, or give \
         `depth_file_path` for the frames"
    )]
    NoDepth {
        /// Frames of the capture.
        frames: usize,
    },
    /// Depth exists but not one pixel of it is usable.
    #[error(
        "no usable depth in {frames} depth maps: every pixel is 0, not finite, or beside a jump of depth (first depth map: frame \
         {first_frame:?}); check the unit of the depth files"
    )]
    EmptyDepth {
        /// Frames with depth that were read.
        frames: usize,
        /// The first of them.
        first_frame: String,
    },
    /// A pose is not a number.
    #[error("the camera of frame {frame:?} has a focal length that is not above 0, or a pose that is NaN or infinite")]
    BadCamera {
        /// The frame at fault.
        frame: String,
    },
    /// The tracks are not of these frames.
    #[error("the capture has {frames} frames but its tracks {tracks}; compute tracks of these frames, or remove them")]
    Tracks {
        /// Frames of the capture.
        frames: usize,
        /// Frames of the tracks.
        tracks: usize,
    },
    /// A setting is out of range.
    #[error("setting `{field}` is {value}, which is not {expected}")]
    BadSetting {
        /// Name of the field of `InitConfig`.
        field: &'static str,
        /// Its contents.
        value: String,
        /// The allowed values.
        expected: &'static str,
    },
    /// The user asked to stop.
    #[error("stopped before the first splats were complete")]
    Stopped,
}

/// Fails once the user asked to stop.
pub(crate) fn stopped(progress: &dyn m4_core::Progress) -> Result<(), InitError> {
    if progress.cancelled() { Err(InitError::Stopped) } else { Ok(()) }
}
