//! The keys of the first splats.

use super::Profile;
use m4_train::init::{InitConfig, TimeSpread, VelocityInit};
use serde::{Deserialize, Serialize};

/// What users change of the first splats; the rest is the profile's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InitSettings {
    /// As [`InitConfig::max_static`].
    pub max_static: usize,
    /// As [`InitConfig::max_dynamic`].
    pub max_dynamic: usize,
    /// Standard deviation in time of dynamic splats, gaps between keyframes ([`TimeSpread::KeyframeGaps`]); `None`: that of the
    /// reference.
    pub keyframe_gaps: Option<f32>,
    /// Points are added where the tracks of the capture, or the motion of the frames' own points, place what a frame cannot see,
    /// and tracks give first velocities.
    pub tracks: bool,
}

impl InitSettings {
    /// Those of a profile.
    #[must_use]
    pub fn of(profile: Profile) -> Self {
        let config = profile.init();
        Self {
            max_static: config.max_static,
            max_dynamic: config.max_dynamic,
            keyframe_gaps: match config.time_spread {
                TimeSpread::KeyframeGaps { factor } => Some(factor),
                TimeSpread::Reference { .. } => None,
            },
            tracks: true,
        }
    }

    /// What the stage is given.
    #[must_use]
    pub fn config(&self, profile: Profile) -> InitConfig {
        let mut config = InitConfig {
            max_static: self.max_static,
            max_dynamic: self.max_dynamic,
            ..profile.init()
        };
        if let Some(factor) = self.keyframe_gaps {
            config.time_spread = TimeSpread::KeyframeGaps { factor };
        }
        if !self.tracks {
            config.carry_keyframes = 0;
            config.tracked.enabled = false;
            if let VelocityInit::Register { tracks } = &mut config.velocity {
                *tracks = false;
            }
        }
        config
    }
}
