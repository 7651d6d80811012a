//! Published results, each with its task and source; results of different tasks never share a
//! table. `docs/results.md` has them all.
//!
//! Peers' rows were found by search (abstracts, pages, tables), not all read at the source;
//! `not identified`: whose table it was is not known. Times are those of the GPU that their authors
//! used.

use minute4d_eval::Protocol;
use serde::Serialize;

/// A row of a published table.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Published {
    pub(super) method: &'static str,
    /// What its poses are: `slam` (estimated with the held-out frames), `estimated`, `given`;
    /// absent where that was not seen stated.
    pub(super) poses: Option<&'static str>,
    /// Mean of the score that stands for the protocol, dB.
    pub(super) psnr_db: f64,
    /// Mean SSIM, of the kind of the protocol.
    pub(super) ssim: Option<f64>,
    /// Mean LPIPS with AlexNet.
    pub(super) lpips: Option<f64>,
    pub(super) training: Option<&'static str>,
    pub(super) frames_per_s: Option<f64>,
    /// Scenes of the mean, where that was seen stated.
    pub(super) scenes: Option<usize>,
    /// Whose paper has the row.
    pub(super) source: &'static str,
}

/// A table of rows with a dash where nothing was seen stated.
macro_rules! published {
    ($($method:literal, $poses:tt, $psnr_db:literal, $ssim:tt, $lpips:tt, $training:tt, $frames_per_s:tt, $scenes:tt, $source:literal;)*) => {
        &[$(Published {
            method: $method,
            poses: stated!($poses),
            psnr_db: $psnr_db,
            ssim: stated!($ssim),
            lpips: stated!($lpips),
            training: stated!($training),
            frames_per_s: stated!($frames_per_s),
            scenes: stated!($scenes),
            source: $source,
        }),*]
    };
}

macro_rules! stated {
    (-) => {
        None
    };
    ($value:literal) => {
        Some($value)
    };
}

const HELD_OUT: &[Published] = published![
    // method, poses, PSNR, SSIM, LPIPS, training, frames/s, scenes, source
    "Minute4D",       "slam",      25.77, 0.717, -, "29 s",      -, 5, "Minute4D's paper, tables 1 and 3";
    "Instant4D",      "slam",      24.52, -,     -, "0.12 h",    -, 5, "Minute4D's paper, table 1";
    "Instant4D lite", "slam",      23.02, -,     -, "0.03 h",    -, 5, "Minute4D's paper, table 1";
    "Deform3D",       "given",     22.63, -,     -, -,           -, 5, "Minute4D's paper, table 1";
    "4D-GS",          "given",     21.64, -,     -, "1.2 h",     -, 5, "Minute4D's paper, table 1";
    "D-NeRF",         "given",     21.50, -,     -, "over 24 h", -, 5, "Minute4D's paper, table 1";
    "RoDyGS",         "estimated", 17.37, -,     -, "1.0 h",     -, 5, "Minute4D's paper, table 1";
    "RoDynRF",        "given",     16.80, -,     -, "22 h",      -, 5, "Minute4D's paper, table 1";
    "RoDynRF",        "estimated", 14.90, -,     -, "22 h",      -, 5, "Minute4D's paper, table 1";
];

