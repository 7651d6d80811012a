//! Why no reconstruction came about.

/// Why a clip could not be reconstructed; every message says what to do next.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SparseError {
    /// A clip has at least two frames.
    #[error("the clip has {found} frame(s); at least 2 are needed to observe motion")]
    TooFewFrames {
        /// Frames given.
        found: usize,
    },
    /// All frames of a clip have one size.
    #[error("frame {frame} is {found:?} pixels while frame 0 is {expected:?}; give frames of one size")]
    FrameSize {
        /// The frame at fault.
        frame: usize,
        /// Its width and height.
        found: (usize, usize),
        /// Those of frame 0.
        expected: (usize, usize),
    },
    /// Images too small to follow anything.
    #[error("frames of {width}x{height} pixels are too small to track points; at least 64x64 are needed")]
    FrameTooSmall {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A setting out of its range.
    #[error("{name} = {value} is out of range: {range}")]
    Setting {
        /// The setting at fault.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
    /// Nothing to hold on to.
    #[error(
        "only {found} points could be tracked from frame {frame} to the next, {needed} are needed (flat, dark or \
         blurred images, or a cut); cut the clip there, or pass --static-camera if the camera is static, or \
         supply a capture with poses"
    )]
    TooFewTracks {
        /// The frame at fault.
        frame: usize,
        /// Tracks that survive.
        found: usize,
        /// Tracks needed.
        needed: usize,
    },
    /// Two views could not be related although the image moves.
    #[error(
        "no two frames agree on a static scene: the best pair has {inliers} of {matches} points on one rigid motion, \
         {needed} are needed (do moving objects fill the image?); pass --fov with the true field of view, \
         --static-camera if the camera is static, or supply a capture with poses"
    )]
    NoStart {
        /// Points that agree.
        inliers: usize,
        /// Points seen in both frames.
        matches: usize,
        /// Points needed.
        needed: usize,
    },
    /// Frames were related, yet hardly anything fits the result.
    #[error(
        "only {points} of {tracks} tracks fit a static scene after bundle adjustment, {needed} are needed (moving \
         things fill the image?); pass --fov with the true field of view, --static-camera if the camera stands \
         still, or supply a capture with poses"
    )]
    TooFewPoints {
        /// Points that fit.
        points: usize,
        /// Tracks long enough to be judged.
        tracks: usize,
        /// Points needed.
        needed: usize,
    },
    /// The number of masks differs from the number of frames.
    #[error("there are {masks} masks for {frames} frames; give one per frame")]
    MaskCount {
        /// Masks given.
        masks: usize,
        /// Frames given.
        frames: usize,
    },
    /// The number of cameras differs from the number of frames.
    #[error("there are {cameras} cameras for {frames} frames; give one per frame")]
    CameraCount {
        /// Cameras given.
        cameras: usize,
        /// Frames given.
        frames: usize,
    },
    /// A given camera that cannot have seen its frame.
    #[error("the camera of frame {frame} is {what}")]
    Camera {
        /// The frame.
        frame: usize,
        /// What is wrong.
        what: String,
    },
    /// Given poses that contradict the images.
    #[error(
        "the given poses do not fit the images: only {points} of {tracks} tracks agree with them on a static scene, \
         {needed} are needed; check the order of the frames, the direction (camera to world) and the axes of the poses, and \
         the focal length"
    )]
    PosesDoNotFit {
        /// Points that fit.
        points: usize,
        /// Tracks long enough to be judged.
        tracks: usize,
        /// Points needed.
        needed: usize,
    },
    /// Given poses that explain far less than others do.
    #[error(
        "the given poses contradict the images: {points} of {tracks} tracks agree with them on a static scene, {better} \
         with poses estimated from the images alone, whose rotations differ by up to {turn_deg:.1} degrees; check the order of \
         the frames, the direction (camera to world) and the axes of the poses, and the focal length, or leave the poses out"
    )]
    PosesRefuted {
        /// Points that fit the given poses.
        points: usize,
        /// Tracks long enough to be judged.
        tracks: usize,
        /// Points that fit the poses that were found.
        better: usize,
        /// Greatest difference of the turns since the first frame, degrees.
        turn_deg: f64,
    },
    /// The user stopped the run.
    #[error("stopped by the user")]
    Cancelled,
}
