//! Data sets: their scenes, the layout of their folders, and where to download them.

use super::MissingScene;
use m4_io::dataset::{SourceFormat, davis, detect};
use minute4d::Refusal;
use minute4d::settings::{Profile, Settings, UnknownName, by_name};
use minute4d_eval::Protocol;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// A data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Suite {
    /// The iPhone scenes of DyCheck.
    Dycheck,
    /// NVIDIA Dynamic Scenes in the layout of RoDynRF's bundle.
    Nvidia,
    /// DAVIS 2017.
    Davis,
}

/// What is known of a data set.
pub(super) struct Facts {
    name: &'static str,
    pub title: &'static str,
    /// Of the published tables; those of the paper's first table come first.
    scenes: &'static [&'static str],
    /// Folders in which scenes lie.
    below: &'static [&'static str],
    protocols: &'static [Protocol],
    /// May be asked for, and are not made otherwise.
    more_protocols: &'static [Protocol],
    paper: Paper,
    /// Where people get it.
    pub source: &'static str,
}

/// The settings that the paper has for a data set: steps (docs/spec/optimiser.md 3), frames between
/// two searches for new objects (B, docs/spec/front-end.md 2.4) and between two frames in which
/// points start (docs/spec/front-end.md 3).
struct Paper {
    iterations: usize,
    instance_interval: usize,
    track_stride: usize,
    /// Of Instant4D, whose setup the paper follows (docs/spec/optimiser.md 2.2).
    voxel_px: f32,
}

/// Probability of motion above which a pixel is dynamic, in all data sets of the paper (tau,
/// docs/spec/front-end.md 2.4).
const MOTION_THRESHOLD: f32 = 0.7;

const DYCHECK: Facts = Facts {
    name: "dycheck",
    title: "DyCheck (iPhone)",
    scenes: &[
        "apple",
        "block",
        "paper-windmill",
        "spin",
        "teddy",
        "space-out",
        "wheel",
    ],
    below: &["", "iphone", "dycheck", "dycheck/iphone"],
    protocols: &[Protocol::Instant4d, Protocol::Dycheck],
    more_protocols: &[Protocol::Rodygs, Protocol::Holdout],
    paper: Paper {
        iterations: 5000,
        instance_interval: 50,
        track_stride: 10,
        voxel_px: 6.0,
    },
    source: "The scenes are on the project page of DyCheck (Gao et al., NeurIPS 2022: the README of KAIR-BAIR/dycheck, docs/DATASETS.md), a \
             zip file each; unpack them side by side",
};
const NVIDIA: Facts = Facts {
    name: "nvidia",
    title: "NVIDIA Dynamic Scenes",
    scenes: &[
        "Balloon1",
        "Balloon2",
        "Jumping",
        "Playground",
        "Skating",
        "Truck",
        "Umbrella",
    ],
    below: &["", "nvidia", "Nvidia", "NVIDIA"],
    protocols: &[Protocol::Nvidia],
    more_protocols: &[],
    paper: Paper {
        iterations: 1500,
        instance_interval: 2,
        track_stride: 1,
        voxel_px: 4.0,
    },
    source: "The scenes with poses and masks, and the images that results are compared with (gt/v000_tTTT.png), are bundles that the \
             README of facebookresearch/robust-dynrf links; unpack them side by side",
};
const DAVIS: Facts = Facts {
    name: "davis",
    title: "DAVIS 2017",
    scenes: &["breakdance-flare"],
    below: &[
        "JPEGImages/480p",
        "DAVIS/JPEGImages/480p",
        "JPEGImages/Full-Resolution",
        "DAVIS/JPEGImages/Full-Resolution",
    ],
    protocols: &[Protocol::Davis],
    more_protocols: &[Protocol::Holdout],
    paper: Paper {
        iterations: 5000,
        instance_interval: 10,
        track_stride: 10,
        voxel_px: 2.0,
    },
    source: "DAVIS 2017 (TrainVal, 480p) is on davischallenge.org, a zip file; give the folder that holds JPEGImages, and other clips of it with \
             --scenes",
};

/// A scene that is there.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FoundScene {
    pub name: String,
    pub path: PathBuf,
}

impl Suite {
    /// All variants.
    pub const ALL: [Self; 3] = [Self::Dycheck, Self::Nvidia, Self::Davis];

