//! Timestamps of poses to those of files.

use crate::core::{ReadSourceError, SourceFault};
use crate::files::{Inside, below, text};
use std::path::{Path, PathBuf};

/// Farthest that two moments of one frame are apart, seconds: that of the benchmark's `associate.py`.
const MAX_APART_S: f64 = 0.02;

/// Files with the second of each, in order of time.
#[derive(Debug)]
pub struct Stamped(Vec<(f64, PathBuf)>);

impl Stamped {
    /// Reads `rgb.txt` or `depth.txt`; names are below the folder of the list, and lead to nothing else.
    pub fn read(list: &Path, inside: &Inside) -> Result<Self, ReadSourceError> {
        let folder = list.parent().unwrap_or(Path::new(""));
        let mut all = Vec::new();
        for (i, line) in text(list)?.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let at = |fault: SourceFault| fault.within(list, format!("line {}", i + 1));
            let parsed = line.split_once([' ', '\t']);
            let parsed = parsed.and_then(|(time, name)| Some((time.parse::<f64>().ok()?, name.trim())));
            let (time, name) = parsed.filter(|(time, _)| time.is_finite()).ok_or_else(|| {
                at(SourceFault::bad(
                    format!("{line:?} is no timestamp with a file"),
                    "give the list of the data set",
                ))
            })?;
            let file = below(folder, name).and_then(|file| inside.check(file));
            all.push((time, file.map_err(at)?));
        }
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(Self(all))
    }

    /// The files and their seconds, in order.
    pub fn all(&self) -> &[(f64, PathBuf)] {
        &self.0
    }

    /// The file that is nearest to a moment, if one is near enough.
    pub fn at(&self, time: f64) -> Option<&Path> {
        nearest(&self.0, |(t, _)| *t, time).map(|k| self.0[k].1.as_path())
    }
}

/// Which of `all`, in order of time, is nearest to a moment, if one is near enough.
pub fn nearest<T>(all: &[T], time_of: impl Fn(&T) -> f64, time: f64) -> Option<usize> {
    let after = all.partition_point(|one| time_of(one) < time);
    let near = [after.checked_sub(1), Some(after)];
    let apart = |k: usize| all.get(k).map(|one| (time_of(one) - time).abs());
    let candidates = near.into_iter().flatten().filter_map(|k| Some((apart(k)?, k)));
    let (apart, k) = candidates.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (apart <= MAX_APART_S).then_some(k)
}
