//! Settings of the initialisation, each with its source.

use crate::InitError;
use serde::{Deserialize, Serialize};

/// How large a voxel is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CellSize {
    /// `k * median depth / focal` everywhere (Instant4D; section 2.2).
    Constant,
    /// `k * distance to the nearest camera / focal`, in steps of a factor `sqrt(2)`: the same number
    /// of pixels at every depth (section 2.2, our variant).
    DepthProportional,
}

/// How long a dynamic splat lives at the start.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum TimeSpread {
    /// Standard deviation in gaps, the mean of those to both neighbouring keyframes, so that splats reach the next one where
    /// frames are missing, too (section 2.4, our choice).
    KeyframeGaps {
        /// Standard deviations per gap. From 0.75 on the opacity of a surface changes by less than 3 % between keyframes
        /// that are evenly spaced; with 1 every splat is also seen, and its velocity trained, at the neighbouring keyframes.
        factor: f32,
    },
    /// Variance `D / (10 (B - 1))` in the reference's time units, that is a standard deviation of
    /// `sqrt((B - 1) / (10 D))` frames; standing points get variance `D`, that is
    /// `(B - 1) / sqrt(D)` frames, about the time `D / 3` (Instant4D; section 2.4, decision D7).
    Reference {
        /// Length `D` of the reference's time axis: 3 for DyCheck and DAVIS, 1 for NVIDIA.
        time_range: f32,
    },
}

/// Where the first velocities come from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum VelocityInit {
    /// All 0: the optimiser finds them.
    Zero,
    /// Points take the velocity of the nearest tracks, by the inverse of their distance; 0 where none is near, or the capture
    /// brings none (section 2.6).
    Tracks {
        /// Tracks that are asked.
        neighbours: usize,
        /// Tracks farther away than this say nothing, pixels at the median depth.
        reach_pixels: f32,
    },
    /// Each keyframe's points are registered to those of the keyframes before and after: locally rigid
    /// motions that bring similar colours together; tracks that the capture brings refine them (section 2.6).
    Register {
        /// Spacing of the points that are registered, pixels at the median depth.
        pixels: f32,
        /// A difference of colour of this size (0..1, Euclidean) counts as much as a displacement of
        /// `reach_pixels`.
        colour_scale: f32,
        /// Pixels at the median depth.
        reach_pixels: f32,
        /// Points that move together as one rigid piece.
        neighbours: usize,
        /// Rounds of match and fit.
        rounds: usize,
        /// Rounds after that in which patches of the pictures say where points went (measured: +0.14 dB inside
        /// moving parts; difference of colour after one frame down by a fifth).
        picture_rounds: usize,
        /// Where the capture brings tracks, points near them go where they say, before the pictures have their word (section
        /// 2.6; measured: 0.00 to +0.12 dB inside moving parts, +0.27 with true depth; docs/geometry.md).
        #[serde(default = "tracks_are_followed")]
        tracks: bool,
    },
}

/// Points of tracks that the capture brings, added to those of the frames (paper Eq. 5: the completed cloud; section 2.6). Without
/// tracks nothing is added.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackedInit {
    /// Whether they are added: one a track and keyframe, hidden ones too. On by the paper's letter; off in [`InitConfig::fast`], since
    /// points that are carried ([`InitConfig::carry_keyframes`]) lie closer together and do better (measured inside moving parts of
    /// held-out views, before training, three scenes with true depth: carried 21.9, 24.4, 24.0 dB, tracked 21.2, 22.8, 23.4; both 21.3 in the first).
    pub enabled: bool,
    /// Also where the frame itself sees the place (the paper's letter); such points fill cells that the frame's own points leave
    /// empty. Else only where it cannot, by [`InitConfig::carry_margin`].
    pub seen: bool,
    /// Places that are trusted less than this are dropped where they lie outside the range of depths that frames see.
    pub confidence: f32,
    /// Places in front of what the frame sees by more than this share of the depth are dropped (section 2.6: 5 %).
    pub free_space: f32,
    /// Places that a track reaches or leaves by a step of more than this many times its median step are dropped.
    pub jump: f32,
    /// Most points, all keyframes together; more are thinned everywhere alike.
    pub most: usize,
}

