//! Settings of the dense half.

use super::DenseError;
use super::segment::SegmentConfig;
use crate::cvd::CvdSettings;
use serde::{Deserialize, Serialize};

/// Settings of [`super::densify()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DenseConfig {
    /// Longest side of the images that flow, depth and masks are computed on, pixels; frames that are
    /// smaller are used as they are. The specification has "320-384"; 480 finds masks and thin parts that 320 misses and
    /// keeps 96 frames under a minute and a half on two cores.
    pub working_side_px: usize,
    /// Memory for the planes of all frames together, megabytes: long clips are worked on at a smaller size. 4096: 240 frames
    /// at 480x360.
    pub memory_mb: usize,
    /// Dense flow.
    pub flow: FlowConfig,
    /// Depth of what does not move.
    pub static_depth: StaticDepthConfig,
    /// What moves.
    pub motion: MotionConfig,
    /// Depth that agrees over time.
    pub consistent: ConsistentConfig,
    /// Masks against what is seen when nothing is in the way.
    pub plate: PlateConfig,
    /// Masks by a segmenter, where there is one.
    pub segment: SegmentConfig,
    /// Depth of what moves, from what it touches.
    pub moving_depth: MovingDepthConfig,
    /// Depth of what moves, as rigid bodies.
    pub bodies: BodyConfig,
    /// Points of what moves, followed through the clip.
    pub tracks: TrackConfig,
}

impl Default for DenseConfig {
    fn default() -> Self {
        Self {
            working_side_px: 480,
            memory_mb: 4096,
            flow: FlowConfig::default(),
            static_depth: StaticDepthConfig::default(),
            motion: MotionConfig::default(),
            consistent: ConsistentConfig::default(),
            plate: PlateConfig::default(),
            segment: SegmentConfig::default(),
            moving_depth: MovingDepthConfig::default(),
            bodies: BodyConfig::default(),
            tracks: TrackConfig::default(),
        }
    }
}

/// Inverse-search flow with variational refinement (Kroeger et al. 2016).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlowConfig {
    /// Side of a patch, pixels. Kroeger et al. and the specification: 8.
    pub patch_px: usize,
    /// Distance of patches, pixels. Specification: 4.
    pub stride_px: usize,
    /// Gauss-Newton steps a patch and level. Kroeger et al.: 12.
    pub iterations: usize,
    /// Linearisations of the variational energy a level. Kroeger et al.: level + 1; 3 measured as good.
    pub refinements: usize,
    /// Relaxation sweeps a linearisation. Kroeger et al.: 3 to 5.
    pub relaxations: usize,
    /// Weight of smoothness. As in OpenCV's implementation of the paper: 20.
    pub smoothness: f32,
    /// Weight of equal brightness. Kroeger et al.: 5.
    pub brightness: f32,
    /// Weight of equal gradients. Kroeger et al.: 10.
    pub gradient: f32,
}

impl Default for FlowConfig {
    fn default() -> Self {
        Self {
            patch_px: 8,
            stride_px: 4,
            iterations: 12,
            refinements: 3,
            relaxations: 5,
            smoothness: 20.0,
            brightness: 5.0,
            gradient: 10.0,
        }
    }
}

/// Plane sweep, aggregation, consistency and fill.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StaticDepthConfig {
    /// Disparities tried between the farthest and the nearest surface.
    pub hypotheses: usize,
    /// Parallax of a point at median depth between a frame and its partners on each side, pixels at
    /// the working size: one partner a target and side.
    pub parallax_px: Vec<f64>,
    /// How far away in time partners may be, frames. Specification: 8; slow cameras need more.
    pub partner_frames: usize,
    /// Least parallax of a partner, pixels at the working size.
    pub least_parallax_px: f64,
    /// Penalty of a disparity step of one between neighbours, census bits (Hirschmueller 2008, P1).
    pub small_step: i16,
    /// Penalty of a larger step on a flat image, census bits (P2).
    pub large_step: i16,
    /// Largest difference to a partner's disparity that counts as agreement, in hypothesis steps.
    pub agree_steps: f32,
    /// Patches of agreement smaller than this are taken for chance, pixels at the working size.
    pub least_patch_px: usize,
    /// Weight of one sparse point in the fill; a pixel on which all partners agree has 1.
    pub point_weight: f32,
    /// Strength of the edge-aware fill, pixels squared (Min et al. 2014, lambda).
    pub fill_lambda: f32,
    /// Strength of the last smoothing, pixels squared.
    pub denoise_lambda: f32,
    /// Colour difference that stops the fill, 0..255 (Min et al. 2014, sigma).
    pub fill_sigma: f32,
}

