//! What differs between initialisations, each with its source, and their errors; constants stand
//! beside the code that uses them.

/// Static splats of a clip that shows one place: the least that a clip gets where its pixels
/// allow it ([`InitConfig::max_static`]).
pub const LEAST_STATIC: usize = 80_000;

/// How large a voxel is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CellSize {
    /// `k * mean depth of the first frame / focal` everywhere (Instant4D;
    /// docs/spec/optimiser.md 2.2).
    Constant,
    /// `k * distance to the nearest camera / focal`, in steps of a factor `sqrt(2)`: the same
    /// number of pixels at every depth (docs/spec/optimiser.md 2.2, our variant).
    DepthProportional,
}

/// How long a dynamic splat lives at the start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TimeSpread {
    /// Standard deviation in gaps, the mean of those to both neighbouring keyframes, so that splats
    /// reach the next one where frames are missing, too (docs/spec/optimiser.md 2.4, our choice).
    KeyframeGaps {
        /// Standard deviations per gap. From 0.75 on the opacity of a surface changes by less than
        /// 3 % between keyframes that are evenly spaced; with 1 every splat is also seen, and its
        /// velocity trained, at the neighbouring keyframes.
        factor: f32,
    },
    /// Variance `D / (10 (B - 1))` in the reference's time units, that is a standard deviation of
    /// `sqrt((B - 1) / (10 D))` frames; static points get variance `D`, that is `(B - 1) / sqrt(D)`
    /// frames, about the time `D / 3` (Instant4D; docs/spec/optimiser.md 2.4, decision D7).
    Reference {
        /// Length `D` of the reference's time axis: 3 for DyCheck and DAVIS, 1 for NVIDIA.
        time_range: f32,
    },
}

/// Where the first velocities come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VelocityInit {
    /// All 0: the optimiser finds them.
    Zero,
    /// Each keyframe's points are registered to those of the keyframes before and after: locally
    /// rigid motions that bring similar colours together. From there, nodes of windows of time are
    /// aligned to every frame, and splats are bound to them (docs/spec/scaffold.md 4).
    Register {
        /// Where the capture brings tracks, points near them go where they say, before the frames
        /// have their word (section 2.6; measured: 0.00 to +0.12 dB inside dynamic parts, +0.27
        /// with true depth; docs/geometry-log.md, "First velocities from tracks").
        tracks: bool,
    },
}

/// Points of tracks that the capture brings, added to those of the frames (the completed cloud;
/// docs/spec/optimiser.md 2.6). Without tracks nothing is added. The default is
/// [`InitConfig::fast`]'s.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TrackedInit {
    /// Whether they are added: one a track and keyframe, hidden ones too. On by the paper's letter;
    /// off in [`InitConfig::fast`], whose splats live on where they are hidden
    /// (docs/spec/scaffold.md 4).
    pub enabled: bool,
    /// Also where the frame itself sees the place (the paper's letter); such points fill cells that
    /// the frame's own points leave empty. Else only where it cannot.
    pub seen: bool,
    /// Most points, all keyframes together; more are thinned everywhere alike.
    pub most: usize,
}

impl Default for TrackedInit {
    fn default() -> Self {
        Self {
            enabled: false,
            seen: false,
            most: 300_000,
        }
    }
}

