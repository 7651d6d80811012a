//! Compares a capture with the optical flow of its images, and corrects it on request.

use super::{ImportError, STAGE};
use crate::Error;
use crate::progress::RecordingObserver;
use m4_core::Progress;
use m4_geometry::classical::dense::InverseSearch;
use m4_geometry::consistency::{self, Cause, Consistency, ConsistencyError, Verdict};
use m4_io::dataset::Imported;
use serde::Serialize;
use std::fmt;

/// The result of the comparison.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Checked {
    /// Of the capture that was written.
    #[serde(flatten)]
    pub consistency: Consistency,
    /// What was put right first, and how things stood before.
    pub repaired: Option<Repaired>,
}

/// The corrections.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Repaired {
    /// The convention errors found.
    pub causes: Vec<Cause>,
    /// The comparison of the capture as its files say.
    pub before: Consistency,
}

/// Compares the training frames with their flow; with `fix` the causes that are found are put right in all frames, held-out views included, and
/// the comparison is made again.
pub(super) fn checked(
    mut imported: Imported,
    fix: bool,
    keeper: &RecordingObserver<'_>,
) -> Result<(Checked, Imported), Error> {
    let check = |imported: &Imported| {
        let found = consistency::check(&imported.train, &InverseSearch, keeper);
        found.map_err(|error| match error {
            ConsistencyError::Cancelled => Error::Stopped {
                stage: STAGE,
                saved: false,
            },
            other => ImportError::from(other).into(),
        })
    };
    let found: Consistency = check(&imported)?;
    if fix && !found.causes.is_empty() {
        imported.train = consistency::fixed(imported.train, &found.causes);
        imported.test = imported.test.map(|test| consistency::fixed(test, &found.causes));
        let after = check(&imported)?;
        for cause in &found.causes {
            keeper.warn(&format!("{cause}; this was corrected"));
        }
        let repaired = Some(Repaired {
            causes: found.causes.clone(),
            before: found,
        });
        return Ok((
            Checked {
                consistency: after,
                repaired,
            },
            imported,
        ));
    }
    for cause in &found.causes {
        keeper.warn(&format!("{cause}; --fix puts it right"));
    }
    if found.verdict == Verdict::Bad && found.causes.is_empty() {
        keeper.warn(
            "cameras and depth do not fit the images, and none of the usual convention errors (axes, direction, unit, focal length, half a pixel) explains \
             it: are they of the same clip and frames?",
        );
    }
    let checked = Checked {
        consistency: found,
        repaired: None,
    };
    Ok((checked, imported))
}

impl fmt::Display for Checked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let c = &self.consistency;
        if c.verdict == Verdict::Unknown {
            return write!(
                f,
                "consistency unknown: {} static pixels were tracked, by {:.2} px on average, which is too little to decide",
                c.samples, c.flow_px
            );
        }
        write!(f, "consistency {}: ", c.verdict.name())?;
        match c.error_px {
            Some(px) => write!(
                f,
                "cameras and flow differ by {px:.2} px (median of {} pixels)",
                c.samples
            )?,
            None => f.write_str("most pixels would be behind a camera")?,
        }
        if let Some(share) = c.depth_error {
            write!(f, ", depth by {:.2} %", 100.0 * share)?;
        }
        if let Some(before) = self.repaired.as_ref().map(|r| &r.before) {
            match before.error_px {
                Some(px) => write!(f, "; {px:.2} px before the correction")?,
                None => f.write_str("; behind a camera before the correction")?,
            }
        }
        Ok(())
    }
}
