//! Writes a folder with one PLY file per frame.

use super::write::{check, encode, seen, unheld};
use crate::scene::{Loss, WriteFileError, Written};
use m4_core::Scene;
use std::fs;
use std::path::Path;

/// Name of file `i` of a sequence: `frame_00012.ply`.
#[must_use]
pub fn frame_name(i: usize) -> String {
    format!("frame_{i:05}.ply")
}

/// Writes a file for each of `times` (frames) into `folder`, each atomically. Files of a longer
/// sequence that was there before are removed. `each` is called after every file, and may stop the work by
/// returning false; the files written until then stay.
///
/// # Errors
///
/// [`WriteFileError`] when the scene has values that are not finite, or the file system refuses.
pub fn write_sequence(
    folder: &Path,
    scene: &Scene,
    times: &[f64],
    mut each: impl FnMut(usize) -> bool,
) -> Result<Written, WriteFileError> {
    check(scene)?;
    let io = WriteFileError::io;
    fs::create_dir_all(folder).map_err(|e| io(folder, e))?;
    let mut written = Written {
        path: folder.to_path_buf(),
        bytes: 0,
        splats: 0,
        losses: Vec::new(),
    };
    for (i, &t) in times.iter().enumerate() {
        let path = folder.join(frame_name(i));
        let splats = seen(scene, t);
        let bytes = encode(&splats, t);
        crate::scene::file::publish(&path, &bytes).map_err(|e| io(&path, e))?;
        written.bytes += bytes.len() as u64;
        written.splats += splats.n();
        if !each(i + 1) {
            return Ok(written);
        }
    }
    for i in times.len().. {
        let path = folder.join(frame_name(i));
        if !path.is_file() {
            break;
        }
        fs::remove_file(&path).map_err(|e| io(&path, e))?;
    }
    if scene.splats.n_dynamic() > 0 {
        written
            .losses
            .push(Loss::Baked(format!("time, at {} instants", times.len())));
    }
    written.losses.extend(unheld(scene));
    Ok(written)
}