const NOVEL_DYCHECK: &[Published] = published![
    // method, poses, PSNR, SSIM, LPIPS, training, frames/s, scenes, source
    "SE(3) B-spline",   -,           20.17, 0.729, 0.274, "30 min",        45.0,  5, "its paper, CVPR 2026";
    "MoSca",            -,           19.33, -,     -,     -,               -,     5, "SE(3) B-spline's paper";
    "MoSca",            "given",     19.32, 0.706, 0.264, "45 to 50 min",  38.0,  -, "its paper";
    "MoSca",            "estimated", 18.84, 0.676, 0.289, "45 to 50 min",  38.0,  -, "its paper";
    "MoVieS",           -,           18.46, 0.589, -,     "0.93 s",        -,     -, "its paper";
    "MOSAIC-GS",        -,           18.40, -,     0.255, "10.5 min",      180.0, -, "its paper";
    "MoSca",            -,           18.24, -,     -,     -,               -,     -, "MoVieS's paper";
    "MotionScale",      -,           17.98, 0.70,  0.40,  -,               -,     -, "its paper, CVPR 2026";
    "Shape of Motion",  -,           17.96, -,     -,     -,               -,     -, "MoVieS's paper";
    "Shape of Motion",  -,           17.32, 0.598, 0.296, "10 min to 2 h", -,     -, "not identified";
    "Shape of Motion",  -,           17.13, -,     -,     -,               -,     5, "SE(3) B-spline's paper";
    "RoDynRF",          -,           17.10, -,     -,     -,               -,     -, "not identified";
    "4D-Fly",           -,           17.03, 0.60,  0.37,  "6 min",         -,     -, "not identified";
    "Gaussian Marbles", "given",     16.72, -,     0.418, "5 to 9 h",      200.0, -, "not identified";
    "Shape of Motion",  -,           16.72, 0.63,  0.45,  "10 min to 2 h", -,     -, "its paper, all sequences";
    "Gaussian Marbles", "estimated", 15.79, -,     0.428, "5 to 9 h",      200.0, -, "not identified";
    "SplineGS",         -,           15.52, -,     -,     -,               -,     5, "SE(3) B-spline's paper";
    "4DGaussians",      -,           13.11, -,     -,     -,               -,     -, "not identified";
    "Deformable-GS",    -,           11.92, -,     -,     -,               -,     -, "not identified";
];

const NOVEL_NVIDIA: &[Published] = published![
    // method, poses, PSNR, SSIM, LPIPS, training, frames/s, scenes, source
    "SE(3) B-spline",  -,       27.81, 0.871, 0.049, "30 min",   45.0,   7, "its paper, CVPR 2026";
    "SplineGS",        -,       27.21, -,     0.053, -,          400.0,  7, "its paper, CVPR 2025";
    "MotionScale",     -,       26.75, -,     -,     -,          -,      -, "its paper, CVPR 2026";
    "MoSca",           -,       26.72, -,     0.070, "45 min",   38.0,   7, "its paper";
    "MOSAIC-GS",       -,       26.26, -,     0.060, "10.5 min", 180.0,  7, "its paper";
    "DynamicNeRF",     -,       26.10, -,     -,     "74 h",     0.05,   7, "not identified";
    "RoDynRF",         -,       25.89, -,     -,     "28 h",     0.42,   7, "not identified";
    "Minute4D",        "slam",  24.73, -,     -,     "0.006 h",  1218.0, 7, "Minute4D's paper";
    "Casual-FVS",      -,       24.57, -,     -,     "0.25 h",   48.0,   7, "Minute4D's paper";
    "Instant4D",       "slam",  23.99, -,     -,     "0.02 h",   822.0,  7, "Minute4D's paper";
    "Shape of Motion", -,       23.37, -,     -,     -,          -,      -, "not identified";
    "InstantSplat",    -,       22.56, -,     -,     "0.15 h",   117.0,  7, "Minute4D's paper";
    "4D-Fly",          -,       22.52, -,     -,     -,          -,      -, "not identified";
    "4D-GS",           "given", 21.45, -,     -,     "1.2 h",    43.0,   7, "Minute4D's paper";
    "4DGS",            -,       18.34, -,     -,     "0.16 h",   98.0,   7, "Minute4D's paper";
    "4DGaussians",     -,       17.69, -,     -,     -,          -,      -, "not identified";
    "HyperNeRF",       "given", 17.60, -,     -,     "64 h",     0.4,    7, "Minute4D's paper";
];

/// Published numbers that may stand beside those of a protocol: of the same task on the same data
/// set.
#[must_use]
pub fn published(protocol: Protocol) -> &'static [Published] {
    match protocol {
        // the paper names the split of RoDyGS, and compares with numbers that were made on
        // Instant4D's
        Protocol::Instant4d | Protocol::Rodygs => HELD_OUT,
        Protocol::Dycheck => NOVEL_DYCHECK,
        Protocol::Nvidia => NOVEL_NVIDIA,
        Protocol::Davis | Protocol::Holdout => &[],
    }
}