impl Default for StaticDepthConfig {
    fn default() -> Self {
        Self {
            hypotheses: 64,
            parallax_px: vec![6.0, 12.0],
            partner_frames: 24,
            least_parallax_px: 1.5,
            small_step: 6,
            large_step: 40,
            agree_steps: 1.5,
            least_patch_px: 30,
            point_weight: 4.0,
            fill_lambda: 900.0,
            denoise_lambda: 4.0,
            fill_sigma: 8.0,
        }
    }
}

/// Motion evidence and masks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotionConfig {
    /// Over how many frames flow is chained and compared, each both ways: the short for fast motion,
    /// the long for slow.
    pub spans: Vec<usize>,
    /// Noise of the flow, pixels at the working size.
    pub flow_noise_px: f32,
    /// Noise of the flow that grows with its length, as a share of it.
    pub flow_noise_share: f32,
    /// Residual at which a pixel is as likely to move as not, in units of the noise. The
    /// specification's 3 MAD are 2 standard deviations.
    pub threshold: f32,
    /// Strength of a vote for static against one for moving, 0..1: motion that one span alone can
    /// see outvotes the rest.
    pub static_vote: f32,
    /// Difference in brightness (0..255, mean of 5x5 pixels) between a pixel and its place in the
    /// other frame if it stood still that clearly speaks against standing still.
    pub brightness_step: f32,
    /// Least weight of flow that says a pixel moves although the pixel looks as if it stood still, 0..1.
    pub least_refuted: f32,
    /// How often evidence is averaged with that of the frames before and after, along the flow.
    pub votes: usize,
    /// Strength of the edge-aware smoothing of evidence, pixels squared (Min et al. 2014, lambda).
    pub smooth_lambda: f32,
    /// Evidence of a pixel on which all partners agree that it does not move, 0..1.
    pub agreement: f32,
    /// Weight of the belief that a pixel about which nothing is known does not move; the flow between
    /// two frames has 1.
    pub prior: f32,
    /// Weight of a track's verdict; the flow between two frames has 1.
    pub track_weight: f32,
    /// Components below this share of the image are dropped. Specification: 0.2 %.
    pub least_component: f32,
}

impl Default for MotionConfig {
    fn default() -> Self {
        Self {
            spans: vec![1, 4],
            flow_noise_px: 0.4,
            flow_noise_share: 0.05,
            threshold: 2.5,
            static_vote: 0.5,
            brightness_step: 6.0,
            least_refuted: 0.1,
            votes: 16,
            smooth_lambda: 100.0,
            agreement: 1.0,
            prior: 0.3,
            track_weight: 3.0,
            least_component: 0.002,
        }
    }
}

/// Depth of what moves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MovingDepthConfig {
    /// Time over which depth is smoothed along the flow, frames (decay by e).
    pub smooth_frames: f32,
    /// Power of the disparity that is averaged: 1 for the plain mean, more to favour the nearest.
    /// Measured with 8 frames: 4 takes the error of falling toys from 0.34 to 0.27 of their depth and
    /// costs what stays on the ground 0.01 to 0.02.
    pub power: f32,
    /// Flow whose round trip misses by more than this is not followed, pixels at the working size.
    pub round_trip_px: f32,
    /// Lowest share of a part's height in which it may touch the ground.
    pub feet_share: f32,
    /// How far under a part's lowest pixels the ground is read, pixels at the working size.
    pub below_px: usize,
    /// Share of the background behind a part that the part must be in front of.
    pub hidden_quantile: f64,
}

