//! The rows of an ablation and its results.

use crate::bench::aligned;
use crate::settings::Enhancement;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// One row.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RowReport {
    /// The name of the weights.
    pub row: Row,
    /// Why it was not made, where it was not: then everything else is absent.
    pub skipped: Option<String>,
    /// Mean PSNR of the held-out views, dB.
    pub psnr_db: Option<f64>,
    /// The same inside the masks of dynamic regions, where there are any.
    pub moving_psnr_db: Option<f64>,
    /// Mean SSIM of the held-out views.
    pub ssim: Option<f64>,
    /// The same inside the masks.
    pub moving_ssim: Option<f64>,
    /// Wall-clock seconds of the geometry that it stands on; absent where the input brought it.
    pub geometry_s: Option<f64>,
    /// Wall-clock seconds of the first splats and their optimisation.
    pub train_s: Option<f64>,
    /// Most memory that its process held, bytes; only where the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// Splats of the scene.
    pub splats: Option<usize>,
    /// Steps of the optimisation.
    pub iterations: Option<usize>,
}

impl RowReport {
    pub(super) fn skipped(row: Row, why: String) -> Self {
        Self {
            row,
            skipped: Some(why),
            psnr_db: None,
            moving_psnr_db: None,
            ssim: None,
            moving_ssim: None,
            geometry_s: None,
            train_s: None,
            peak_memory_bytes: None,
            splats: None,
            iterations: None,
        }
    }
}

/// `ablation.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AblationReport {
    /// `minute4d-ablation`.
    pub format: String,
    /// Of the format.
    pub version: u32,
    /// Release of the program.
    pub minute4d: String,
    /// Day, UTC, `YYYY-MM-DD`.
    pub date: String,
    /// What the scenes were made of.
    pub input: PathBuf,
    /// The capture whose held-out views were scored.
    pub data: PathBuf,
    /// Threads; the scenes do not depend on them.
    pub threads: usize,
    /// The rows.
    pub rows: Vec<RowReport>,
    /// An image of what tracking brings, where both rows are there.
    pub image: Option<PathBuf>,
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

impl AblationReport {
    /// One Markdown row each, with the difference to everything in brackets.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let head =
            ["", "PSNR dB", "SSIM", "PSNR dB moving", "SSIM moving", "splats", "geometry s", "train s", "peak MB"];
        let full = self.rows.iter().find(|row| row.row == Row::Full);
        let with_difference = |row: &RowReport, of: &dyn Fn(&RowReport) -> Option<f64>, digits: usize| {
            let value = of(row);
            match (value, full.and_then(of)) {
                (Some(here), Some(there)) if row.row != Row::Full => {
                    format!("{here:.digits$} ({:+.digits$})", here - there)
                }
                _ => number(value, digits),
            }
        };
        let mut table = vec![head.map(str::to_owned).to_vec()];
        table.extend(self.rows.iter().map(|row| {
            vec![
                row.row.title().to_owned(),
                with_difference(row, &|r| r.psnr_db, 2),
                with_difference(row, &|r| r.ssim, 4),
                with_difference(row, &|r| r.moving_psnr_db, 2),
                with_difference(row, &|r| r.moving_ssim, 4),
                row.splats.map_or_else(|| "-".to_owned(), |n| n.to_string()),
                number(row.geometry_s, 0),
                number(row.train_s, 0),
                number(row.peak_memory_bytes.map(|bytes| bytes as f64 / 1e6), 0),
            ]
        }));
        let mut out = aligned(&table);
        for row in &self.rows {
            if let Some(why) = &row.skipped {
                out.push_str(&format!("\n{}: not made, {why}\n", row.row.title()));
            }
        }
        out
    }
}

/// One row: everything, or everything but a part (paper, table 3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Row {
    /// Everything. Always there: the others are compared with it.
    Full,
    /// Masks are what motion and colours say.
    NoSeg,
    /// No points are followed or carried from one frame to another.
    NoTrack,
    /// Splats are neither added nor pruned.
    NoDensity,
}

impl Row {
    /// In the order of tables.
    pub const ALL: [Self; 4] = [Self::Full, Self::NoSeg, Self::NoTrack, Self::NoDensity];

    /// As options and folders call it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::NoSeg => "no-seg",
            Self::NoTrack => "no-track",
            Self::NoDensity => "no-density",
        }
    }

    /// Returns the name in tables.
    #[must_use]
    pub fn title(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::NoSeg => "without segmentation",
            Self::NoTrack => "without tracking",
            Self::NoDensity => "without density control",
        }
    }

    /// What it goes without.
    #[must_use]
    pub fn without(self) -> Option<Enhancement> {
        match self {
            Self::Full => None,
            Self::NoSeg => Some(Enhancement::Segmentation),
            Self::NoTrack => Some(Enhancement::Tracking),
            Self::NoDensity => Some(Enhancement::Density),
        }
    }
}

/// No row of that name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no row {0:?}; the rows are full, no-seg, no-track and no-density")]
pub struct UnknownRow(pub String);

impl std::str::FromStr for Row {
    type Err = UnknownRow;

    fn from_str(text: &str) -> Result<Self, UnknownRow> {
        let found = Self::ALL.into_iter().find(|row| row.name() == text);
        found.ok_or_else(|| UnknownRow(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::{AblationReport, Row, RowReport};

    #[test]
    fn differences_are_to_the_full_row() {
        let row =
            |row, psnr| RowReport { skipped: None, psnr_db: Some(psnr), ..RowReport::skipped(row, String::new()) };
        let report = AblationReport {
            format: String::new(),
            version: 1,
            minute4d: String::new(),
            date: String::new(),
            input: "clip".into(),
            data: "clip".into(),
            threads: 2,
            rows: vec![
                row(Row::Full, 25.0),
                row(Row::NoTrack, 24.25),
                RowReport::skipped(Row::NoSeg, "there is nothing to segment".into()),
            ],
            image: None,
        };
        let text = report.to_markdown();
        assert!(text.contains("24.25 (-0.75)") && text.contains("25.00"), "{text}");
        assert!(text.contains("without segmentation: not made, there is nothing to segment"), "{text}");
    }
}
