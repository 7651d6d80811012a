//! Held-out views by the names of their files.

use super::EXTENSIONS;
use crate::dataset::files::{listed, stem};
use crate::dataset::{ReadSourceError, SourceErrorCause};
use std::path::{Path, PathBuf};

pub(super) struct View {
    pub file: PathBuf,
    pub camera: usize,
    pub time: usize,
}

/// All of them, none where there is no folder of such; `n` cameras and moments.
pub(super) fn read(root: &Path, n: usize) -> Result<Vec<View>, ReadSourceError> {
    let flat = ["gt", "test"].map(|name| root.join(name));
    if let Some(folder) = flat.iter().find(|p| p.is_dir()) {
        let files = listed(folder, EXTENSIONS)?;
        let views = files.into_iter().filter_map(|file| {
            let (camera, time) = by_name(&stem(&file))?;
            Some(checked(View { file, camera, time }, n))
        });
        return views.collect();
    }
    let folder = root.join("mv_images");
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let mut moments = Vec::new();
    for entry in std::fs::read_dir(&folder).map_err(|e| SourceErrorCause::Io(e).at(&folder))? {
        let path = entry.map_err(|e| SourceErrorCause::Io(e).at(&folder))?.path();
        if let (true, Ok(time)) = (path.is_dir(), stem(&path).parse::<usize>()) {
            moments.push((time, path));
        }
    }
    moments.sort();
    let mut views = Vec::new();
    for (time, moment) in moments {
        let files = listed(&moment, EXTENSIONS)?;
        // of the cameras around, in turn, one took the training image
        let cameras = files.len().max(1);
        for file in files {
            let number = stem(&file).strip_prefix("cam").and_then(|n| n.parse::<usize>().ok());
            let Some(camera) = number.and_then(|n| n.checked_sub(1)) else {
                let what = "its name is not camNN, the number of a camera from 1";
                return Err(SourceErrorCause::bad(what, "name the views as NSFF does").at(&file));
            };
            if camera != time % cameras {
                views.push(checked(View { file, camera, time }, n)?);
            }
        }
    }
    Ok(views)
}

/// `vCCC_tTTT`.
fn by_name(name: &str) -> Option<(usize, usize)> {
    let (camera, time) = name.strip_prefix('v')?.split_once("_t")?;
    Some((camera.parse().ok()?, time.parse().ok()?))
}

fn checked(view: View, n: usize) -> Result<View, ReadSourceError> {
    if view.camera < n && view.time < n {
        return Ok(view);
    }
    let what = format!(
        "camera {} at time {} where there are {n} cameras and moments",
        view.camera, view.time
    );
    Err(SourceErrorCause::bad(what, "give views of the cameras in poses_bounds.npy").at(&view.file))
}