/// Settings of [`crate::init::initialise`]. Defaults are those of [`InitConfig::fast`].
#[derive(Debug, Clone, PartialEq)]
pub struct InitConfig {
    /// Most static splats to start with; the voxels' size is chosen to come close from below.
    /// `None`: as many as the clip shows surface (docs/decisions/0028-first-splats-by-clip.md).
    pub max_static: Option<usize>,
    /// Most dynamic points, all keyframes together, that splats are made of: the voxels' size is
    /// chosen to come close from below. A splat that lives for several keyframes stands for their
    /// points.
    pub max_dynamic: usize,
    /// Edge of static voxels, pixels; dynamic points are then merged only where there are more than
    /// `max_dynamic`. `None`: the least edge from 1.25 on, for each of the two, that keeps to the
    /// numbers above. 6 for DyCheck, 4 for NVIDIA, 2 for DAVIS (Instant4D;
    /// docs/spec/optimiser.md 2.2).
    pub voxel_px: Option<f32>,
    /// Constant or depth-proportional voxels.
    pub cells: CellSize,
    /// Static points are taken from at most this many frames, evenly spread.
    pub static_frames: usize,
    /// Static points within this many pixels of a dynamic one are dropped: masks are never exact,
    /// and a dynamic pixel taken for wall stays on the wall (our rule).
    pub mask_margin_px: usize,
    /// Static points that are nearer by more than this share than what several other frames see
    /// there are dropped: depth that smears over edges (docs/spec/optimiser.md 2.6 has 5 % for
    /// tracked points; measured on whole held-out views: +0.3 and +0.45 dB from frames at 1.5 %,
    /// less at 3 %, none lost with true depth). 0 for none.
    pub free_space: f32,
    /// Whether points of several frames that are of one surface become one before voxels are made
    /// (our rule; docs/decisions/0009). Else voxels hold the points of all frames, as the paper has
    /// it.
    pub merge_surfaces: bool,
    /// Points of tracks.
    pub tracked: TrackedInit,
    /// A patch of static surface whose brightness differs by more than this (0..1) from its mean
    /// over all frames gets splats of its own for that time: moving shadows (our rule). 0 for none.
    pub change_threshold: f32,
    /// Splats on a shell behind everything, coloured by what was seen in their direction (our
    /// rule). 0 for none.
    pub shell_splats: usize,
    /// One scale a splat and no rotation (the paper's choice, as Instant4D;
    /// docs/spec/optimiser.md 1.5).
    pub isotropic: bool,
    /// Static points become rows with time parameters that fade towards the ends, as in the
    /// reference (docs/spec/optimiser.md 2.4); else they have no time at all.
    pub static_fade: bool,
    /// Opacity at the start, 0..1. Reference 0.1; docs/spec/optimiser.md 2.5 recommends 0.5; 0.97
    /// with small splats is sharper from the start (measured: +0.05 SSIM inside dynamic parts
    /// before training).
    pub opacity: f32,
    /// Standard deviation in units of that of the nearest neighbours along each axis of the
    /// surface; of an isotropic splat in units of the distance to the three nearest neighbours
    /// (root mean square). Reference 1; docs/spec/optimiser.md 2.5 recommends 0.75; 0.55 with
    /// opacity 0.97 (measured, as above).
    pub scale_factor: f32,
    /// How long a dynamic splat lives.
    pub time_spread: TimeSpread,
    /// First velocities.
    pub velocity: VelocityInit,
}

impl Default for InitConfig {
    fn default() -> Self {
        Self::fast()
    }
}

impl InitConfig {
    /// Static splats without time, dynamic ones in velocity form, anisotropic
    /// (docs/spec/optimiser.md 9, D1).
    pub fn fast() -> Self {
        Self {
            max_static: None,
            max_dynamic: 300_000,
            voxel_px: None,
            cells: CellSize::DepthProportional,
            static_frames: 48,
            mask_margin_px: 2,
            free_space: 0.015,
            merge_surfaces: true,
            tracked: TrackedInit::default(),
            change_threshold: 0.05,
            shell_splats: 2000,
            isotropic: false,
            static_fade: false,
            opacity: 0.97,
            scale_factor: 0.55,
            time_spread: TimeSpread::KeyframeGaps { factor: 1.0 },
            velocity: VelocityInit::Register { tracks: true },
        }
    }

