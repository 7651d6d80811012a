//! Checks that a source reads only files in its folder, and in those that the options name.

use crate::dataset::{ImportOptions, ReadSourceError, SourceErrorCause};
use crate::reach::Bounds;
use std::path::{Path, PathBuf};

/// The bounds of a source.
#[derive(Debug, Clone)]
pub(crate) struct Inside(Bounds);

impl Inside {
    /// Of the source in `folder` whose images may lie where the options say.
    pub(crate) fn of(folder: &Path, options: &ImportOptions) -> Self {
        Self(Bounds::new(options.reach, folder, options.images.as_deref()))
    }

    /// Of what the user named beside the source: files in the folder `named`, or that file.
    pub(crate) fn named(named: &Path, options: &ImportOptions) -> Self {
        Self(Bounds::new(options.reach, named, []))
    }

    /// The file, if it may be read or is missing.
    pub(crate) fn check<P: AsRef<Path>>(&self, file: P) -> Result<P, SourceErrorCause> {
        self.0.check(file.as_ref())?;
        Ok(file)
    }

    /// The same; the error names no other file.
    pub(crate) fn file(&self, file: PathBuf) -> Result<PathBuf, ReadSourceError> {
        match self.0.check(&file) {
            Ok(()) => Ok(file),
            Err(outside) => Err(SourceErrorCause::Outside(outside).at(&file)),
        }
    }

    /// Checks many files.
    pub(crate) fn files(&self, files: Vec<PathBuf>) -> Result<Vec<PathBuf>, ReadSourceError> {
        files.into_iter().map(|file| self.file(file)).collect()
    }
}