impl Default for TrackedInit {
    fn default() -> Self {
        Self {
            enabled: false,
            seen: false,
            confidence: 0.5,
            free_space: 0.05,
            jump: 8.0,
            most: 300_000,
        }
    }
}

/// Settings of [`crate::initialise`]. Defaults are those of [`InitConfig::fast`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InitConfig {
    /// Most static splats to start with; `static_pixels` is chosen to come close from below.
    pub max_static: usize,
    /// Most dynamic splats to start with, all keyframes together; a frame draws those of a few keyframes
    /// alone, so they cost memory rather than time.
    pub max_dynamic: usize,
    /// Voxel edge of standing points, pixels at the median depth; 0 to derive it from `max_static`.
    /// Instant4D: 2 to 6.
    pub static_pixels: f32,
    /// The same for moving points. Instant4D: 0.5, or no merging at all; 0 to derive it.
    pub dynamic_pixels: f32,
    /// Voxels that are derived are never smaller than this, pixels at the median depth: splats finer than
    /// the pixels leave cracks in views from the side (measured: -0.4 dB inside moving parts at 0.5).
    pub min_pixels: f32,
    /// Constant or depth-proportional voxels.
    pub cells: CellSize,
    /// Standing points are taken from at most this many frames, evenly spread. 24 frames of 480 x 360
    /// are 4 million points, which is what 150 MB hold; twice as many bring nothing (measured).
    pub static_frames: usize,
    /// Moving points are taken from every n-th frame. Instant4D: 10 (DyCheck), 3 (DAVIS), 1 (NVIDIA).
    pub dynamic_stride: usize,
    /// A pixel is dropped when its depth lies between those of two opposite neighbours and differs
    /// from both by more than this share: it hangs in the air between two surfaces (our rule).
    pub edge_jump: f32,
    /// Standing points within this many pixels of a moving one are dropped: masks are never exact,
    /// and a moving pixel taken for wall stays on the wall (our rule).
    pub mask_margin_px: usize,
    /// Standing points that are nearer by more than this share than what several other frames see there are dropped: depth that
    /// smears over edges (section 2.6 has 5 % for tracked points; measured on whole held-out views: +0.3 and +0.45 dB from frames at
    /// 1.5 %, less at 3 %, none lost with true depth). 0 for none.
    pub free_space: f32,
    /// Moving points that leave the picture or go behind something are carried on, with what is seen of
    /// their body, into at most this many keyframes that cannot see them (section 2.6: occluded samples are kept).
    /// They come on top of `max_dynamic`. 0 for none.
    pub carry_keyframes: usize,
    /// Most points that are carried, all keyframes together; those carried the longest way are left out. Depth that
    /// does not agree from frame to frame makes many of them.
    pub carry_max: usize,
    /// A carried point behind the depth map by more than this share of the depth is hidden. Section 2.6
    /// has 0.05; limbs are thinner than that (measured: +0.3 dB inside moving parts from 0.05 to 0.004).
    pub carry_margin: f32,
    /// Points closer than this, pixels at the median depth, belong to one body.
    pub carry_reach_pixels: f32,
    /// Points of tracks.
    pub tracked: TrackedInit,
    /// A patch of standing surface whose brightness differs by more than this (0..1) from its mean over
    /// all frames gets splats of its own for that time: moving shadows (our rule). 0 for none.
    pub change_threshold: f32,
    /// At most this share of a frame counts as changed.
    pub change_max_share: f32,
    /// Spacing of the splats of such patches, pixels at the median depth: they tint what is behind them.
    pub change_pixels: f32,
    /// Splats on a shell behind everything, coloured by what was seen in their direction (our rule). 0
    /// for none.
    pub shell_splats: usize,
    /// Radius of the shell, in units of the depth below which 99 of 100 pixels lie.
    pub shell_radius: f32,
    /// One scale a splat and no rotation (the paper's choice, as Instant4D; section 1.5).
    pub isotropic: bool,
    /// Standing points become rows with time parameters that fade towards the ends, as in the
    /// reference (section 2.4); else they have no time at all.
    pub static_fade: bool,
    /// Opacity at the start, 0..1. Reference 0.1; section 2.5 recommends 0.5; 0.97 with small splats is
    /// sharper from the start (measured: +0.05 SSIM inside moving parts before training).
    pub opacity: f32,
    /// Standard deviation in units of that of the nearest neighbours along each axis of the surface; of an isotropic
    /// splat in units of the distance to the three nearest neighbours (root mean square). Reference 1;
    /// section 2.5 recommends 0.75; 0.55 with opacity 0.97 (measured, as above).
    pub scale_factor: f32,
    /// Neighbours, the point itself among them, whose spread gives a splat its axes and its standard deviations: a disc
    /// on the surface (our rule; measured: +1 dB on whole held-out views, +0.5 dB inside moving
    /// parts over spheres). At most 2, or [`isotropic`](Self::isotropic), for spheres.
    pub disc_neighbours: usize,
    /// Thickness of a disc: least standard deviation in units of the distance to the three nearest neighbours.
    pub disc_thickness: f32,
    /// Largest standard deviation, in voxel edges: an isolated point must not become a cloud.
    pub max_scale_cells: f32,
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
    /// Static splats without time, dynamic ones in velocity form, anisotropic (section 9, D1).
    #[must_use]
    pub fn fast() -> Self {
        Self {
            max_static: 80_000,
            max_dynamic: 600_000,
            static_pixels: 0.0,
            dynamic_pixels: 0.0,
            min_pixels: 1.25,
            cells: CellSize::DepthProportional,
            static_frames: 24,
            dynamic_stride: 1,
            edge_jump: 0.05,
            mask_margin_px: 2,
            free_space: 0.015,
            carry_keyframes: 24,
            carry_max: 300_000,
            carry_margin: 0.004,
            carry_reach_pixels: 6.0,
            tracked: TrackedInit::default(),
            change_threshold: 0.05,
            change_max_share: 0.1,
            change_pixels: 5.0,
            shell_splats: 2000,
            shell_radius: 2.0,
            isotropic: false,
            static_fade: false,
            opacity: 0.97,
            scale_factor: 0.55,
            disc_neighbours: 9,
            disc_thickness: 0.05,
            max_scale_cells: 3.0,
            time_spread: TimeSpread::KeyframeGaps { factor: 1.0 },
            velocity: VelocityInit::Register {
                pixels: 4.0,
                colour_scale: 0.1,
                reach_pixels: 8.0,
                neighbours: 20,
                rounds: 15,
                picture_rounds: 3,
                tracks: true,
            },
        }
    }

    /// The paper's letter, read as Instant4D (sections 1.5 and 2): isotropic, no velocity, every
    /// splat with a time span, opacity 0.1, constant voxels, scale of the plain 3-NN distance.
    #[must_use]
    pub fn faithful() -> Self {
        Self {
            max_static: 60_000,
            max_dynamic: 40_000,
            cells: CellSize::Constant,
            static_frames: 40,
            mask_margin_px: 0,
            free_space: 0.0,
            carry_keyframes: 0,
            tracked: TrackedInit {
                enabled: true,
                seen: true,
                most: 40_000,
                ..TrackedInit::default()
            },
            change_threshold: 0.0,
            shell_splats: 0,
            isotropic: true,
            static_fade: true,
            opacity: 0.1,
            scale_factor: 1.0,
            time_spread: TimeSpread::Reference { time_range: 3.0 },
            velocity: VelocityInit::Zero,
            ..Self::fast()
        }
    }

    /// Refuses values that no run can use.
    ///
    /// # Errors
    ///
    /// [`InitError::BadSetting`] naming the first field out of range.
    pub fn check(&self) -> Result<(), InitError> {
        let positive = |field, value: f32| above(field, value, 0.0, "a number above 0");
        let at_least_0 = |field, value: f32| {
            if value.is_finite() && value >= 0.0 {
                Ok(())
            } else {
                Err(bad(field, value, "a number of at least 0"))
            }
        };
        let at_least_1 = |field, value: usize| {
            if value >= 1 {
                Ok(())
            } else {
                Err(bad(field, value, "at least 1"))
            }
        };
        at_least_1("max_static", self.max_static)?;
        at_least_1("max_dynamic", self.max_dynamic)?;
        at_least_0("static_pixels", self.static_pixels)?;
        at_least_0("dynamic_pixels", self.dynamic_pixels)?;
        positive("min_pixels", self.min_pixels)?;
        at_least_1("static_frames", self.static_frames)?;
        at_least_1("dynamic_stride", self.dynamic_stride)?;
        positive("edge_jump", self.edge_jump)?;
        at_least_0("free_space", self.free_space)?;
        at_least_0("carry_margin", self.carry_margin)?;
        positive("carry_reach_pixels", self.carry_reach_pixels)?;
        at_least_0("tracked.confidence", self.tracked.confidence)?;
        at_least_0("tracked.free_space", self.tracked.free_space)?;
        positive("tracked.jump", self.tracked.jump)?;
        positive("disc_thickness", self.disc_thickness)?;
        at_least_0("change_threshold", self.change_threshold)?;
        if !(0.0..1.0).contains(&self.change_max_share) {
            return Err(bad("change_max_share", self.change_max_share, "at least 0 and below 1"));
        }
        positive("change_pixels", self.change_pixels)?;
        positive("shell_radius", self.shell_radius)?;
        if !(self.opacity > 0.0 && self.opacity < 1.0) {
            return Err(bad("opacity", self.opacity, "between 0 and 1, both excluded"));
        }
        positive("scale_factor", self.scale_factor)?;
        positive("max_scale_cells", self.max_scale_cells)?;
        match self.time_spread {
            TimeSpread::KeyframeGaps { factor } => positive("time_spread.factor", factor)?,
            TimeSpread::Reference { time_range } => positive("time_spread.time_range", time_range)?,
        }
        if let VelocityInit::Tracks {
            neighbours,
            reach_pixels,
        } = self.velocity
        {
            at_least_1("velocity.tracks.neighbours", neighbours)?;
            positive("velocity.tracks.reach_pixels", reach_pixels)?;
        }
        if let VelocityInit::Register {
            pixels,
            colour_scale,
            reach_pixels,
            neighbours,
            rounds,
            ..
        } = self.velocity
        {
            positive("velocity.pixels", pixels)?;
            positive("velocity.colour_scale", colour_scale)?;
            positive("velocity.reach_pixels", reach_pixels)?;
            at_least_1("velocity.neighbours", neighbours)?;
            at_least_1("velocity.rounds", rounds)?;
        }
        Ok(())
    }
}

/// Settings of before there were tracks.
fn tracks_are_followed() -> bool {
    true
}

fn above(field: &'static str, value: f32, low: f32, expected: &'static str) -> Result<(), InitError> {
    if value.is_finite() && value > low {
        Ok(())
    } else {
        Err(bad(field, value, expected))
    }
}

fn bad(field: &'static str, value: impl ToString, expected: &'static str) -> InitError {
    InitError::BadSetting {
        field,
        value: value.to_string(),
        expected,
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
        assert!(broken.check().unwrap_err().to_string().contains("`opacity` is 1.5"));
        let broken = InitConfig {
            scale_factor: f32::NAN,
            ..InitConfig::fast()
        };
        assert!(broken.check().is_err());
    }
}
