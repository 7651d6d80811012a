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
use crate::{Error, Observer, Refusal};
use m4_core::Capture;
use m4_eval::geometry::{GeometryReport, evaluate};
use m4_io::capture::{CaptureOptions, Split};
use m4_io::dataset::llff;
use m4_io::reach::Reach;
use std::path::Path;

/// Compares the cameras, depth and masks of a capture with a reference for the same video: another
/// capture, or a JSON file of LLFF poses. `reach` is which files both may name.
///
/// # Errors
///
/// What could not be read, or why the two do not belong together.
pub fn geometry(capture: &Path, truth: &Path, reach: Reach, observer: &dyn Observer) -> Result<GeometryReport, Error> {
    let options = CaptureOptions { reach, ..Settings::fast().capture };
    let estimate = m4_io::capture::read(capture, Split::Train, &options, observer)?;
    let truth = known(truth, &options, observer)?;
    Ok(evaluate(&estimate, &truth)?)
}

fn known(path: &Path, options: &CaptureOptions, observer: &dyn Observer) -> Result<Capture, Error> {
    if !path.exists() {
        return Err(Error::Missing { what: "known geometry", path: path.to_path_buf() });
    }
    if path.is_file() && llff::detect(path) {
        return Ok(llff::read(path)?);
    }
    Ok(m4_io::capture::read(path, Split::Train, options, observer)?)
}

/// The refusal of a capture without held-out views.
pub(crate) fn no_test_list(data: &Path) -> Refusal {
    Refusal::bad_input(format!(
        "{} has no transforms_test.json, so there are no held-out views to compare with; give a capture that has some",
        data.display()
    ))
}
