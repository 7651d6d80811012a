//! Which files there are, and what they do not say.

use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The three sorts of files of MegaSaM.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    /// `NAME_droid.npz`: poses of the tracker, depth as floats.
    Droid,
    /// `NAME_sgd_cvd_hr.npz`: depth as halves.
    Cvd,
    /// The folder `reconstructions/NAME`.
    Reconstruction,
}

/// The layout of what is at `path`, by its name and, for a folder, by the files in it; `None` if it is none of them.
#[must_use]
pub fn detect(path: &Path) -> Option<Layout> {
    if path.is_dir() {
        let all = ["images.npy", "poses.npy", "intrinsics.npy"];
        let here = all.iter().all(|name| path.join(name).is_file());
        return here.then_some(Layout::Reconstruction);
    }
    let name = path.file_name()?.to_str()?.to_ascii_lowercase();
    let stem = name.strip_suffix(".npz")?;
    Some(if stem.contains("cvd") {
        Layout::Cvd
    } else {
        Layout::Droid
    })
}

/// What the files of MegaSaM do not say, and how much memory they may take.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MegasamOptions {
    /// Frames a second, above 0; `None` takes 30 and says so.
    pub fps: Option<f64>,
    /// A pixel moves where its probability of motion, `1 - motion_prob`, is above this. 0.7 is the paper's tau_motion.
    pub tau_motion: f64,
    /// The file of `motion_prob`; `None` looks beside the file that is read, and where MegaSaM writes it.
    pub motion: Option<PathBuf>,
    /// Bytes that the decoded frames (8 a pixel) may take before reading is refused. Default 4 GiB, as of a capture.
    pub max_memory_bytes: u64,
}

impl Default for MegasamOptions {
    fn default() -> Self {
        Self {
            fps: None,
            tau_motion: 0.7,
            motion: None,
            max_memory_bytes: 4 << 30,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Layout, detect};
    use std::path::Path;

    #[test]
    fn names_and_folders_tell_the_layout() {
        assert_eq!(detect(Path::new("a/dog_droid.npz")), Some(Layout::Droid));
        assert_eq!(detect(Path::new("a/dog_sgd_cvd_hr.NPZ")), Some(Layout::Cvd));
        assert_eq!(detect(Path::new("a/dog.npz")), Some(Layout::Droid));
        assert_eq!(detect(Path::new("a/dog.npy")), None);
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(detect(dir.path()), None);
        for name in ["images.npy", "poses.npy", "intrinsics.npy"] {
            std::fs::write(dir.path().join(name), b"").unwrap();
        }
        assert_eq!(detect(dir.path()), Some(Layout::Reconstruction));
    }
}
