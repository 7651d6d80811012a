//! Profiles, presets and switches: what settings are made of.

use super::Settings;
use crate::enhance::Tracker;
use crate::geometry::Segmenter;
use m4_train::TrainConfig;
use m4_train::init::InitConfig;
use serde::{Deserialize, Serialize};

/// The built-in settings that a run starts from. It also decides everything about the first splats and the training that has no
/// key of its own.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Profile {
    /// Minutes on a plain CPU.
    #[default]
    Fast,
    /// The paper to the letter, with documented choices where it is silent.
    Faithful,
}

impl Profile {
    /// As options, files and records name it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Faithful => "faithful",
        }
    }

    pub(super) fn init(self) -> InitConfig {
        match self {
            Self::Fast => InitConfig::fast(),
            Self::Faithful => InitConfig::faithful(),
        }
    }

    pub(super) fn train(self) -> TrainConfig {
        match self {
            Self::Fast => TrainConfig::fast(),
            Self::Faithful => TrainConfig::faithful(),
        }
    }
}

/// A trade of time against quality, laid over a profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Preset {
    /// A first impression in ten seconds of optimisation, with a third of the splats.
    Draft,
    /// The best scene within sixty seconds of optimisation on this machine, whatever the clip.
    #[default]
    Default,
}

impl Preset {
    /// Changes `settings` accordingly.
    pub fn apply(self, settings: &mut Settings) {
        let (init, train) = (&mut settings.init, &mut settings.train);
        train.budget_s = match self {
            Self::Draft => 10.0,
            Self::Default => 60.0,
        };
        if self == Self::Draft {
            init.max_static /= 3;
            init.max_dynamic /= 3;
        }
    }
}

/// A part of the method that works without: what ablations switch off (paper, table 3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Enhancement {
    /// Masks by a network that knows what things look like.
    Segmentation,
    /// Points followed through the clip: parts that a frame hides are filled from others, and first velocities.
    Tracking,
    /// Density control: splats added and pruned by the errors of frames.
    Density,
}

impl Settings {
    /// Switches a part off in every stage that has it.
    pub fn switch_off(&mut self, part: Enhancement) {
        match part {
            Enhancement::Segmentation => self.geometry.segmenter = Segmenter::None,
            Enhancement::Tracking => {
                self.geometry.tracker = Tracker::None;
                self.dense.tracks = false;
                self.init.tracks = false;
            }
            Enhancement::Density => self.train.density.enabled = false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Enhancement, Preset, Settings};

    #[test]
    fn a_preset_sets_its_time_and_draft_a_third_of_the_splats_and_nothing_else() {
        let fast = Settings::fast();
        for (preset, budget_s, share) in [(Preset::Draft, 10.0, 3), (Preset::Default, 60.0, 1)] {
            let (mut settings, mut want) = (fast.clone(), fast.clone());
            preset.apply(&mut settings);
            want.train.budget_s = budget_s;
            want.init.max_static = fast.init.max_static / share;
            want.init.max_dynamic = fast.init.max_dynamic / share;
            assert_eq!(settings, want, "{preset:?}");
            settings.check().unwrap();
        }
        assert_eq!(Preset::default(), Preset::Default);
    }

    #[test]
    fn each_part_changes_settings_of_its_own() {
        let parts = [Enhancement::Segmentation, Enhancement::Tracking, Enhancement::Density];
        let without = |part| {
            let mut settings = Settings::fast();
            settings.switch_off(part);
            settings
        };
        for part in parts {
            assert_ne!(without(part), Settings::fast(), "{part:?}");
        }
        let density = without(Enhancement::Density);
        assert_eq!((density.geometry, density.init), (Settings::fast().geometry, Settings::fast().init));
        let tracking = without(Enhancement::Tracking);
        assert_eq!(tracking.train, Settings::fast().train);
        assert_eq!(tracking.geometry.segmenter, Settings::fast().geometry.segmenter);
    }
}
