//! Evaluation protocols: everything that must agree before two scores can be compared.
//!
//! ```text
//! name --Rules--> frames held out, resolution, masks, metrics, LPIPS, how test poses are treated
//! ```
//!
//! The rules are plain data ([`Rules`], `rules.rs`), from the programs that made the published numbers. Two tasks are distinguished
//! ([`Task`]): images of the *training* camera at moments that were held out, which is the table of the Minute4D and Instant4D
//! papers, and images of *other* cameras, which is DyCheck's own test. The same scenes score 7 dB apart in the two.

mod frames;
mod rules;

pub use frames::FrameRule;
pub use rules::{LpipsRule, RefineRule, Rules, StartPose};

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Task of a protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Task {
    /// Held-out frames of the training camera: interpolation on its own path.
    HeldOutFrames,
    /// Views of cameras that the training video never had.
    NovelViews,
}

impl Task {
    /// Title in tables.
    #[must_use]
    pub fn title(self) -> &'static str {
        match self {
            Self::HeldOutFrames => "held-out frames of the training camera",
            Self::NovelViews => "views of other cameras",
        }
    }
}

/// A protocol by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Protocol {
    /// Every eighth frame of the training video is held out, as loaders of LLFF scenes do it.
    Holdout,
    /// Instant4D on DyCheck: 85 % of the frames of camera 0 train, evenly spaced. The first table of the Minute4D paper compares
    /// with numbers that were made so.
    Instant4d,
    /// RoDyGS on DyCheck: frame `i` of camera 0 is held out where `(i + 4) mod 8 = 0`.
    Rodygs,
    /// DyCheck's own: views of other cameras, scored where the training video saw the place.
    Dycheck,
    /// NVIDIA Dynamic Scenes as RoDynRF takes them: 12 training images, views of camera 0 at their moments.
    Nvidia,
    /// Every fourth frame of a clip of DAVIS is held out.
    Davis,
}

impl Protocol {
    /// All variants.
    pub const ALL: [Self; 6] = [
        Self::Holdout,
        Self::Instant4d,
        Self::Rodygs,
        Self::Dycheck,
        Self::Nvidia,
        Self::Davis,
    ];

    /// Returns the name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.rules().name
    }

    /// Rules of the protocol.
    #[must_use]
    pub fn rules(self) -> &'static Rules {
        rules::of(self)
    }
}

impl fmt::Display for Protocol {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// No protocol of that name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no protocol {0:?}; the protocols are holdout, instant4d, rodygs, dycheck, nvidia and davis")]
pub struct UnknownProtocol(pub String);

impl FromStr for Protocol {
    type Err = UnknownProtocol;

    fn from_str(text: &str) -> Result<Self, UnknownProtocol> {
        let found = Self::ALL.into_iter().find(|p| p.name() == text);
        found.ok_or_else(|| UnknownProtocol(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::{FrameRule, Protocol, Task};

    #[test]
    fn names_are_read_back_and_tasks_follow_from_the_frames() {
        for protocol in Protocol::ALL {
            assert_eq!(protocol.name().parse(), Ok(protocol));
            assert_eq!(
                serde_json::to_string(&protocol).unwrap(),
                format!("{:?}", protocol.name())
            );
            let rules = protocol.rules();
            assert_eq!(rules.protocol, protocol);
            let novel = rules.frames == FrameRule::TestSplit;
            assert_eq!(novel, rules.task == Task::NovelViews, "{protocol}");
        }
        assert!("psnr".parse::<Protocol>().is_err());
    }
}
