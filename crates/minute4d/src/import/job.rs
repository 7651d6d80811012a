//! The options of an import.

use super::ImportFormat;
use crate::folder::Existing;
use m4_io::dataset::ImportOptions;

/// What to import, and what its files do not say.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportJob {
    /// The format; `None` for what the name or the files of a folder say.
    pub format: Option<ImportFormat>,
    /// What to do with a folder that holds something.
    pub existing: Existing,
    /// Of captures.
    pub options: ImportOptions,
    /// Compare cameras and depth of a capture with the flow of its images.
    pub check: bool,
    /// Put right what that finds.
    pub fix: bool,
}

impl ImportJob {
    /// Everything as the files say.
    #[must_use]
    pub fn new(format: Option<ImportFormat>) -> Self {
        Self {
            format,
            existing: Existing::Refuse,
            options: ImportOptions::default(),
            check: true,
            fix: false,
        }
    }

    /// An option that has a meaning for captures alone and was given.
    pub(super) fn of_captures(&self) -> Option<&'static str> {
        let (o, d) = (&self.options, ImportOptions::default());
        let given = [
            ("--fps", o.fps != d.fps),
            ("--tau-motion", o.tau_motion != d.tau_motion),
            ("--motion-prob", o.motion.is_some()),
            ("--images", o.images != d.images),
            ("--depth", o.depth != d.depth),
            ("--depth-unit", o.depth_unit != d.depth_unit),
            ("--masks", o.masks != d.masks),
            ("--invert-masks", o.invert_masks != d.invert_masks),
            ("--tracks", o.tracks != d.tracks),
            ("--axes", o.axes != d.axes),
            ("--factor", o.factor != d.factor),
            ("--allow-outside", o.reach != d.reach),
            ("--fix", self.fix),
            ("--no-check", !self.check),
        ];
        given.into_iter().find(|(_, is_given)| *is_given).map(|(name, _)| name)
    }
}