/// The caveat to the published numbers of a protocol.
pub(super) fn caveat(protocol: Protocol) -> &'static str {
    match protocol {
        Protocol::Instant4d | Protocol::Rodygs => {
            "Published PSNR is Instant4D's mean over channels of unclamped images (compare psnr_per_channel_unclamped), with poses of a SLAM \
             that saw the held-out frames, on an A6000; training time leaves SLAM, segmentation and tracking out. The paper names the split of \
             RoDyGS and takes its reference numbers from Instant4D's."
        }
        Protocol::Dycheck => {
            "PSNR, SSIM and LPIPS count where the training video saw the place. Peers whose poses are estimated align and then refine test poses; \
             papers average 5 or 7 scenes, at the full size or half of it. Rows of peers were found by search, not all at the source. \
             BTimer: no number was found."
        }
        Protocol::Nvidia => {
            "Peers whose poses are estimated refine test poses. Whether the view at time 0, which is a training image, counts differs between \
             programs; it is counted here, and eval.json has the mean without it. Rows of peers were found by search, not all at the source. Not in the \
             table: MoVieS (19.16 dB, on a split of its own), Gaussian Marbles (22.3 to 23.7 dB, by source), BTimer (no number that could be verified)."
        }
        Protocol::Davis => {
            "No published number compares: papers show images of DAVIS, or time it (breakdance-flare, 72 frames, end to end: Minute4D 42.5 s, \
             Instant4D 145.4 s). StreamSplat's 23.66 dB are of middle frames in a different setup."
        }
        Protocol::Holdout => "No published number compares.",
    }
}

#[cfg(test)]
mod tests {
    use super::super::report::published_lines;
    use super::{Published, published};
    use crate::bench::aligned;
    use minute4d_eval::{Protocol, Task};
    use std::path::Path;

    #[test]
    fn tasks_are_not_mixed() {
        let of = |protocol| {
            published(protocol)
                .iter()
                .map(|p| p.psnr_db)
                .collect::<Vec<_>>()
        };
        // the paper has no number of DyCheck's own test
        assert!(
            published(Protocol::Dycheck)
                .iter()
                .all(|p| p.method != "Minute4D")
        );
        for protocol in Protocol::ALL {
            for other in Protocol::ALL {
                let same = protocol.rules().task == other.rules().task;
                let differ = of(protocol).is_empty() || of(protocol) != of(other);
                assert!(same || differ, "{protocol} and {other}");
            }
        }
        assert_eq!(Protocol::Davis.rules().task, Task::HeldOutFrames);
        // that table is one paper's, whatever methods are in it
        assert!(
            published(Protocol::Instant4d)
                .iter()
                .all(|p| p.source.starts_with("Minute4D's paper, table"))
        );
    }

    #[test]
    fn rows_are_complete_and_sorted_and_have_a_source() {
        let peers = [
            "MoVieS",
            "MotionScale",
            "Shape of Motion",
            "Gaussian Marbles",
            "4D-Fly",
            "SE(3) B-spline",
            "SplineGS",
        ];
        let has = |rows: &[Published], name: &str| rows.iter().any(|p| p.method == name);
        assert!(
            peers
                .iter()
                .all(|name| has(published(Protocol::Dycheck), name))
        );
        let without = ["MoVieS", "Gaussian Marbles"];
        assert!(
            peers
                .iter()
                .all(|name| has(published(Protocol::Nvidia), name) != without.contains(name))
        );
        for protocol in Protocol::ALL {
            let rows = published(protocol);
            assert!(
                rows.iter().all(|p| !p.source.is_empty())
                    && rows.is_sorted_by(|a, b| a.psnr_db >= b.psnr_db)
            );
        }
    }

    #[test]
    fn the_page_of_results_has_every_table() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/results.md");
        let page = std::fs::read_to_string(path).unwrap();
        for protocol in [Protocol::Instant4d, Protocol::Dycheck, Protocol::Nvidia] {
            let table = aligned(&published_lines(published(protocol)));
            assert!(
                page.contains(&table),
                "docs/results.md lacks the table of {protocol}:\n{table}"
            );
        }
    }
}
