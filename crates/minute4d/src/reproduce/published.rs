//! Published results, each with its task; results of different tasks never share a table.
//!
//! Kinds of sources: the Minute4D paper (`paper`), the paper of the method or another's table of it (`peers`). Times are those of the
//! GPU that their authors used.

use crate::evaluate::Protocol;
use serde::Serialize;

/// A row of a published table.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Published {
    pub(super) method: &'static str,
    /// What its poses are: `slam` (estimated with the held-out frames), `estimated`, `given`; absent where that was not seen stated.
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
    /// `paper`: the Minute4D paper's table; `peers`: their own papers, or tables of others, not all read at the source.
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
    "Minute4D",       "slam",      25.77, 0.717, -, "29 s",      -, 5, "paper";
    "Instant4D",      "slam",      24.52, -,     -, "0.12 h",    -, 5, "paper";
    "Instant4D lite", "slam",      23.02, -,     -, "0.03 h",    -, 5, "paper";
    "Deform3D",       "given",     22.63, -,     -, -,           -, 5, "paper";
    "4D-GS",          "given",     21.64, -,     -, "1.2 h",     -, 5, "paper";
    "D-NeRF",         "given",     21.50, -,     -, "over 24 h", -, 5, "paper";
    "RoDyGS",         "estimated", 17.37, -,     -, "1.0 h",     -, 5, "paper";
    "RoDynRF",        "given",     16.80, -,     -, "22 h",      -, 5, "paper";
    "RoDynRF",        "estimated", 14.90, -,     -, "22 h",      -, 5, "paper";
];

const NOVEL_DYCHECK: &[Published] = published![
    // method, poses, PSNR, SSIM, LPIPS, training, frames/s, scenes, source
    "SE(3) B-spline",   -,           20.17, 0.729, 0.274, "30 min",        45.0,  5, "peers";
    "MoSca",            "given",     19.32, 0.706, 0.264, "45 to 50 min",  38.0,  -, "peers";
    "MoSca",            "estimated", 18.84, 0.676, 0.289, "45 to 50 min",  38.0,  -, "peers";
    "MOSAIC-GS",        -,           18.40, -,     0.255, "10.5 min",      180.0, -, "peers";
    "MotionScale",      -,           17.98, 0.70,  0.40,  -,               -,     -, "peers";
    "Shape of Motion",  -,           17.32, 0.598, 0.296, "10 min to 2 h", -,     -, "peers";
    "RoDynRF",          -,           17.10, -,     -,     -,               -,     -, "peers";
    "4D-Fly",           -,           17.03, 0.60,  0.37,  "6 min",         -,     -, "peers";
    "Gaussian Marbles", "given",     16.72, -,     0.418, "5 to 9 h",      200.0, -, "peers";
    "4DGaussians",      -,           13.11, -,     -,     -,               -,     -, "peers";
];

const NOVEL_NVIDIA: &[Published] = published![
    // method, poses, PSNR, SSIM, LPIPS, training, frames/s, scenes, source
    "SE(3) B-spline", -,       27.81, 0.871, 0.049, "30 min",   45.0,   7, "peers";
    "SplineGS",       -,       27.21, -,     0.053, -,          400.0,  7, "peers";
    "MoSca",          -,       26.72, -,     0.070, "45 min",   38.0,   7, "peers";
    "MOSAIC-GS",      -,       26.26, -,     0.060, "10.5 min", 180.0,  7, "peers";
    "DynamicNeRF",    -,       26.10, -,     0.082, "74 h",     0.05,   7, "peers";
    "RoDynRF",        -,       25.89, -,     0.065, "28 h",     0.42,   7, "peers";
    "Minute4D",       "slam",  24.73, -,     -,     "0.006 h",  1218.0, 7, "paper";
    "Casual-FVS",     -,       24.57, -,     -,     "0.25 h",   48.0,   7, "paper";
    "Instant4D",      "slam",  23.99, -,     -,     "0.02 h",   822.0,  7, "paper";
    "InstantSplat",   -,       22.56, -,     -,     "0.15 h",   117.0,  7, "paper";
    "4D-GS",          "given", 21.45, -,     -,     "1.2 h",    43.0,   7, "paper";
    "HyperNeRF",      "given", 17.60, -,     -,     "64 h",     0.4,    7, "paper";
];

/// Published numbers that may stand beside those of a protocol: of the same task on the same data set.
#[must_use]
pub fn published(protocol: Protocol) -> &'static [Published] {
    match protocol {
        // the paper names the split of RoDyGS, and compares with numbers that were made on Instant4D's
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
             papers average 5 or 7 scenes, at the full size or half of it."
        }
        Protocol::Nvidia => {
            "Peers whose poses are estimated refine test poses. Whether the view at time 0, which is a training image, counts differs between \
             programs; it is counted here, and eval.json has the mean without it."
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
    use super::published;
    use crate::evaluate::{Protocol, Task};

    #[test]
    fn tasks_are_not_mixed() {
        let of = |protocol| published(protocol).iter().map(|p| p.psnr_db).collect::<Vec<_>>();
        // the paper has no number of DyCheck's own test
        assert!(published(Protocol::Dycheck).iter().all(|p| p.method != "Minute4D"));
        for protocol in Protocol::ALL {
            for other in Protocol::ALL {
                let same = protocol.rules().task == other.rules().task;
                let differ = of(protocol).is_empty() || of(protocol) != of(other);
                assert!(same || differ, "{protocol} and {other}");
            }
        }
        assert_eq!(Protocol::Davis.rules().task, Task::HeldOutFrames);
    }
}
