//! The protocols as plain data.
//!
//! Sources: the programs that made the published numbers (RoDyGS, Instant4D, `KAIR-BAIR/dycheck`, `facebookresearch/robust-dynrf`, MoSca).
//! What such a program leaves open, or what was not seen in one, is stated in [`Rules::note`].

use super::{FrameRule, Protocol, Task};
use m4_eval::image::{Metric, PsnrKind, SsimKind};
use serde::{Deserialize, Serialize};

/// Where the search for the pose of a test image starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StartPose {
    /// The pose that the capture gives, in the world of the scene.
    Given,
    /// The pose of the training frame that is nearest in time.
    NearestTraining,
}

/// Refinement of the pose of a test image against the finished scene: Adam on the squared error of the image.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RefineRule {
    /// Steps of Adam.
    pub steps: usize,
    /// Learning rate: radians, and shares of the median depth in view.
    pub lr: f64,
    /// Where it starts.
    pub start: StartPose,
}

/// A network whose features are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LpipsRule {
    /// AlexNet.
    Alex,
    /// VGG-16.
    Vgg,
}

/// Rules of a protocol.
#[derive(Debug, Clone, PartialEq)]
pub struct Rules {
    /// The name of the weights.
    pub protocol: Protocol,
    /// The name on the command line.
    pub name: &'static str,
    /// One line for people.
    pub title: &'static str,
    /// The task.
    pub task: Task,
    /// Which frames are held out.
    pub frames: FrameRule,
    /// Columns and rows of the images that published numbers are of; `None` where it takes those of the capture.
    pub size_px: Option<[usize; 2]>,
    /// Scores count where the training video saw the place.
    pub covisible: bool,
    /// Metrics of the whole image beside joint PSNR and SSIM over a Gaussian window.
    pub whole: &'static [Metric],
    /// Metrics inside the mask of co-visibility.
    pub inside: &'static [Metric],
    /// Networks of LPIPS; inside a mask AlexNet alone, as DyCheck's mLPIPS.
    pub lpips: &'static [LpipsRule],
    /// Name of the score that stands for the protocol in tables, of [`m4_eval::image::FrameScore::others`]; `None` for the joint PSNR of
    /// the whole image.
    pub headline: Option<&'static str>,
    /// Refinement of test poses in published methods, if any.
    pub refine: Option<RefineRule>,
    /// Caveats for comparisons.
    pub note: &'static str,
}

const PER_CHANNEL: Metric = Metric::Psnr(PsnrKind::PerChannel);
const ZERO_PADDED: Metric = Metric::Ssim(SsimKind::GaussianZeroPadded);
/// DyCheck's images at a factor of 2.
const DYCHECK_2X: Option<[usize; 2]> = Some([360, 480]);

/// What protocols have that hold frames out.
const HELD_OUT: Rules = Rules {
    protocol: Protocol::Holdout,
    name: "holdout",
    title: "every eighth frame of the training video held out",
    task: Task::HeldOutFrames,
    frames: FrameRule::Every { every: 8, offset: 0 },
    size_px: None,
    covisible: false,
    whole: &[PER_CHANNEL, ZERO_PADDED],
    inside: &[],
    lpips: &[LpipsRule::Alex, LpipsRule::Vgg],
    headline: None,
    refine: None,
    note: "the first frame is held out, so that the first moment is beyond what trained",
};

static TABLE: [Rules; 6] = [
    HELD_OUT,
    Rules {
        protocol: Protocol::Instant4d,
        name: "instant4d",
        title: "15 % of the frames of DyCheck's camera 0 held out (Instant4D)",
        frames: FrameRule::Linspace { train_share: 0.85 },
        size_px: DYCHECK_2X,
        note: "published numbers are the mean over channels of the PSNR of each, of images that were not clamped (psnr_per_channel_unclamped), \
               with poses of a MegaSaM that saw the held-out frames; that linspace cuts fractions off is assumed",
        ..HELD_OUT
    },
    Rules {
        protocol: Protocol::Rodygs,
        name: "rodygs",
        title: "every eighth frame of DyCheck's camera 0 held out (RoDyGS)",
        frames: FrameRule::Every { every: 8, offset: 4 },
        size_px: DYCHECK_2X,
        refine: Some(RefineRule { steps: 1000, lr: 5e-5, start: StartPose::NearestTraining }),
        note: "RoDyGS estimates poses of the training frames alone and finds those of the held-out ones by refinement",
        ..HELD_OUT
    },
    Rules {
        protocol: Protocol::Dycheck,
        name: "dycheck",
        title: "views of DyCheck's other cameras, where the training video saw the place",
        task: Task::NovelViews,
        frames: FrameRule::TestSplit,
        size_px: DYCHECK_2X,
        covisible: true,
        whole: &[],
        inside: &[Metric::Psnr(PsnrKind::Joint), Metric::Ssim(SsimKind::DycheckMasked)],
        lpips: &[LpipsRule::Alex],
        headline: Some("psnr_joint_masked"),
        refine: Some(RefineRule { steps: 30, lr: 3e-3, start: StartPose::Given }),
        note: "older papers average 5 scenes at the full size, newer ones 7 at half of it; SSIM over 11 px windows that lie wholly inside",
    },
    Rules {
        protocol: Protocol::Nvidia,
        name: "nvidia",
        title: "views of camera 0 of NVIDIA Dynamic Scenes (RoDynRF)",
        task: Task::NovelViews,
        frames: FrameRule::TestSplit,
        size_px: Some([480, 270]),
        covisible: false,
        whole: &[Metric::Psnr(PsnrKind::EightBit), Metric::Ssim(SsimKind::SkimageUniform)],
        inside: &[],
        lpips: &[LpipsRule::Alex],
        headline: Some("psnr_eight_bit"),
        refine: Some(RefineRule { steps: 100, lr: 3e-4, start: StartPose::Given }),
        note: "the view at time 0 is the first training image; scores are given with it, as the result bundle has it, and without",
    },
    Rules {
        protocol: Protocol::Davis,
        name: "davis",
        title: "every fourth frame of a clip of DAVIS held out",
        frames: FrameRule::Every { every: 4, offset: 2 },
        note: "a substitute of this program: DAVIS has no other view, and the papers show images of it alone",
        ..HELD_OUT
    },
];

pub(super) fn of(protocol: Protocol) -> &'static Rules {
    match protocol {
        Protocol::Holdout => &TABLE[0],
        Protocol::Instant4d => &TABLE[1],
        Protocol::Rodygs => &TABLE[2],
        Protocol::Dycheck => &TABLE[3],
        Protocol::Nvidia => &TABLE[4],
        Protocol::Davis => &TABLE[5],
    }
}
