//! Every setting of the pipeline, and how layers of them are put together.

mod layers;
#[cfg(test)]
mod page;
mod profile;
mod train;

pub use layers::{Layers, SettingsError};
pub use profile::{Enhancement, Preset, Profile};
pub use train::{ColourFitSettings, DensitySettings, InitSettings, LossSettings, RefinementSettings, TrainSettings};

use crate::Error;
use crate::enhance::EnhanceConfig;
use crate::geometry::GeometryOptions;
use crate::preview::PreviewConfig;
use crate::viewer::ViewerConfig;
use m4_geometry::classical::dense::DenseConfig;
use m4_geometry::classical::sparse::SparseConfig;
use m4_geometry::megasam::MegasamSettings;
use m4_io::capture::CaptureOptions;
use m4_io::video::VideoOptions;
use m4_train::TrainConfig;
use m4_train::init::InitConfig;
use serde::{Deserialize, Serialize};

/// Every setting of every stage; what `--print-config` shows and `--set` changes. `docs/settings.md` lists the keys.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// The built-in settings that the others start from; it decides everything that has no key. Set it with [`Self::of`], not alone.
    pub profile: Profile,
    /// Which part of a video is read.
    pub video: VideoOptions,
    /// Limits on captures.
    pub capture: CaptureOptions,
    /// Methods of geometry, and priors of the user.
    pub geometry: GeometryOptions,
    /// Cameras and tracks.
    pub sparse: SparseConfig,
    /// Depth and masks.
    pub dense: DenseConfig,
    /// The front end of MegaSaM.
    pub megasam: MegasamSettings,
    /// Segmentation and tracking through the clip.
    pub enhance: EnhanceConfig,
    /// The first splats.
    pub init: InitSettings,
    /// Optimisation.
    pub train: TrainSettings,
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
    /// not. Geometry that takes longer is saved and resumes with the next attempt.
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
    /// The built-in settings of a profile.
    #[must_use]
    pub fn of(profile: Profile) -> Self {
        Self {
            profile,
            video: VideoOptions::default(),
            capture: CaptureOptions::default(),
            geometry: GeometryOptions::default(),
            sparse: SparseConfig::default(),
            dense: DenseConfig::default(),
            megasam: MegasamSettings::default(),
            enhance: EnhanceConfig::default(),
            init: InitSettings::of(profile),
            train: TrainSettings::of(profile),
            limit: LimitConfig::default(),
            checkpoint: CheckpointConfig::default(),
            preview: PreviewConfig::default(),
            viewer: ViewerConfig::default(),
        }
    }

    /// Minutes on a plain CPU.
    #[must_use]
    pub fn fast() -> Self {
        Self::of(Profile::Fast)
    }

    /// The paper to the letter, with documented choices where it is silent.
    #[must_use]
    pub fn faithful() -> Self {
        Self::of(Profile::Faithful)
    }

    /// What the initialisation is given.
    #[must_use]
    pub fn init_config(&self) -> InitConfig {
        self.init.config(self.profile)
    }

    /// What the trainer is given.
    #[must_use]
    pub fn train_config(&self) -> TrainConfig {
        self.train.config(self.profile)
    }

    /// Refuses values that no run can use.
    pub(crate) fn check(&self) -> Result<(), Error> {
        self.init_config().check()?;
        self.train.check()?;
        Ok(self.train_config().check()?)
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
    use super::{Layers, Profile, Settings};
    use m4_train::TrainConfig;
    use m4_train::init::InitConfig;
    use toml::{Table, Value};

    #[test]
    fn every_profile_survives_toml() {
        for settings in [Settings::fast(), Settings::faithful()] {
            let text = settings.to_toml().unwrap();
            assert_eq!(toml::from_str::<Settings>(&text).unwrap(), settings);
        }
    }

    #[test]
    fn profiles_set_stage_settings() {
        assert_eq!(Settings::default(), Settings::fast());
        let given = |settings: Settings| (settings.init_config(), settings.train_config());
        assert_eq!(given(Settings::fast()), (InitConfig::fast(), TrainConfig::fast()));
        assert_eq!(given(Settings::faithful()), (InitConfig::faithful(), TrainConfig::faithful()));
        Settings::fast().check().unwrap();
        Settings::faithful().check().unwrap();
        let mut endless = Settings::fast();
        endless.train.budget_s = f64::NAN;
        assert!(endless.check().unwrap_err().to_string().contains("`budget_s` is NaN"));
    }

    #[test]
    fn settings_of_every_stage_can_be_changed() {
        let sets = [
            "train.iterations=7",
            "init.keyframe_gaps=0.5",
            "video.max_frames=12",
            "sparse.fov_deg=60",
            "dense.working_side_px=200",
            "preview.swing.side_deg=5",
            "checkpoint.every_s=1",
        ];
        let layers = sets.iter().try_fold(Layers::default(), |layers, set| layers.set(set)).unwrap();
        let settings = layers.over(&Settings::fast()).unwrap();
        assert_eq!((settings.train.iterations, settings.video.max_frames), (7, Some(12)));
        assert_eq!((settings.sparse.fov_deg, settings.dense.working_side_px), (Some(60.0), 200));
    }

    /// Every key of `table`, and a value that is another one.
    fn changes(path: &str, table: &Table) -> Vec<(String, Value)> {
        let other = |(name, value): (&String, &Value)| {
            let key = format!("{path}.{name}");
            match value {
                Value::Table(inner) => changes(&key, inner),
                Value::Integer(n) => vec![(key, Value::Integer(n + 1))],
                Value::Float(x) => vec![(key, Value::Float(0.5 * x + 0.001))],
                Value::Boolean(b) => vec![(key, Value::Boolean(!b))],
                Value::Array(values) => vec![(key, Value::Array(vec![Value::Float(0.5); values.len()]))],
                other => panic!("{key} = {other} has no other value here"),
            }
        };
        table.iter().flat_map(other).collect()
    }

    #[test]
    fn every_key_of_splats_and_training_reaches_its_stage() {
        for profile in [Profile::Fast, Profile::Faithful] {
            let base = Settings::of(profile);
            let table: Table = base.to_toml().unwrap().parse().unwrap();
            for section in ["init", "train"] {
                for (key, value) in changes(section, table[section].as_table().unwrap()) {
                    let layers = Layers::default().set(&format!("{key}={value}")).unwrap();
                    let changed = layers.over(&base).unwrap();
                    let same =
                        (changed.init_config(), changed.train_config()) == (base.init_config(), base.train_config());
                    assert_eq!(same, key == "train.budget_s", "{key} of {profile:?}");
                }
            }
        }
    }
}