    /// The paper's letter, read as Instant4D (docs/spec/optimiser.md 1.5 and 2): isotropic, no
    /// velocity, every splat with a time span, opacity 0.1, constant voxels, scale of the plain
    /// 3-NN distance.
    pub fn faithful() -> Self {
        Self {
            max_static: Some(300_000),
            max_dynamic: 100_000,
            voxel_px: Some(6.0),
            cells: CellSize::Constant,
            static_frames: 40,
            mask_margin_px: 0,
            free_space: 0.0,
            merge_surfaces: false,
            tracked: TrackedInit {
                enabled: true,
                seen: true,
                most: 40_000,
            },
            change_threshold: 0.0,
            shell_splats: 0,
            isotropic: true,
            static_fade: true,
            opacity: 0.1,
            scale_factor: 1.0,
            time_spread: TimeSpread::Reference { time_range: 3.0 },
            velocity: VelocityInit::Zero,
        }
    }

    /// Refuses values that no run can use. Fails with [`InitError::BadSetting`] naming the first
    /// field out of range.
    pub fn check(&self) -> Result<(), InitError> {
        let need = |ok: bool, field, value: &dyn ToString, expected| {
            if ok {
                return Ok(());
            }
            Err(InitError::BadSetting {
                field,
                value: value.to_string(),
                expected,
            })
        };
        let counts = [
            ("max_static", self.max_static.unwrap_or(1)),
            ("max_dynamic", self.max_dynamic),
            ("static_frames", self.static_frames),
        ];
        for (field, value) in counts {
            need(value >= 1, field, &value, "at least 1")?;
        }
        for (field, value) in [
            ("free_space", self.free_space),
            ("change_threshold", self.change_threshold),
        ] {
            need(
                value.is_finite() && value >= 0.0,
                field,
                &value,
                "a number of at least 0",
            )?;
        }
        let (spread, gaps) = match self.time_spread {
            TimeSpread::KeyframeGaps { factor } => ("keyframe_gaps", factor),
            TimeSpread::Reference { time_range } => ("time_range", time_range),
        };
        for (field, value) in [("scale_factor", self.scale_factor), (spread, gaps)] {
            need(
                value.is_finite() && value > 0.0,
                field,
                &value,
                "a number above 0",
            )?;
        }
        let edge = self.voxel_px.unwrap_or(1.0);
        need(
            edge.is_finite() && edge > 0.0,
            "voxel_px",
            &edge,
            "a number above 0",
        )?;
        let opacity = self.opacity;
        need(
            opacity > 0.0 && opacity < 1.0,
            "opacity",
            &opacity,
            "between 0 and 1, both excluded",
        )
    }
}

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
    #[error(
        "the camera of frame {frame:?} has a focal length that is not above 0, or a pose that is NaN or infinite"
    )]
    BadCamera {
        /// The frame at fault.
        frame: String,
    },
    /// The tracks are not of these frames.
    #[error(
        "the capture has {frames} frames but its tracks {tracks}; compute tracks of these frames, or remove them"
    )]
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
    /// Motion of splats that does not fit them.
    #[error(transparent)]
    Shape(#[from] m4_core::ShapeError),
    /// The user asked to stop.
    #[error("stopped before the first splats were complete")]
    Stopped,
}

/// Fails once the user asked to stop.
pub(crate) fn stopped(progress: &dyn m4_core::Progress) -> Result<(), InitError> {
    if progress.cancelled() {
        Err(InitError::Stopped)
    } else {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::InitConfig;

    #[test]
    fn the_profiles_are_valid_and_bad_values_are_named() {
        InitConfig::fast().check().unwrap();
        InitConfig::faithful().check().unwrap();
        let broken = InitConfig {
            opacity: 1.5,
            ..InitConfig::fast()
        };
        assert!(
            broken
                .check()
                .unwrap_err()
                .to_string()
                .contains("`opacity` is 1.5")
        );
        let broken = InitConfig {
            scale_factor: f32::NAN,
            ..InitConfig::fast()
        };
        assert!(broken.check().is_err());
    }
}
