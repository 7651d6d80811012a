//! DAVIS: clips without poses, `ROOT/JPEGImages/RESOLUTION/NAME/00000.jpg`, 24 frames per second,
//! whose annotated objects lie in `ROOT/Annotations/RESOLUTION/NAME`. Geometry is estimated from
//! the images; a listing is of posed frames.

use std::path::Path;

/// Whether a folder is that of the images of a clip.
#[must_use]
pub fn detect(path: &Path) -> bool {
    let resolution = path.parent().and_then(Path::parent);
    path.is_dir()
        && resolution
            .and_then(Path::file_name)
            .is_some_and(|name| name == "JPEGImages")
}
