//! Evaluation protocols: everything that must agree before two scores can be compared.
//!
//! ```text
//! name --Rules--> frames held out, resolution, masks, metrics, LPIPS, how test poses are treated
//! ```
//!
//! The rules are plain data ([`Rules`]), from the programs that made the published numbers (RoDyGS,
//! Instant4D, `KAIR-BAIR/dycheck`, `facebookresearch/robust-dynrf`, MoSca); what such a program
//! leaves open is stated in [`Rules::note`]. Two tasks are distinguished ([`Task`]): images of the
//! *training* camera at moments that were held out, which is the table of the Minute4D and
//! Instant4D papers, and images of *other* cameras, which is DyCheck's own test. The same scenes
//! score 7 dB apart in the two.

use m4_eval::image::{Metric, PsnrKind, SsimKind};
use minute4d::settings::{UnknownName, by_name};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Task of a protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Task {
    /// Held-out frames of the training camera: interpolation on its own path.
    HeldOutFrames,
    /// Views of cameras that the training video never had.
    NovelViews,
}

impl Task {
    /// Title in tables.
    pub fn title(self) -> &'static str {
        match self {
            Self::HeldOutFrames => "held-out frames of the training camera",
            Self::NovelViews => "views of other cameras",
        }
    }
}

/// A protocol by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Protocol {
    /// Every eighth frame of the training video is held out, as loaders of LLFF scenes do it.
    Holdout,
    /// Instant4D on DyCheck: 85 % of the frames of camera 0 train, evenly spaced. The first table
    /// of the Minute4D paper compares with numbers that were made so.
    Instant4d,
    /// RoDyGS on DyCheck: frame `i` of camera 0 is held out where `(i + 4) mod 8 = 0`.
    Rodygs,
    /// DyCheck's own: views of other cameras, scored where the training video saw the place.
    Dycheck,
    /// NVIDIA Dynamic Scenes as RoDynRF takes them: 12 training images, views of camera 0 at their
    /// moments.
    Nvidia,
    /// Every fourth frame of a clip of DAVIS is held out.
    Davis,
}

impl Protocol {
    /// All variants.
    pub const ALL: [Self; 6] = [
        Self::Holdout,
        Self::Instant4d,
        Self::Rodygs,
        Self::Dycheck,
        Self::Nvidia,
        Self::Davis,
    ];

    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        self.rules().name
    }

    /// Rules of the protocol.
    pub fn rules(self) -> &'static Rules {
        // in the order of `ALL`
        &TABLE[self as usize]
    }
}

impl fmt::Display for Protocol {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Protocol {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        by_name("protocol", text, &Self::ALL, Self::name)
    }
}

/// Which frames of a training video are held out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "rule")]
pub enum FrameRule {
    /// Frame `i`, counted from 0, where `(i + offset) mod every = 0`.
    Every {
        /// One of this many frames.
        every: usize,
        /// Added to the index first.
        offset: usize,
    },
    /// All but `int(train_share * n)` frames that `numpy.linspace(0, n - 1, ..)` names, fractions
    /// cut off.
    Linspace {
        /// Share of the frames that train, 0..1.
        train_share: f64,
    },
    /// The held-out views that the capture brings.
    TestSplit,
}

impl FrameRule {
    /// Indices of the held-out frames of a video of `frames`, ascending; `None` where the capture
    /// brings its views.
    pub fn held_out(self, frames: usize) -> Option<Vec<usize>> {
        match self {
            Self::Every { every, offset } => {
                let every = every.max(1);
                Some(
                    (0..frames)
                        .filter(|i| (i + offset).is_multiple_of(every))
                        .collect(),
                )
            }
            Self::Linspace { train_share } => {
                let train = linspace(frames, (frames as f64 * train_share) as usize);
                Some(
                    (0..frames)
                        .filter(|i| train.binary_search(i).is_err())
                        .collect(),
                )
            }
            Self::TestSplit => None,
        }
    }

    /// Description for reports.
    pub fn description(self) -> String {
        match self {
            Self::Every { every, offset: 0 } => {
                format!("frame i of the training video where i mod {every} = 0")
            }
            Self::Every { every, offset } => {
                format!("frame i of the training video where (i + {offset}) mod {every} = 0")
            }
            Self::Linspace { train_share } => format!(
                "frames of the training video that numpy.linspace(0, n - 1, int({train_share} n)) leaves out, fractions cut off"
            ),
            Self::TestSplit => "the held-out views that the data set brings".to_owned(),
        }
    }
}

/// Where the search for the pose of a test image starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StartPose {
    /// The pose that the capture gives, in the world of the scene.
    Given,
    /// The pose of the training frame that is nearest in time.
    NearestTraining,
}

