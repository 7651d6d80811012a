//! A capture compared with the flow of its pictures, and put right where that is asked for.

use super::{ImportError, STAGE};
use crate::Error;
use crate::progress::Keeper;
use m4_import::Imported;
use m4_scene::Progress;
use m4_slam::consistency::{self, Cause, Consistency, ConsistencyError, Verdict};
use m4_slam::dense::InverseSearch;
use serde::Serialize;
use std::fmt;

/// What the comparison found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Checked {
    /// Of the capture that was written.
    #[serde(flatten)]
    pub consistency: Consistency,
    /// What was put right first, and how things stood before.
    pub repaired: Option<Repaired>,
}

/// What was put right.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Repaired {
    /// What was misread.
    pub causes: Vec<Cause>,
    /// The comparison of the capture as its files say.
    pub before: Consistency,
}

/// Compares the training frames with their flow; with `fix` the causes that are found are put right in all frames, held-out views included, and
/// the comparison is made again.
pub(super) fn checked(mut imported: Imported, fix: bool, keeper: &Keeper<'_>) -> Result<(Checked, Imported), Error> {
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
            keeper.warn(&format!("{cause}; this was put right"));
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
            "cameras and depth do not fit the pictures, and none of the usual misreadings (axes, direction, unit, focal length, half a pixel) explains \
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
                "consistency unknown: {} pixels that rest were followed, by {:.2} px on average; that is too little to tell",
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
                Some(px) => write!(f, "; {px:.2} px before it was put right")?,
                None => f.write_str("; behind a camera before it was put right")?,
            }
        }
        Ok(())
    }
}
