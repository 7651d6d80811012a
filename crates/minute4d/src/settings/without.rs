//! Parts of the method that can be switched off, each on its own.

use super::Settings;
use crate::enhance::Tracker;
use crate::geometry::Segmenter;
use serde::{Deserialize, Serialize};

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
    use super::Enhancement;
    use crate::Settings;

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
        assert_eq!(
            (density.geometry, density.init),
            (Settings::fast().geometry, Settings::fast().init)
        );
        let tracking = without(Enhancement::Tracking);
        assert_eq!(tracking.train, Settings::fast().train);
        assert_eq!(tracking.geometry.segmenter, Settings::fast().geometry.segmenter);
    }
}
