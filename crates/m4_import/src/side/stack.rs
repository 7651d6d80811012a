//! Maps of all frames in one array of an npz archive.

use crate::core::SourceFault;
use crate::files::array_fault;
use m4_io::npy::{Npz, Number};
use m4_scene::Progress;
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
        one: impl Fn(&Self, &[f64]) -> Result<T, SourceFault>,
    ) -> Result<Vec<T>, SourceFault> {
        let mut npz = open_npz(path)?;
        let Some(key) = present(&mut npz, keys, limit_bytes)? else {
            let what = format!("an array named {} (there are: {})", keys.join(" or "), npz.names());
            return Err(SourceFault::missing(what, "save the maps under such a name"));
        };
        // both a map and its copy in the capture
        let array = npz.array(key, limit_bytes / 4).map_err(|e| array_fault(key, e))?;
        let Some(mut array) = array else {
            return Err(SourceFault::missing(key, "save it"));
        };
        let (n, height, width) = match array.shape[..] {
            [n, h, w] | [n, h, w, 1] => (n, h, w),
            _ => {
                let what = format!(
                    "{key} has shape {:?}; [frames, height, width] was expected",
                    array.shape
                );
                return Err(SourceFault::bad(what, "save one map a frame"));
            }
        };
        if n != frames {
            let what = format!("{key} has {n} maps for {frames} training frames");
            return Err(SourceFault::bad(what, "give one map for each training frame"));
        }
        if width == 0 || height == 0 {
            return Err(SourceFault::bad(
                format!("{key} has maps of {width} x {height} pixels"),
                "save them again",
            ));
        }
        let stack = Self {
            width,
            height,
            whole_numbers: !matches!(array.number, Number::F16 | Number::F32 | Number::F64),
        };
        let mut maps = Vec::new();
        for i in 0..n {
            if progress.cancelled() {
                return Err(SourceFault::Cancelled);
            }
            progress.update("read maps", i + 1, n, "");
            let values = array.next_f64(width * height).map_err(|e| array_fault(key, e))?;
            maps.push(one(&stack, &values)?);
        }
        array.end().map_err(|e| array_fault(key, e))?;
        Ok(maps)
    }
}

/// An archive of arrays.
pub(crate) fn open_npz(path: &Path) -> Result<Npz, SourceFault> {
    Npz::open(path)?.map_err(|e| {
        let what = format!("it is no npz archive, or a damaged one ({e})");
        SourceFault::bad(what, "save it again with numpy")
    })
}

/// The first of `keys` that the archive has.
pub(crate) fn present<'k>(npz: &mut Npz, keys: &[&'k str], limit_bytes: u64) -> Result<Option<&'k str>, SourceFault> {
    for &key in keys {
        if npz.array(key, limit_bytes).map_err(|e| array_fault(key, e))?.is_some() {
            return Ok(Some(key));
        }
    }
    Ok(None)
}
