//! Settings of refinement.

use super::error::InstanceError;
use serde::{Deserialize, Serialize};

/// How often new things are looked for, by kind of clip (the paper's B).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Long clips of a hand-held camera, as DyCheck's: every 50 frames.
    Dycheck,
    /// A dozen frames with much motion between them, as NVIDIA's: every 2.
    Nvidia,
    /// Short clips at full rate, as DAVIS': every 10.
    Davis,
}

impl Preset {
    /// Frames from one search for new things to the next.
    #[must_use]
    pub fn every_frames(self) -> usize {
        match self {
            Self::Dycheck => 50,
            Self::Nvidia => 2,
            Self::Davis => 10,
        }
    }
}

/// What high values of a map of motion mean.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MotionReading {
    /// That something moves; maps that look turned round are refused.
    #[default]
    Checked,
    /// That something moves, whatever the maps look like.
    Moving,
    /// That something rests, as in MegaSaM's own files.
    Still,
}

/// Settings of [`super::refine()`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefineSettings {
    /// Longest side of the masks while things are followed, pixels; frames that are smaller are used as they are. 960: the clips of the
    /// paper's data sets are not made smaller.
    pub side_px: usize,
    /// Motion above which a pixel moves. Paper: tau = 0.7.
    pub tau: f32,
    /// Motion below which a pixel surely rests: where places off a thing are taken from.
    pub tau_still: f32,
    /// What maps of motion mean.
    pub reading: MotionReading,
    /// Radius of the opening of coarse masks, share of the longest side: 2 px of 480. Below 1 px there is none.
    pub open_share: f32,
    /// Least area of a coarse part, share of the picture. Specification: 0.001 to 0.002.
    pub least_area: f32,
    /// Frames from one search for new things to the next. Paper: B = 50, 2 or 10 ([`Preset`]).
    pub every_frames: usize,
    /// Places on a thing. Specification: 3 to 5.
    pub points_on: usize,
    /// Places off a thing. Specification: 1 to 2.
    pub points_off: usize,
    /// How fast belief grows with the distance from a part's edge, logits a pixel; as [`crate::dense::SegmentConfig::belief_per_px`].
    pub belief_per_px: f32,
    /// The firmest belief, logits; as [`crate::dense::SegmentConfig::belief_limit`].
    pub belief_limit: f32,
    /// A mask that covers a larger share of the picture is of the background. Specification: 0.3 to 0.35.
    pub most_share: f32,
    /// Least intersection over union of a mask with the part that it was asked for. Specification: 0.2.
    pub least_overlap: f32,
    /// Below this intersection over union the thing starts with the coarse part's outline in place of the segmenter's. `None`: 0 (never) for
    /// maps of motion, which are too coarse to have one, and 0.6 for masks, as [`crate::dense::SegmentConfig::least_overlap`].
    pub outline_overlap: Option<f32>,
    /// Things that overlap by more (intersection over union) are one. Specification: 0.7.
    pub merge_overlap: f32,
    /// By how much the things' masks are made larger before what they do not cover is looked at, share of the longest side: 10 px of 480, since maps
    /// of an eighth of the size are as wide of the mark. What is left is opened by half of it, so that rims are no things.
    pub cover_share: f32,
    /// In how many of three frames around it a part must be seen. Specification: 2. It holds for the first frame, too, where the paper does not ask for it.
    pub persistent_in: usize,
    /// Share of a part's pixels that must be coarse in another frame for it to be seen there.
    pub persistent_overlap: f32,
    /// In what share of its frames a thing must be supported by coarse pixels (on a quarter of it): what was taken for moving for a moment
    /// and never again is dropped. Not in the paper, which has 0.
    pub least_support: f32,
    /// Whether coarse parts that no thing explains stay in the masks, without a number. `None`: yes for masks, which found them
    /// with more care, no for maps of motion (the paper).
    pub keep_unexplained: Option<bool>,
    /// How far from coarse pixels masks may reach, share of the longest side. `None`: as far as they will where the segmenter knows what things
    /// look like (the paper), and 6 px of 480 where masks are carried from frame to frame, which spread over what they pass and
    /// stick to it. Where less than a quarter of a mask is left, it is kept whole within five frames of one where more is, and dropped elsewhere.
    pub bound_share: Option<f32>,
    /// Holes of the masks up to this share of the picture are filled.
    pub hole_share: f32,
}

