//! What an export says of its file.

use super::{Format, Time};
use m4_core::Scene;
use m4_io::scene::{Loss, Written};
use serde::Serialize;
use std::fmt;
use std::path::PathBuf;

/// What was exported, how large it is and what it lost.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ExportReport {
    /// The format.
    pub format: Format,
    /// The file; for a sequence the folder.
    pub path: PathBuf,
    /// Size of all files.
    pub bytes: u64,
    /// Splats in the file; in a sequence the sum over its files.
    pub splats: usize,
    /// Bytes a splat: of the scene, or, for one instant, of those that it sees; `None` for
    /// captures.
    pub bytes_per_splat: Option<f64>,
    /// Bytes a second of the clip, where its length is known and the file has time.
    pub bytes_per_s: Option<f64>,
    /// The moments that are in the file, frames; empty where all are.
    pub moments: Vec<f64>,
    /// Wall-clock seconds of encoding, checking and writing.
    pub encode_s: f64,
    /// What the file holds differently.
    pub losses: Losses,
}

/// What a file holds differently, by sort.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Losses {
    /// Evaluated at fixed instants.
    pub baked: Vec<String>,
    /// Dropped properties.
    pub dropped: Vec<String>,
    /// Stored with fewer digits.
    pub quantised: Vec<String>,
}

impl Losses {
    /// Sorts losses by kind.
    pub fn of(losses: Vec<Loss>) -> Self {
        let mut all = Self::default();
        for loss in losses {
            match loss {
                Loss::Baked(what) => all.baked.push(what),
                Loss::Dropped(what) => all.dropped.push(what),
                Loss::Quantised(what) => all.quantised.push(what),
            }
        }
        all
    }
}

impl ExportReport {
    pub(super) fn new(
        scene: &Scene,
        format: Format,
        moments: &[f64],
        written: Written,
        encode_s: f64,
    ) -> Self {
        let per = |whole: f64| (whole > 0.0).then(|| written.bytes as f64 / whole);
        let splats = match format.time() {
            Time::Instant => written.splats,
            _ => scene.splats.n(),
        };
        let has_time = matches!(format.time(), Time::Clip | Time::Sequence);
        Self {
            format,
            bytes: written.bytes,
            splats: written.splats,
            bytes_per_splat: per(splats as f64),
            bytes_per_s: scene.duration_s.filter(|_| has_time).and_then(per),
            moments: moments.to_vec(),
            encode_s,
            losses: Losses::of(written.losses),
            path: written.path,
        }
    }
}

impl fmt::Display for ExportReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {:.2} MB",
            self.format.name(),
            self.bytes as f64 / 1e6
        )?;
        if let Some(bytes) = self.bytes_per_splat {
            write!(f, ", {bytes:.1} bytes per splat")?;
        }
        if let Some(bytes) = self.bytes_per_s {
            write!(f, ", {:.2} MB per second of the clip", bytes / 1e6)?;
        }
        write!(f, ", written in {:.1} s", self.encode_s)?;
        let losses = &self.losses;
        for (sort, all) in [
            ("baked", &losses.baked),
            ("dropped", &losses.dropped),
            ("quantised", &losses.quantised),
        ] {
            for what in all {
                write!(f, "\n{sort}: {what}")?;
            }
        }
        Ok(())
    }
}