/// Refinement of the pose of a test image against the finished scene: Adam on the squared error of
/// the image.
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
    /// The protocol.
    pub protocol: Protocol,
    /// The name on the command line.
    pub name: &'static str,
    /// One line for people.
    pub title: &'static str,
    /// The task.
    pub task: Task,
    /// Which frames are held out.
    pub frames: FrameRule,
    /// Columns and rows of the images that published numbers are of; `None` where it takes those of
    /// the capture.
    pub size_px: Option<[usize; 2]>,
    /// Scores count where the training video saw the place.
    pub covisible: bool,
    /// Metrics of the whole image beside joint PSNR and SSIM over a Gaussian window.
    pub whole: &'static [Metric],
    /// Metrics inside the mask of co-visibility.
    pub inside: &'static [Metric],
    /// Networks of LPIPS; inside a mask AlexNet alone, as DyCheck's mLPIPS.
    pub lpips: &'static [LpipsRule],
    /// Name of the score that stands for the protocol in tables, of
    /// [`m4_eval::image::FrameScore::others`]; `None` for the joint PSNR of the whole image.
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
    frames: FrameRule::Every {
        every: 8,
        offset: 0,
    },
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
        frames: FrameRule::Every {
            every: 8,
            offset: 4,
        },
        size_px: DYCHECK_2X,
        refine: Some(RefineRule {
            steps: 1000,
            lr: 5e-5,
            start: StartPose::NearestTraining,
        }),
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
        inside: &[
            Metric::Psnr(PsnrKind::Joint),
            Metric::Ssim(SsimKind::DycheckMasked),
        ],
        lpips: &[LpipsRule::Alex],
        headline: Some("psnr_joint_masked"),
        refine: Some(RefineRule {
            steps: 30,
            lr: 3e-3,
            start: StartPose::Given,
        }),
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
        whole: &[
            Metric::Psnr(PsnrKind::EightBit),
            Metric::Ssim(SsimKind::SkimageUniform),
        ],
        inside: &[],
        lpips: &[LpipsRule::Alex],
        headline: Some("psnr_eight_bit"),
        refine: Some(RefineRule {
            steps: 100,
            lr: 3e-4,
            start: StartPose::Given,
        }),
        note: "the view at time 0 is the first training image; scores are given with it, as the result bundle has it, and without",
    },
    Rules {
        protocol: Protocol::Davis,
        name: "davis",
        title: "every fourth frame of a clip of DAVIS held out",
        frames: FrameRule::Every {
            every: 4,
            offset: 2,
        },
        note: "a substitute of this program: DAVIS has no other view, and the papers show images of it alone",
        ..HELD_OUT
    },
];

/// `numpy.linspace(0, n - 1, count).astype(int)`: in doubles, `i * step`, the last one `n - 1`
/// itself.
fn linspace(n: usize, count: usize) -> Vec<usize> {
    let last = n.saturating_sub(1);
    match count {
        0 => Vec::new(),
        1 => vec![0],
        _ => {
            let step = last as f64 / (count - 1) as f64;
            let inner = (0..count - 1).map(|i| (i as f64 * step) as usize);
            inner.chain([last]).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{FrameRule, Protocol, Task, linspace};

    #[test]
    fn names_are_read_back_and_tasks_follow_from_the_frames() {
        for protocol in Protocol::ALL {
            assert_eq!(protocol.name().parse(), Ok(protocol));
            assert_eq!(
                serde_json::to_string(&protocol).unwrap(),
                format!("{:?}", protocol.name())
            );
            let rules = protocol.rules();
            assert_eq!(rules.protocol, protocol);
            let novel = rules.frames == FrameRule::TestSplit;
            assert_eq!(novel, rules.task == Task::NovelViews, "{protocol}");
        }
        assert!("psnr".parse::<Protocol>().is_err());
    }

    fn held_out(protocol: Protocol, frames: usize) -> Vec<usize> {
        protocol.rules().frames.held_out(frames).unwrap()
    }

    /// Expected values: numpy 2, `np.linspace(0, n - 1, int(n * 0.85)).astype(int)`.
    #[test]
    fn the_split_of_instant4d_is_that_of_numpy() {
        assert_eq!(
            linspace(20, 17),
            [0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11, 13, 14, 15, 16, 17, 19]
        );
        assert_eq!(held_out(Protocol::Instant4d, 6), [4]);
        assert_eq!(held_out(Protocol::Instant4d, 12), [5, 10]);
        assert_eq!(held_out(Protocol::Instant4d, 13), [5, 11]);
        assert_eq!(held_out(Protocol::Instant4d, 20), [6, 12, 18]);
        assert_eq!(held_out(Protocol::Instant4d, 24), [5, 11, 17, 22]);
        let of_72 = [6, 12, 19, 25, 32, 38, 45, 51, 58, 64, 70];
        assert_eq!(held_out(Protocol::Instant4d, 72), of_72);
        let of_475 = held_out(Protocol::Instant4d, 475);
        assert_eq!((of_475.len(), of_475.iter().sum::<usize>()), (72, 17262));
        assert!(held_out(Protocol::Instant4d, 0).is_empty());
        // int(0.85) = 0 frames of a single one train
        assert_eq!(held_out(Protocol::Instant4d, 1), [0]);
    }

    #[test]
    fn every_so_many_is_counted_from_its_offset() {
        assert_eq!(held_out(Protocol::Rodygs, 24), [4, 12, 20]);
        assert_eq!(held_out(Protocol::Holdout, 17), [0, 8, 16]);
        assert_eq!(held_out(Protocol::Davis, 12), [2, 6, 10]);
        assert_eq!(Protocol::Dycheck.rules().frames.held_out(24), None);
        let words = Protocol::Rodygs.rules().frames.description();
        assert!(words.contains("(i + 4) mod 8 = 0"), "{words}");
        let json = serde_json::to_string(&Protocol::Instant4d.rules().frames).unwrap();
        assert_eq!(json, r#"{"rule":"linspace","train_share":0.85}"#);
    }
}