impl Default for RefineSettings {
    fn default() -> Self {
        Self {
            side_px: 960,
            tau: 0.7,
            tau_still: 0.3,
            reading: MotionReading::default(),
            open_share: 2.0 / 480.0,
            least_area: 0.0015,
            every_frames: Preset::Davis.every_frames(),
            points_on: 4,
            points_off: 2,
            belief_per_px: 1.0,
            belief_limit: 4.0,
            most_share: 0.35,
            least_overlap: 0.2,
            outline_overlap: None,
            merge_overlap: 0.7,
            cover_share: 10.0 / 480.0,
            persistent_in: 2,
            persistent_overlap: 0.5,
            least_support: 0.1,
            keep_unexplained: None,
            bound_share: None,
            hole_share: 0.001,
        }
    }
}

/// How far masks reach that are carried from frame to frame: [`RefineSettings::bound_share`].
const CARRIED_BOUND: f32 = 6.0 / 480.0;

impl RefineSettings {
    /// The bound of masks of a segmenter that knows what things look like, or does not.
    pub(super) fn bound(&self, remembers: bool) -> Option<f32> {
        self.bound_share.or((!remembers).then_some(CARRIED_BOUND))
    }

    /// The defaults with the paper's number of frames between searches.
    #[must_use]
    pub fn preset(preset: Preset) -> Self {
        Self {
            every_frames: preset.every_frames(),
            ..Self::default()
        }
    }

    /// Rejects settings that nothing could work with.
    ///
    /// # Errors
    ///
    /// [`InstanceError::Setting`].
    pub fn check(&self) -> Result<(), InstanceError> {
        let need = |ok: bool, name, value: f64, range| {
            if ok {
                Ok(())
            } else {
                Err(InstanceError::Setting { name, value, range })
            }
        };
        let whole = [
            ("side_px", self.side_px, 64, 4096, "64 to 4096"),
            ("every_frames", self.every_frames, 1, 1_000_000, "1 to 1000000"),
            ("points_on", self.points_on, 1, 16, "1 to 16"),
            ("points_off", self.points_off, 0, 16, "0 to 16"),
            ("persistent_in", self.persistent_in, 1, 3, "1 to 3"),
        ];
        for (name, value, least, most, range) in whole {
            need((least..=most).contains(&value), name, value as f64, range)?;
        }
        let shares = [
            ("tau", self.tau),
            ("tau_still", self.tau_still),
            ("open_share", self.open_share),
            ("least_area", self.least_area),
            ("most_share", self.most_share),
            ("least_overlap", self.least_overlap),
            ("outline_overlap", self.outline_overlap.unwrap_or(0.0)),
            ("merge_overlap", self.merge_overlap),
            ("cover_share", self.cover_share),
            ("persistent_overlap", self.persistent_overlap),
            ("least_support", self.least_support),
            ("bound_share", self.bound_share.unwrap_or(0.0)),
            ("hole_share", self.hole_share),
        ];
        for (name, value) in shares {
            need((0.0..=1.0).contains(&value), name, value.into(), "0 to 1")?;
        }
        need(
            self.tau_still <= self.tau,
            "tau_still",
            self.tau_still.into(),
            "at most tau",
        )?;
        for (name, value) in [
            ("belief_per_px", self.belief_per_px),
            ("belief_limit", self.belief_limit),
        ] {
            need(
                value > 0.0 && value <= 100.0,
                name,
                value.into(),
                "above 0, at most 100",
            )?;
        }
        Ok(())
    }
}
