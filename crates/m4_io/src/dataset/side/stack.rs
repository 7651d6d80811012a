//! Maps of all frames in one array of an npz archive.

use crate::dataset::files::npy::{array_error, array_of, is_float, open_npz, present};
use crate::dataset::{SourceErrorCause, step};
use m4_core::Progress;
use std::path::Path;

/// What is known of a stack while its maps are read.
pub(crate) struct Stack {
    pub width: usize,
    pub height: usize,
    /// Whether its numbers are integers or booleans.
    pub whole_numbers: bool,
}

impl Stack {
    /// Reads the array that has one of the names `keys`, `[frames][h][w]` or `[frames][h][w][1]`, map by map.
    pub(crate) fn open<T>(
        path: &Path,
        keys: &[&str],
        frames: usize,
        limit_bytes: u64,
        progress: &dyn Progress,
        one: impl Fn(&Self, Vec<f64>) -> Result<T, SourceErrorCause>,
    ) -> Result<Vec<T>, SourceErrorCause> {
        let mut npz = open_npz(path)?;
        let Some(key) = present(&npz, keys) else {
            let what = format!("an array named {} (there are: {})", keys.join(" or "), npz.names());
            return Err(SourceErrorCause::missing(what, "save the maps under such a name"));
        };
        // both a map and its copy in the capture
        let mut array = array_of(&mut npz, key, limit_bytes / 4)?;
        let (n, height, width) = match array.shape[..] {
            [n, h, w] | [n, h, w, 1] => (n, h, w),
            _ => {
                let what = format!(
                    "{key} has shape {:?}; [frames, height, width] was expected",
                    array.shape
                );
                return Err(SourceErrorCause::bad(what, "save one map per frame"));
            }
        };
        if n != frames {
            let what = format!("{key} has {n} maps for {frames} training frames");
            return Err(SourceErrorCause::bad(what, "give one map for each training frame"));
        }
        if width == 0 || height == 0 {
            return Err(SourceErrorCause::bad(
                format!("{key} has maps of {width} x {height} pixels"),
                "save them again",
            ));
        }
        let stack = Self {
            width,
            height,
            whole_numbers: !is_float(&array),
        };
        let mut maps = Vec::new();
        for i in 0..n {
            step("read maps", i, n, progress)?;
            let values = array.next_f64(width * height).map_err(|e| array_error(key, e))?;
            maps.push(one(&stack, values)?);
        }
        array.end().map_err(|e| array_error(key, e))?;
        Ok(maps)
    }
}
