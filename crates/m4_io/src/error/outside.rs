//! A file that a data set may not name.

use super::shortened;
use m4_core::advice::OUTSIDE;
use std::path::PathBuf;

/// A file of a data set that lies elsewhere.
#[derive(Debug, thiserror::Error)]
#[error(
    "{}{} is outside of {}, and may be a private file that the result would reveal; put a copy into \
     the folder, or, if you trust the data set, {}",
    shortened(path.display()),
    if path == real { String::new() } else { format!(", which is {},", shortened(real.display())) },
    shortened(folder.display()),
    OUTSIDE
)]
#[non_exhaustive]
pub struct OutsideError {
    /// The file as it is named.
    pub path: PathBuf,
    /// Where it lies, links followed.
    pub real: PathBuf,
    /// The folder that it should lie in.
    pub folder: PathBuf,
}
