//! Evaluation: scores of a scene on held-out views, with or without a protocol; scores of a capture against ground truth.
//!
//! ```text
//! capture of a video --split by a Protocol--> capture with training and test frames --train--> scene
//! scene, its held-out views --views (Rules: masks, metrics, poses)--> eval.json with every choice
//! ```

mod align;
mod by_protocol;
mod choices;
mod covisible;
mod perceptual;
pub mod protocol;
mod refine;
mod split;
mod views;

pub use align::Alignment;
pub use choices::{Choices, FrameChoice, Headline, MaskChoice, PoseChoice, PoseTreatment, ResolutionChoice};
pub(crate) use covisible::adopt as adopt_covisible;
pub use covisible::{COVISIBLE_FOLDER, MaskSource};
pub use perceptual::LpipsChoice;
pub use protocol::{FrameRule, Protocol, Task};
pub use refine::Moved;
pub use split::{Parts, SPLIT_FILE, SplitRecord, parts, split};
pub(crate) use views::HeldOut;
pub use views::{EvalOptions, EvalReport, OtherMean, views, views_by};

use crate::settings::Settings;
use crate::{Category, Error, Observer};
use m4_core::Capture;
use m4_eval::geometry::{GeometryError, GeometryReport, evaluate};
use m4_eval::image::ImageError;
use m4_io::capture::{CaptureOptions, Split};
use m4_io::dataset::llff;
use m4_io::reach::Reach;
use std::path::{Path, PathBuf};

/// Compares the cameras, depth and masks of a capture with a reference for the same video: another
/// capture, or a JSON file of LLFF poses. `reach` is which files both may name.
///
/// # Errors
///
/// What could not be read, or why the two do not belong together.
pub fn geometry(capture: &Path, truth: &Path, reach: Reach, observer: &dyn Observer) -> Result<GeometryReport, Error> {
    let options = CaptureOptions {
        reach,
        ..Settings::fast().capture
    };
    let estimate = m4_io::capture::read(capture, Split::Train, &options, observer)?;
    let truth = known(truth, &options, observer)?;
    Ok(evaluate(&estimate, &truth)?)
}

fn known(path: &Path, options: &CaptureOptions, observer: &dyn Observer) -> Result<Capture, Error> {
    if !path.exists() {
        return Err(Error::Missing {
            what: "known geometry",
            path: path.to_path_buf(),
        });
    }
    if path.is_file() && llff::detect(path) {
        return Ok(llff::read(path)?);
    }
    Ok(m4_io::capture::read(path, Split::Train, options, observer)?)
}

/// Why a scene or a capture cannot be scored.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluationError {
    /// A protocol of evaluation.
    #[error(transparent)]
    Protocol(#[from] ProtocolError),
    /// Scoring images.
    #[error(transparent)]
    Score(#[from] ImageError),
    /// Scoring geometry.
    #[error(transparent)]
    ScoreGeometry(#[from] GeometryError),
    /// A capture without held-out views.
    #[error("{} has no transforms_test.json, so there are no held-out views to compare with; give a capture that has some", path.display())]
    NoTestList {
        /// The capture.
        path: PathBuf,
    },
}

impl EvaluationError {
    /// Returns the category of the failure.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::Protocol(e) => e.category(),
            Self::Score(_) | Self::ScoreGeometry(_) | Self::NoTestList { .. } => Category::BadInput,
        }
    }
}

/// Why a protocol cannot be followed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProtocolError {
    /// The held-out frames of the capture are not those of the protocol.
    #[error(
        "{} was not split by the protocol {asked} ({found}); `minute4d split CAPTURE --protocol {asked} -o NEW` writes such a capture for \
         training and evaluation",
        path.display()
    )]
    NotSplit {
        /// The capture.
        path: PathBuf,
        /// The protocol asked for.
        asked: Protocol,
        /// What the capture says.
        found: String,
    },
    /// A capture whose views come with it was to be split.
    #[error(
        "the protocol {0} uses the held-out views of the data set, so there is nothing to split; import them with the data set"
    )]
    NothingToSplit(Protocol),
    /// A capture was to be split into its own folder.
    #[error("{} would be split into itself and lose frames; name another folder", .0.display())]
    SameFolder(PathBuf),
    /// Nothing would be left.
    #[error(
        "the protocol {protocol} leaves {train} of {frames} frames for training and {test} for evaluation; use a longer clip"
    )]
    TooShort {
        /// The protocol.
        protocol: Protocol,
        /// Frames of the video.
        frames: usize,
        /// Of these train.
        train: usize,
        /// Of these are held out.
        test: usize,
    },
    /// A frame belongs to no number of the full video.
    #[error("tracks of {} do not match its frames: {what}; compute them again with `minute4d enhance`", path.display())]
    Tracks {
        /// The capture.
        path: PathBuf,
        /// The fault.
        what: String,
    },
    /// A mask of co-visibility is missing.
    #[error(
        "there is no co-visibility mask {} for the view {view}; masks are PNG files named as the image of their view, white where the \
         training video saw the point",
        path.display()
    )]
    NoMask {
        /// The path that was searched.
        path: PathBuf,
        /// The view.
        view: String,
    },
    /// Masks of co-visibility cannot be made.
    #[error(
        "co-visibility masks cannot be computed for {}: {why}; give the official ones with --covisible DIR",
        path.display()
    )]
    NoCovisibility {
        /// The capture.
        path: PathBuf,
        /// The missing part.
        why: String,
    },
    /// A mask has another size than its view.
    #[error("{} has {} x {} pixels but its view {} x {}; give the masks of the same factor", path.display(), found.0, found.1, expected.0, expected.1)]
    MaskSize {
        /// The mask.
        path: PathBuf,
        /// Columns and rows of the view.
        expected: (usize, usize),
        /// Columns and rows of the mask.
        found: (usize, usize),
    },
    /// Refinement was asked of a protocol that has none.
    #[error("the protocol {0} does not refine the poses of test images; omit --refine-poses")]
    NoRefinement(Protocol),
    /// A network of LPIPS failed.
    #[error("LPIPS of the view {view} failed: {why}")]
    Lpips {
        /// The view.
        view: String,
        /// Its message.
        why: String,
    },
    /// The weights of LPIPS are here and no weights.
    #[error("the weights of LPIPS cannot be used: {why}; `minute4d weights verify` says more")]
    LpipsWeights {
        /// The fault.
        why: String,
    },
}

impl ProtocolError {
    /// Category of the failure.
    #[must_use]
    pub fn category(&self) -> Category {
        match self {
            Self::NothingToSplit(_) | Self::NoRefinement(_) | Self::SameFolder(_) => Category::Usage,
            Self::NoMask { .. } => Category::NoInput,
            Self::Lpips { .. } => Category::NoDevice,
            _ => Category::BadInput,
        }
    }
}
