//! Every setting of the pipeline: profiles, presets, switches, and layers over them.

mod frontend;
mod geometry;
mod layers;
mod output;
#[cfg(test)]
mod page_tests;
mod ranges;
mod train;

pub use frontend::{Frontend, FrontendPart, UnknownFrontend};
pub use geometry::{EnhanceConfig, GeometryOptions, Segmenter, Tapip3dConfig, Tracker};
pub use layers::{Layers, SettingsError};
pub use output::{CheckpointConfig, LimitConfig, PreviewConfig, ViewerConfig};
pub use train::{
    ColourFitSettings, DensityRule, DensitySettings, InitSettings, LossSettings,
    RefinementSettings, TrainSettings,
};

use m4_geometry::classical::dense::DenseConfig;
use m4_geometry::classical::sparse::SparseConfig;
use m4_geometry::megasam::MegasamSettings;
use m4_io::capture::CaptureOptions;
use m4_io::video::VideoOptions;
use m4_train::TrainConfig;
use m4_train::init::{InitConfig, LEAST_STATIC};
use serde::{Deserialize, Serialize};

/// The built-in settings that a run starts from. It also decides everything about the first splats
/// and the training that has no key of its own.
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
            init.max_static = Some(init.max_static.unwrap_or(LEAST_STATIC) / 3);
            init.max_dynamic /= 3;
        }
    }
}

/// A part of the method that works without: what ablations switch off (paper, table 3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Enhancement {
    /// Masks by a segmentation network.
    Segmentation,
    /// Points followed through the clip: parts that a frame hides are filled from others, and first
    /// velocities.
    Tracking,
    /// Density control: splats added and pruned.
    Density,
    /// The choice of these splats by the errors of frames; without it gradients decide, as in 3DGS.
    LossGuided,
}

/// Every setting of every stage; what `--print-config` shows and `--set` changes.
/// `docs/settings.md` lists the keys.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// The built-in settings that the others start from; it decides everything that has no key. Set
    /// it with [`Self::of`], not alone.
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

impl Default for Settings {
    fn default() -> Self {
        Self::fast()
    }
}

impl Settings {
    /// The built-in settings of a profile.
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
    pub fn fast() -> Self {
        Self::of(Profile::Fast)
    }

    /// The paper to the letter, with documented choices where it is silent.
    pub fn faithful() -> Self {
        Self::of(Profile::Faithful)
    }

    /// What the initialisation is given.
    pub fn init_config(&self) -> InitConfig {
        self.init.config(self.profile)
    }

    /// What the trainer is given.
    pub fn train_config(&self) -> TrainConfig {
        self.train.config(self.profile)
    }

    /// Refuses values that no run can use.
    pub fn check(&self) -> Result<(), SettingsError> {
        layers::in_range(&layers::table(self)?, "the settings")?;
        self.init_config().check()?;
        Ok(self.train_config().check()?)
    }

    /// Uses one seed for every random number.
    pub fn set_seed(&mut self, seed: u64) {
        self.train.seed = seed;
        self.sparse.seed = seed;
    }

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
            Enhancement::LossGuided => self.train.density.rule = DensityRule::Gradient,
        }
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

/// A word on the command line that names none of the known values.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no {what} {word:?}; the {what}s are {known}")]
pub struct UnknownName {
    what: &'static str,
    word: String,
    known: String,
}

/// The one of `all` (at least two) whose name is `word`.
pub fn by_name<T: Copy>(
    what: &'static str,
    word: &str,
    all: &[T],
    name: impl Fn(T) -> &'static str,
) -> Result<T, UnknownName> {
    all.iter()
        .copied()
        .find(|&value| name(value) == word)
        .ok_or_else(|| {
            let names: Vec<&str> = all.iter().map(|&value| name(value)).collect();
            let (last, first) = names.split_last().unwrap_or((&"", &[]));
            UnknownName {
                what,
                word: word.to_owned(),
                known: format!("{} and {last}", first.join(", ")),
            }
        })
}

/// Some settings as TOML: what keys of stages are made of.
pub fn part_to_toml(part: &impl Serialize) -> Result<String, SettingsError> {
    toml::to_string_pretty(part).map_err(|e| SettingsError::Internal {
        reason: e.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::{Enhancement, Layers, Preset, Profile, Settings};
    use m4_train::TrainConfig;
    use m4_train::init::{InitConfig, LEAST_STATIC};
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
        let configs = |settings: Settings| (settings.init_config(), settings.train_config());
        assert_eq!(
            configs(Settings::fast()),
            (InitConfig::fast(), TrainConfig::fast())
        );
        assert_eq!(
            configs(Settings::faithful()),
            (InitConfig::faithful(), TrainConfig::faithful())
        );
        Settings::fast().check().unwrap();
        Settings::faithful().check().unwrap();
        let mut endless = Settings::fast();
        endless.train.budget_s = f64::NAN;
        assert!(
            endless
                .check()
                .unwrap_err()
                .to_string()
                .contains("train.budget_s = NaN")
        );
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
                Value::Array(values) => {
                    vec![(key, Value::Array(vec![Value::Float(0.5); values.len()]))]
                }
                Value::String(_) => vec![(key, Value::String("literal".to_owned()))],
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
                    let same = (changed.init_config(), changed.train_config())
                        == (base.init_config(), base.train_config());
                    assert_eq!(same, key == "train.budget_s", "{key} of {profile:?}");
                }
            }
        }
    }

    #[test]
    fn a_preset_sets_its_time_and_draft_a_third_of_the_splats_and_nothing_else() {
        let fast = Settings::fast();
        for (preset, budget_s, share) in [(Preset::Draft, 10.0, 3), (Preset::Default, 60.0, 1)] {
            let (mut settings, mut want) = (fast.clone(), fast.clone());
            preset.apply(&mut settings);
            want.train.budget_s = budget_s;
            want.init.max_static = (share > 1).then_some(LEAST_STATIC / share);
            want.init.max_dynamic = fast.init.max_dynamic / share;
            assert_eq!(settings, want, "{preset:?}");
            settings.check().unwrap();
        }
        assert_eq!(Preset::default(), Preset::Default);
    }

    #[test]
    fn each_part_changes_settings_of_its_own() {
        let parts = [
            Enhancement::Segmentation,
            Enhancement::Tracking,
            Enhancement::Density,
            Enhancement::LossGuided,
        ];
        let full = Settings::faithful();
        let without = |part| {
            let mut settings = full.clone();
            settings.switch_off(part);
            settings
        };
        for part in parts {
            assert_ne!(without(part), full, "{part:?}");
        }
        let density = without(Enhancement::Density);
        assert_eq!(
            (density.geometry, density.init),
            (full.geometry.clone(), full.init.clone())
        );
        let tracking = without(Enhancement::Tracking);
        assert_eq!(
            (tracking.train, tracking.geometry.segmenter),
            (full.train, full.geometry.segmenter)
        );
    }
}