impl Default for MovingDepthConfig {
    fn default() -> Self {
        Self {
            smooth_frames: 8.0,
            power: 4.0,
            round_trip_px: 2.0,
            feet_share: 0.1,
            below_px: 3,
            hidden_quantile: 0.98,
        }
    }
}

/// Consistent video depth of what stands still.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConsistentConfig {
    /// Whether it is done at all.
    pub enabled: bool,
    /// How firmly pixels on which all partners agree stay where they are.
    pub prior: f32,
    /// Flow of a pair counts if it misses where measured depth leads by at most this share of the parallax, medians over what
    /// was measured.
    pub flow_miss: f32,
    /// Memory for flow; more goes to a temporary file, bytes.
    pub flow_bytes: usize,
    /// The optimisation.
    pub optimiser: CvdSettings,
}

impl Default for ConsistentConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            prior: 1.0,
            flow_miss: 0.06,
            flow_bytes: 512 << 20,
            optimiser: CvdSettings::default(),
        }
    }
}

/// Masks against the clean plate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlateConfig {
    /// Distances in time of the frames that a plate is made of, each both ways.
    pub reaches: Vec<usize>,
    /// Fewest frames that must have seen a pixel of the background.
    pub least_frames: usize,
    /// How far beyond its mask a part may reach, pixels at the working size.
    pub margin_px: usize,
    /// How far masks are grown before other frames' pixels are believed to be background, pixels.
    pub guard_px: usize,
    /// Difference in colour (0..255, mean of 5x5 pixels) that is as likely motion as not.
    pub step: f32,
    /// The same outside of the mask so far.
    pub step_outside: f32,
    /// Darkest shadow, as a share of the light.
    pub least_gain: f32,
    /// What it costs to explain a difference by a shadow, 0..255 for full darkness.
    pub gain_cost: f32,
    /// Weight of the mask so far; a pixel of the plate has 1.
    pub prior: f32,
    /// Strength of the edge-aware smoothing, pixels squared (Min et al. 2014, lambda).
    pub smooth_lambda: f32,
}

impl Default for PlateConfig {
    fn default() -> Self {
        Self {
            reaches: vec![2, 5, 9, 14, 20],
            least_frames: 2,
            margin_px: 6,
            guard_px: 2,
            step: 20.0,
            step_outside: 32.0,
            least_gain: 0.4,
            gain_cost: 20.0,
            prior: 0.3,
            smooth_lambda: 10.0,
        }
    }
}

/// Moving parts as rigid bodies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BodyConfig {
    /// Distance of the pixels that are adjusted, pixels at the working size.
    pub block_px: usize,
    /// Over how many frames a part is compared with itself, each both ways.
    pub spans: Vec<usize>,
    /// Parts smaller than this share of the image are left alone.
    pub least_share: f32,
    /// Fewest frames.
    pub shortest: usize,
    /// Most frames that are adjusted together: bounds memory.
    pub longest: usize,
    /// Fewest adjusted pixels a frame.
    pub least_points: usize,
    /// A part that grows or shrinks by more than this factor from one frame to the next is another part.
    pub growth: f32,
    /// Flow whose round trip misses by more than this is not followed, pixels at the working size.
    pub round_trip_px: f32,
    /// Noise of the flow, pixels at the working size (scale of the Cauchy weight).
    pub noise_px: f32,
    /// Weight of the disparity that contact suggests.
    pub prior: f32,
    /// Share of a part's relief that is kept, 0..1; the rest is drawn to a plane.
    pub relief: f32,
    /// Iterations with the shape held.
    pub pose_iterations: usize,
    /// Iterations of everything.
    pub iterations: usize,
    /// Share of the frames whose lower bound of the scale the scale exceeds.
    pub touch_quantile: f32,
    /// A part stands on ground where what lies under it comes nearer by more than this share of its disparity a row.
    pub ground_slope: f32,
    /// Least share of its frames in which a part must stand for its scale to be known.
    pub standing_share: f32,
    /// A part whose way, at its best scale, is shorter than this share of what the camera's way would make of it at
    /// another, stays in place, and that is its scale.
    pub still_rest: f64,
    /// ... unless that is farther than what it hides by more than this factor.
    pub still_range: f32,
    /// Parts that fly take their distance from how they fall, where there is a ground.
    pub falling: bool,
    /// Strength of the edge-aware spreading, pixels squared (Min et al. 2014, lambda).
    pub fill_lambda: f32,
}

