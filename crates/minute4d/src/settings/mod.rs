//! Every setting of the pipeline, and how layers of them are put together.

mod layers;
mod preset;
mod without;

pub use layers::{Layers, SettingsError};
pub use preset::Preset;
pub use without::Enhancement;

use crate::enhance::EnhanceConfig;
use crate::geometry::GeometryOptions;
use crate::preview::PreviewConfig;
use crate::viewer::ViewerConfig;
use m4_init::InitConfig;
use m4_io::capture::CaptureOptions;
use m4_io::video::VideoOptions;
use m4_slam::dense::DenseConfig;
use m4_slam::megasam::MegasamSettings;
use m4_slam::sparse::SparseConfig;
use m4_train::TrainConfig;
use serde::{Deserialize, Serialize};

/// Every setting of every stage; what `--print-config` shows and `--set` changes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Which part of a video is read.
    pub video: VideoOptions,
    /// Limits on captures.
    pub capture: CaptureOptions,
    /// Who measures flow, and what is known of the clip.
    pub geometry: GeometryOptions,
    /// Cameras and tracks.
    pub sparse: SparseConfig,
    /// Depth and masks.
    pub dense: DenseConfig,
    /// MegaSaM's way, where the front end is its own.
    pub megasam: MegasamSettings,
    /// Masks over time, and points that are followed.
    pub enhance: EnhanceConfig,
    /// The first splats.
    pub init: InitConfig,
    /// Optimisation.
    pub train: TrainConfig,
    /// How long a run may take; no part of the result where it suffices.
    pub limit: LimitConfig,
    /// When training is saved; no part of the result.
    pub checkpoint: CheckpointConfig,
    /// The clip that shows the result.
    pub preview: PreviewConfig,
    /// The page that shows the result.
    pub viewer: ViewerConfig,
}

/// How long a run may take.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LimitConfig {
    /// Seconds from start to end; 0 for as long as it takes. Training is planned to end in time, and ended where it would
    /// not. Geometry that takes longer is saved and goes on with the next attempt.
    pub time_s: f64,
}

/// When training is saved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CheckpointConfig {
    /// Seconds between two checkpoints. 30: what a person is willing to lose.
    pub every_s: f64,
    /// How many are kept. 2: one is whole even when the other cannot be read.
    pub keep: usize,
}

impl Default for CheckpointConfig {
    fn default() -> Self {
        Self { every_s: 30.0, keep: 2 }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self::fast()
    }
}

impl Settings {
    /// Minutes on a plain CPU.
    #[must_use]
    pub fn fast() -> Self {
        Self {
            video: VideoOptions::default(),
            capture: CaptureOptions::default(),
            geometry: GeometryOptions::default(),
            sparse: SparseConfig::default(),
            dense: DenseConfig::default(),
            megasam: MegasamSettings::default(),
            enhance: EnhanceConfig::default(),
            init: InitConfig::fast(),
            train: TrainConfig::fast(),
            limit: LimitConfig::default(),
            checkpoint: CheckpointConfig::default(),
            preview: PreviewConfig::default(),
            viewer: ViewerConfig::default(),
        }
    }

    /// The paper to the letter, with documented choices where it is silent.
    #[must_use]
    pub fn faithful() -> Self {
        Self {
            init: InitConfig::faithful(),
            train: TrainConfig::faithful(),
            ..Self::fast()
        }
    }

    /// Uses one seed for every random number.
    pub fn set_seed(&mut self, seed: u64) {
        self.train.seed = seed;
        self.sparse.seed = seed;
    }

    /// As TOML, every key with its value.
    ///
    /// # Errors
    ///
    /// [`SettingsError::Internal`] if a value cannot be written as TOML.
    pub fn to_toml(&self) -> Result<String, SettingsError> {
        part_to_toml(self)
    }
}

/// Some settings as TOML: what keys of stages are made of.
pub(crate) fn part_to_toml(part: &impl Serialize) -> Result<String, SettingsError> {
    toml::to_string_pretty(part).map_err(|e| SettingsError::Internal { reason: e.to_string() })
}

#[cfg(test)]
mod tests {
    use super::{Layers, Settings};

    #[test]
    fn every_profile_survives_toml() {
        for settings in [Settings::fast(), Settings::faithful()] {
            let text = settings.to_toml().unwrap();
            assert_eq!(toml::from_str::<Settings>(&text).unwrap(), settings);
        }
    }

    #[test]
    fn settings_of_every_stage_can_be_changed() {
        let layers = Layers::new(Settings::fast()).unwrap();
        let sets = [
            "train.iterations=7",
            "init.opacity=0.2",
            "video.max_frames=12",
            "sparse.fov_deg=60",
            "dense.working_side_px=200",
            "preview.swing.side_deg=5",
            "checkpoint.every_s=1",
        ];
        let settings = sets
            .iter()
            .try_fold(layers, |layers, set| layers.set(set))
            .unwrap()
            .finish();
        assert_eq!((settings.train.iterations, settings.video.max_frames), (7, Some(12)));
        assert_eq!(
            (settings.sparse.fov_deg, settings.dense.working_side_px),
            (Some(60.0), 200)
        );
        let text = Layers::new(Settings::fast())
            .unwrap()
            .set("iterations=7")
            .unwrap_err()
            .to_string();
        assert!(text.contains("did you mean \"train.iterations\"?"), "{text}");
    }
}