    pub(super) fn facts(self) -> &'static Facts {
        match self {
            Self::Dycheck => &DYCHECK,
            Self::Nvidia => &NVIDIA,
            Self::Davis => &DAVIS,
        }
    }

    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        self.facts().name
    }

    /// The built-in settings for the data set: those of the profile, and for [`Profile::Faithful`]
    /// what the paper has for this data set.
    pub fn settings(self, profile: Profile) -> Settings {
        let (mut settings, paper) = (Settings::of(profile), &self.facts().paper);
        if profile == Profile::Faithful {
            settings.train.iterations = paper.iterations;
            settings.enhance.masks.every_frames = paper.instance_interval;
            settings.enhance.masks.tau = MOTION_THRESHOLD;
            settings.enhance.tapip3d.every = paper.track_stride;
            settings.init.voxel_px = Some(paper.voxel_px);
        }
        settings
    }

    /// The scenes over which published numbers of a protocol are means.
    pub fn scenes(self, protocol: Protocol) -> &'static [&'static str] {
        let all = self.facts().scenes;
        match (self, protocol) {
            // the first table of the paper has five
            (Self::Dycheck, Protocol::Instant4d | Protocol::Rodygs | Protocol::Holdout) => {
                &all[..5]
            }
            _ => all,
        }
    }

    /// The protocols to follow: those asked for, or its own.
    pub(super) fn protocols_of(self, asked: &[Protocol]) -> Result<Vec<Protocol>, Refusal> {
        let facts = self.facts();
        if asked.is_empty() {
            return Ok(facts.protocols.to_vec());
        }
        let protocols = [facts.protocols, facts.more_protocols].concat();
        if let Some(&protocol) = asked.iter().find(|p| !protocols.contains(p)) {
            let names = protocols
                .iter()
                .map(|p| p.name())
                .collect::<Vec<_>>()
                .join(", ");
            return Err(Refusal::usage(format!(
                "{self} is not scored by the protocol {protocol}; its protocols are {names}"
            )));
        }
        Ok(asked.to_vec())
    }

    /// The scenes in a folder, of those asked for or all of them, and what the others lack.
    pub(super) fn find(
        self,
        data: &Path,
        asked: &[String],
    ) -> (Vec<FoundScene>, Vec<MissingScene>) {
        let all: Vec<String> = self
            .facts()
            .scenes
            .iter()
            .map(|s| (*s).to_owned())
            .collect();
        let wanted = if asked.is_empty() { &all } else { asked };
        let (mut scenes, mut missing) = (Vec::new(), Vec::new());
        for name in wanted {
            match self.locate(data, name) {
                Ok(path) => scenes.push(FoundScene {
                    name: name.clone(),
                    path,
                }),
                Err(why) => missing.push(MissingScene {
                    scene: name.clone(),
                    why,
                }),
            }
        }
        (scenes, missing)
    }

    fn locate(self, data: &Path, name: &str) -> Result<PathBuf, String> {
        // a name becomes part of a path
        if name.is_empty() || name.contains(['/', '\\']) || name.contains("..") {
            return Err("is not the name of a scene".to_owned());
        }
        let is_scene = |path: &Path| match self {
            Self::Dycheck => detect(path) == Some(SourceFormat::Dycheck),
            Self::Nvidia => detect(path) == Some(SourceFormat::Nvidia),
            Self::Davis => davis::detect(path),
        };
        let mut candidate = None;
        for below in self.facts().below {
            let path = data.join(below).join(name);
            if path.is_dir() {
                if is_scene(&path) {
                    return Ok(path);
                }
                candidate.get_or_insert(path);
            }
        }
        Err(match candidate {
            Some(path) => format!("{} is not in the layout of the data set", path.display()),
            None => "is not there".to_owned(),
        })
    }
}

impl fmt::Display for Suite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Suite {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        by_name("data set", text, &Self::ALL, Self::name)
    }
}

#[cfg(test)]
mod tests {
    use super::Suite;
    use minute4d::settings::{Profile, Settings};
    use minute4d_eval::Protocol;

    #[test]
    fn the_faithful_settings_are_those_of_the_paper_for_the_data_set() {
        let of = |suite: Suite| {
            let s = suite.settings(Profile::Faithful);
            (
                s.enhance.masks.every_frames,
                s.enhance.tapip3d.every,
                s.train.iterations,
                s.init.voxel_px,
                s.enhance.masks.tau,
            )
        };
        assert_eq!(
            Suite::ALL.map(of),
            [
                (50, 10, 5000, Some(6.0), 0.7),
                (2, 1, 1500, Some(4.0), 0.7),
                (10, 10, 5000, Some(2.0), 0.7)
            ],
            "DyCheck, NVIDIA, DAVIS"
        );
        assert!(
            Suite::ALL
                .iter()
                .all(|suite| suite.settings(Profile::Fast) == Settings::fast())
        );
    }

    #[test]
    fn published_means_are_over_their_own_scenes() {
        assert_eq!(Suite::Dycheck.scenes(Protocol::Instant4d).len(), 5);
        assert_eq!(Suite::Dycheck.scenes(Protocol::Dycheck).len(), 7);
        assert!(
            !Suite::Dycheck
                .scenes(Protocol::Instant4d)
                .contains(&"wheel")
        );
        for suite in Suite::ALL {
            assert_eq!(suite.name().parse(), Ok(suite));
            assert!(!suite.protocols_of(&[]).unwrap().is_empty());
        }
        assert!(Suite::Nvidia.protocols_of(&[Protocol::Dycheck]).is_err());
    }

    #[test]
    fn missing_scenes_are_listed_with_the_reason() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(dir.path().join("iphone/apple")).unwrap();
        let (scenes, missing) = Suite::Dycheck.find(dir.path(), &[]);
        assert!(scenes.is_empty() && missing.len() == 7);
        assert!(missing[0].why.contains("not in the layout") && missing[1].why == "is not there");
        let (_, missing) = Suite::Dycheck.find(dir.path(), &["../x".to_owned()]);
        assert_eq!(missing[0].why, "is not the name of a scene");
    }
}
