//! The built-in settings that a run starts from.

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
