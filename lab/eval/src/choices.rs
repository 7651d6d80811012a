//! The choices behind a score, as recorded in `eval.json`.

use super::covisible::MaskSource;
use super::perceptual::LpipsChoice;
use super::protocol::{FrameRule, RefineRule, Task};
use super::{Alignment, Moved, Protocol, SplitRecord};
use m4_eval::image::MeanScore;
use serde::Serialize;
use std::collections::BTreeMap;

/// `choices` of `eval.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Choices {
    /// The protocol.
    pub protocol: Protocol,
    /// In words.
    pub title: &'static str,
    /// The task; scores of two tasks never compare.
    pub task: Task,
    /// Which frames are held out, and which were scored.
    pub frames: FrameChoice,
    /// The size of the images.
    pub resolution: ResolutionChoice,
    /// Where scores count.
    pub mask: MaskChoice,
    /// The output of the renderer that was scored.
    pub render: String,
    /// Each score by its name in `images.frames[]`, with what it stands for: window, region,
    /// clamping.
    pub metrics: BTreeMap<String, String>,
    /// LPIPS, network by network.
    pub lpips: Vec<LpipsChoice>,
    /// Source of the poses of test images.
    pub poses: PoseChoice,
    /// The score that stands for the protocol in tables.
    pub headline: Headline,
    /// Caveats for comparisons.
    pub note: &'static str,
}

/// Which frames are held out, and which were scored.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrameChoice {
    /// The rule.
    pub rule: FrameRule,
    /// In words.
    pub words: String,
    /// Names of the scored images, in order.
    pub scored: Vec<String>,
    /// Their indices in the whole video, where they were held out of it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub indices: Option<Vec<usize>>,
    /// Frames of the whole video, where they were held out of it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub of_frames: Option<usize>,
    /// Scored images whose camera and moment are those of a training image: no test.
    pub also_training: Vec<String>,
    /// Means without these, where there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mean_without: Option<MeanScore>,
}

/// The size of the images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct ResolutionChoice {
    /// Columns and rows that were scored.
    pub scored_px: [usize; 2],
    /// Those of the published numbers; absent where the protocol takes those of the capture.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub protocol_px: Option<[usize; 2]>,
}

/// Where scores count.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MaskChoice {
    /// Where masks come from.
    pub source: MaskSource,
    /// In words.
    pub words: String,
    /// Mean share of the pixels that count; absent without masks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub share: Option<f64>,
}

/// Source of the poses of test images.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PoseChoice {
    /// How.
    pub treatment: PoseTreatment,
    /// In words.
    pub words: String,
    /// Whether what estimated the poses saw the held-out images; absent where the capture does not
    /// say.
    pub geometry_saw_held_out: Option<bool>,
    /// What the protocol's peers do at test time, where they do; `treatment` says whether it was
    /// done here.
    pub refinement_of_protocol: Option<RefineRule>,
    /// Corrections by pose refinement, view by view.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub moved: Vec<Moved>,
    /// Means without refinement, where there was one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mean_unrefined: Option<MeanScore>,
}

/// Source of the poses of test images.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum PoseTreatment {
    /// As the capture gives them.
    Given,
    /// Brought into the world of the scene by a similarity.
    Sim3Aligned,
    /// Looked for at test time, from given or aligned ones or from the nearest training frame.
    Refined,
}

/// The score that stands for the protocol in tables.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Headline {
    /// Its name.
    pub name: String,
    /// Mean over the views that have it; absent where none has.
    pub mean: Option<f64>,
}

/// Whether what estimated the poses saw the held-out images, and how test images got theirs, before
/// any refinement.
pub(super) fn poses(
    alignment: Option<&Alignment>,
    split: Option<&SplitRecord>,
) -> (PoseTreatment, String, Option<bool>) {
    match (alignment, split) {
        (Some(a), _) => (
            PoseTreatment::Sim3Aligned,
            format!(
                "the capture's, brought into the scene's world by a similarity of {} training cameras (error {:.2} % of the path, {:.2} degrees)",
                a.cameras, a.rmse_percent, a.median_deg
            ),
            // the scene was made of another capture, of which nothing is known here
            None,
        ),
        (None, Some(split)) if split.geometry_saw_held_out => (
            PoseTreatment::Given,
            "those of the capture that was split, whose geometry saw the held-out frames: better than of a video without them".to_owned(),
            Some(true),
        ),
        (None, Some(_)) => (PoseTreatment::Given, "those of the capture that was split".to_owned(), Some(false)),
        (None, None) => (
            PoseTreatment::Given,
            "as the capture gives them; whether their estimation used the held-out images is not recorded".to_owned(),
            None,
        ),
    }
}