impl Default for BodyConfig {
    fn default() -> Self {
        Self {
            block_px: 4,
            spans: vec![1, 3, 8],
            least_share: 0.002,
            shortest: 5,
            longest: 96,
            least_points: 12,
            growth: 1.6,
            round_trip_px: 1.5,
            noise_px: 0.6,
            prior: 0.001,
            relief: 0.5,
            pose_iterations: 6,
            iterations: 20,
            touch_quantile: 0.75,
            ground_slope: 0.003,
            standing_share: 0.3,
            still_rest: 0.12,
            still_range: 1.2,
            falling: true,
            fill_lambda: 100.0,
        }
    }
}

/// Points of moving parts, followed along the flow.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackConfig {
    /// Whether points are followed at all.
    pub enabled: bool,
    /// Distance of the points where they start, pixels at the working size.
    pub spacing_px: usize,
    /// Points start in every n-th frame, where no track passes. The specification's queries: every frame to every 10th.
    pub every: usize,
    /// Flow whose round trip misses by more than this is not followed, pixels at the working size.
    pub round_trip_px: f32,
    /// Fewest frames of a track.
    pub shortest: usize,
    /// A track is cut at a step longer than this many times its median step.
    pub jump: f32,
    /// Time over which the depth of a track is smoothed, standard deviation in frames; 0 for none.
    pub smooth_frames: f32,
    /// Most tracks; more are thinned everywhere alike.
    pub most: usize,
}

impl Default for TrackConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            spacing_px: 4,
            every: 4,
            round_trip_px: 1.0,
            shortest: 4,
            jump: 5.0,
            smooth_frames: 2.0,
            most: 20_000,
        }
    }
}

impl DenseConfig {
    /// Rejects settings that no computation could use.
    pub(super) fn check(&self) -> Result<(), DenseError> {
        let need = |ok: bool, name: &'static str, value: f64, range: &'static str| {
            if ok {
                Ok(())
            } else {
                Err(DenseError::Setting { name, value, range })
            }
        };
        let (f, s) = (&self.flow, &self.static_depth);
        let side = self.working_side_px;
        need(
            (64..=2048).contains(&side),
            "dense.working_side_px",
            side as f64,
            "64 to 2048",
        )?;
        need(
            (4..=16).contains(&f.patch_px),
            "dense.flow.patch_px",
            f.patch_px as f64,
            "4 to 16",
        )?;
        let stride = f.stride_px;
        need(
            (1..=f.patch_px).contains(&stride),
            "dense.flow.stride_px",
            stride as f64,
            "1 to patch_px",
        )?;
        let n = s.hypotheses;
        need(
            (8..=256).contains(&n),
            "dense.static_depth.hypotheses",
            n as f64,
            "8 to 256",
        )?;
        let parallax = s.parallax_px.iter().copied().fold(f64::INFINITY, f64::min);
        need(
            parallax > 0.0 && parallax.is_finite(),
            "dense.static_depth.parallax_px",
            parallax,
            "a list above 0",
        )?;
        let above_zero = [
            ("dense.static_depth.fill_lambda", s.fill_lambda),
            ("dense.static_depth.denoise_lambda", s.denoise_lambda),
            ("dense.static_depth.fill_sigma", s.fill_sigma),
            ("dense.static_depth.agree_steps", s.agree_steps),
            ("dense.motion.flow_noise_px", self.motion.flow_noise_px),
            ("dense.motion.brightness_step", self.motion.brightness_step),
            ("dense.motion.smooth_lambda", self.motion.smooth_lambda),
            ("dense.flow.smoothness", f.smoothness),
        ];
        for (name, value) in above_zero {
            need(
                value > 0.0 && value.is_finite(),
                name,
                f64::from(value),
                "a number above 0",
            )?;
        }
        let steps = [
            ("dense.static_depth.small_step", s.small_step),
            ("dense.static_depth.large_step", s.large_step),
        ];
        for (name, value) in steps {
            need((0..=1000).contains(&value), name, f64::from(value), "0 to 1000")?;
        }
        self.check_bodies(&need)?;
        self.segment.check(&need)?;
        self.check_tracks(&need)?;
        let q = self.moving_depth.hidden_quantile;
        need(
            (0.0..=1.0).contains(&q),
            "dense.moving_depth.hidden_quantile",
            q,
            "0 to 1",
        )
    }

