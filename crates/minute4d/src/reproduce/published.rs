//! Published results, each with its task; results of different tasks never share a table.
//!
//! Kinds of sources: the Minute4D paper (`paper`), the paper of the method or another's table of it (`peers`). Times are those of the
//! GPU that their authors used.

use crate::evaluate::Protocol;
use serde::Serialize;

/// A row of a published table.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Published {
    /// The method.
    pub method: &'static str,
    /// What its poses are: `slam` (estimated with the held-out frames), `estimated`, `given`; absent where that was not seen stated.
    pub poses: Option<&'static str>,
    /// Mean of the score that stands for the protocol, dB.
    pub psnr_db: f64,
    /// Mean SSIM, of the kind of the protocol.
    pub ssim: Option<f64>,
    /// Mean LPIPS with AlexNet.
    pub lpips: Option<f64>,
    /// The training time.
    pub training: Option<&'static str>,
    /// Images a second.
    pub frames_per_s: Option<f64>,
    /// Scenes of the mean, where that was seen stated.
    pub scenes: Option<usize>,
    /// `paper`: the Minute4D paper's table; `peers`: their own papers, or tables of others, not all read at the source.
    pub source: &'static str,
}

const fn row(
    method: &'static str,
    poses: Option<&'static str>,
    psnr_db: f64,
    scenes: Option<usize>,
    source: &'static str,
) -> Published {
    Published {
        method,
        poses,
        psnr_db,
        ssim: None,
        lpips: None,
        training: None,
        frames_per_s: None,
        scenes,
        source,
    }
}

const HELD_OUT: &[Published] = &[
    Published {
        ssim: Some(0.717),
        training: Some("29 s"),
        ..row("Minute4D", Some("slam"), 25.77, Some(5), "paper")
    },
    Published {
        training: Some("0.12 h"),
        ..row("Instant4D", Some("slam"), 24.52, Some(5), "paper")
    },
    Published {
        training: Some("0.03 h"),
        ..row("Instant4D lite", Some("slam"), 23.02, Some(5), "paper")
    },
    row("Deform3D", Some("given"), 22.63, Some(5), "paper"),
    Published {
        training: Some("1.2 h"),
        ..row("4D-GS", Some("given"), 21.64, Some(5), "paper")
    },
    Published {
        training: Some("over 24 h"),
        ..row("D-NeRF", Some("given"), 21.50, Some(5), "paper")
    },
    Published {
        training: Some("1.0 h"),
        ..row("RoDyGS", Some("estimated"), 17.37, Some(5), "paper")
    },
    Published {
        training: Some("22 h"),
        ..row("RoDynRF", Some("given"), 16.80, Some(5), "paper")
    },
    Published {
        training: Some("22 h"),
        ..row("RoDynRF", Some("estimated"), 14.90, Some(5), "paper")
    },
];

const NOVEL_DYCHECK: &[Published] = &[
    Published {
        ssim: Some(0.729),
        lpips: Some(0.274),
        training: Some("30 min"),
        frames_per_s: Some(45.0),
        ..row("SE(3) B-spline", None, 20.17, Some(5), "peers")
    },
    Published {
        ssim: Some(0.706),
        lpips: Some(0.264),
        training: Some("45 to 50 min"),
        frames_per_s: Some(38.0),
        ..row("MoSca", Some("given"), 19.32, None, "peers")
    },
    Published {
        ssim: Some(0.676),
        lpips: Some(0.289),
        training: Some("45 to 50 min"),
        frames_per_s: Some(38.0),
        ..row("MoSca", Some("estimated"), 18.84, None, "peers")
    },
    Published {
        lpips: Some(0.255),
        training: Some("10.5 min"),
        frames_per_s: Some(180.0),
        ..row("MOSAIC-GS", None, 18.40, None, "peers")
    },
    Published {
        ssim: Some(0.70),
        lpips: Some(0.40),
        ..row("MotionScale", None, 17.98, None, "peers")
    },
    Published {
        ssim: Some(0.598),
        lpips: Some(0.296),
        training: Some("10 min to 2 h"),
        ..row("Shape of Motion", None, 17.32, None, "peers")
    },
    row("RoDynRF", None, 17.10, None, "peers"),
    Published {
        ssim: Some(0.60),
        lpips: Some(0.37),
        training: Some("6 min"),
        ..row("4D-Fly", None, 17.03, None, "peers")
    },
    Published {
        lpips: Some(0.418),
        training: Some("5 to 9 h"),
        frames_per_s: Some(200.0),
        ..row("Gaussian Marbles", Some("given"), 16.72, None, "peers")
    },
    row("4DGaussians", None, 13.11, None, "peers"),
];

const NOVEL_NVIDIA: &[Published] = &[
    Published {
        ssim: Some(0.871),
        lpips: Some(0.049),
        training: Some("30 min"),
        frames_per_s: Some(45.0),
        ..row("SE(3) B-spline", None, 27.81, Some(7), "peers")
    },
    Published {
        lpips: Some(0.053),
        frames_per_s: Some(400.0),
        ..row("SplineGS", None, 27.21, Some(7), "peers")
    },
    Published {
        lpips: Some(0.070),
        training: Some("45 min"),
        frames_per_s: Some(38.0),
        ..row("MoSca", None, 26.72, Some(7), "peers")
    },
    Published {
        lpips: Some(0.060),
        training: Some("10.5 min"),
        frames_per_s: Some(180.0),
        ..row("MOSAIC-GS", None, 26.26, Some(7), "peers")
    },
    Published {
        lpips: Some(0.082),
        training: Some("74 h"),
        frames_per_s: Some(0.05),
        ..row("DynamicNeRF", None, 26.10, Some(7), "peers")
    },
    Published {
        lpips: Some(0.065),
        training: Some("28 h"),
        frames_per_s: Some(0.42),
        ..row("RoDynRF", None, 25.89, Some(7), "peers")
    },
    Published {
        training: Some("0.006 h"),
        frames_per_s: Some(1218.0),
        ..row("Minute4D", Some("slam"), 24.73, Some(7), "paper")
    },
    Published {
        training: Some("0.25 h"),
        frames_per_s: Some(48.0),
        ..row("Casual-FVS", None, 24.57, Some(7), "paper")
    },
    Published {
        training: Some("0.02 h"),
        frames_per_s: Some(822.0),
        ..row("Instant4D", Some("slam"), 23.99, Some(7), "paper")
    },
    Published {
        training: Some("0.15 h"),
        frames_per_s: Some(117.0),
        ..row("InstantSplat", None, 22.56, Some(7), "paper")
    },
    Published {
        training: Some("1.2 h"),
        frames_per_s: Some(43.0),
        ..row("4D-GS", Some("given"), 21.45, Some(7), "paper")
    },
    Published {
        training: Some("64 h"),
        frames_per_s: Some(0.4),
        ..row("HyperNeRF", Some("given"), 17.60, Some(7), "paper")
    },
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
        let paper = |protocol| published(protocol).iter().find(|p| p.method == "Minute4D").copied();
        assert_eq!(paper(Protocol::Instant4d).unwrap().psnr_db, 25.77);
        assert_eq!(paper(Protocol::Instant4d).unwrap().training, Some("29 s"));
        assert_eq!(paper(Protocol::Nvidia).unwrap().frames_per_s, Some(1218.0));
        // the paper has no number of DyCheck's own test
        assert_eq!(paper(Protocol::Dycheck), None);
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