    /// The settings of tracks.
    fn check_tracks(
        &self,
        need: &impl Fn(bool, &'static str, f64, &'static str) -> Result<(), DenseError>,
    ) -> Result<(), DenseError> {
        let t = &self.tracks;
        let counts = [
            ("dense.tracks.spacing_px", t.spacing_px, 1, 256, "1 to 256"),
            ("dense.tracks.every", t.every, 1, 10_000, "1 to 10000"),
            ("dense.tracks.shortest", t.shortest, 2, 10_000, "2 to 10000"),
            ("dense.tracks.most", t.most, 1, 1_000_000, "1 to 1000000"),
        ];
        for (name, value, least, most, range) in counts {
            need((least..=most).contains(&value), name, value as f64, range)?;
        }
        for (name, value) in [
            ("dense.tracks.round_trip_px", t.round_trip_px),
            ("dense.tracks.jump", t.jump),
        ] {
            let good = value > 0.0 && value.is_finite();
            need(good, name, f64::from(value), "a number above 0")?;
        }
        let smooth = t.smooth_frames;
        let good = (0.0..=100.0).contains(&smooth);
        need(good, "dense.tracks.smooth_frames", f64::from(smooth), "0 to 100")
    }

    /// The settings of masks and moving parts.
    fn check_bodies(
        &self,
        need: &impl Fn(bool, &'static str, f64, &'static str) -> Result<(), DenseError>,
    ) -> Result<(), DenseError> {
        let (b, p) = (&self.bodies, &self.plate);
        let counts = [
            ("dense.bodies.block_px", b.block_px, 1, 64),
            ("dense.bodies.shortest", b.shortest, 2, 10_000),
            ("dense.bodies.longest", b.longest, b.shortest, 10_000),
            ("dense.plate.margin_px", p.margin_px, 0, 100),
            ("dense.plate.guard_px", p.guard_px, 0, 100),
            ("dense.plate.least_frames", p.least_frames, 1, 1000),
        ];
        for (name, value, least, most) in counts {
            let range =
                "a whole number within bounds (block_px 1 to 64, shortest 2 to longest, least_frames 1 or more)";
            need((least..=most).contains(&value), name, value as f64, range)?;
        }
        let reach = p.reaches.iter().copied().min().unwrap_or(0);
        need(
            reach > 0,
            "dense.plate.reaches",
            reach as f64,
            "a list of frames, each 1 or more",
        )?;
        let above_zero = [
            ("dense.plate.step", p.step),
            ("dense.plate.step_outside", p.step_outside),
            ("dense.plate.smooth_lambda", p.smooth_lambda),
            ("dense.bodies.growth", b.growth),
            ("dense.bodies.round_trip_px", b.round_trip_px),
            ("dense.bodies.noise_px", b.noise_px),
            ("dense.bodies.prior", b.prior),
            ("dense.bodies.still_range", b.still_range),
            ("dense.bodies.fill_lambda", b.fill_lambda),
            ("dense.consistent.flow_miss", self.consistent.flow_miss),
        ];
        for (name, value) in above_zero {
            let good = value > 0.0 && value.is_finite();
            need(good, name, f64::from(value), "a number above 0")?;
        }
        let shares = [
            ("dense.plate.least_gain", p.least_gain),
            ("dense.bodies.touch_quantile", b.touch_quantile),
            ("dense.bodies.relief", b.relief),
            ("dense.bodies.least_share", b.least_share),
        ];
        for (name, value) in shares {
            need((0.0..=1.0).contains(&value), name, f64::from(value), "0 to 1")?;
        }
        let prior = self.consistent.prior;
        need(
            prior >= 0.0 && prior.is_finite(),
            "dense.consistent.prior",
            f64::from(prior),
            "0 or more",
        )
    }
}
