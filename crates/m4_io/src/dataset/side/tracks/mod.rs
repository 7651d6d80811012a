//! Point trajectories from an npz archive of a tracker, as positions in the world.

mod arrays;
mod cameras;
mod lift;

use crate::dataset::files::npy::open_npz;
use crate::dataset::{ListedFrame, SourceErrorCause};
use arrays::Read;
use m4_core::{Progress, Tracks};
use std::path::Path;

/// From which number on a visibility that is no boolean counts as seen. TAPIP3D writes booleans that it compared with 0.9 itself.
const SEEN: f64 = 0.5;

/// Reads the tracks of the clip `frames`, one frame of the file for each. The tracker that wrote it is recognised by the names in it:
///
/// ```text
/// coords [n][k][3] + visibs             places in the world whose cameras `extrinsics` [n][4][4] are (world to camera); without
///                                       them in the world of `frames`
/// tracks | pred_tracks [n][k][3]        pixels and z-depth of the camera
/// tracks | pred_tracks [n][k][2]        pixels; depth is looked up in that of `frames`
/// visibs | visibility | pred_visibility [n][k] or [n][k][1]
/// colors [k][3]                         optional, 8 bits
/// video  [n][h][w][3] or [n][3][h][w]   optional: pixels are of this size; without it of the size of the images
/// ```
///
/// All may have a first dimension of 1. Places of a world with another scale than that of `frames` are scaled by how far
/// the cameras moved, which is reported through `progress`.
///
/// # Errors
///
/// [`SourceErrorCause`]: names, shapes or counts that do not fit, or no depth to look up.
pub fn read_tracks(
    path: &Path,
    frames: &[ListedFrame],
    limit_bytes: u64,
    progress: &dyn Progress,
) -> Result<Tracks, SourceErrorCause> {
    let n = frames.len();
    let mut read = Read::new(open_npz(path)?, n, limit_bytes);
    let (key, places) = read.one_of(&["coords", "tracks", "pred_tracks"])?.ok_or_else(|| {
        let what = format!("coords, tracks or pred_tracks (there are: {})", read.names());
        SourceErrorCause::missing(what, "give an npz file of TAPIP3D, SpatialTracker or CoTracker")
    })?;
    let (k, columns) = (places.second, places.third);
    let xyz = match (key, columns) {
        ("coords", 3) => {
            let mut xyz = places.values;
            if let Some(cameras) = read.cameras("extrinsics")? {
                cameras::to_our_world(&mut xyz, k, &cameras, frames, progress);
            }
            xyz
        }
        ("tracks" | "pred_tracks", 2 | 3) => {
            let size = read.video_size()?;
            lift::lift(&places, frames, size, progress)?
        }
        _ => {
            let what = format!("{key} has {columns} numbers per point; 3, or 2 for pixels, were expected");
            return Err(SourceErrorCause::bad(what, "save the tracks of one clip"));
        }
    };
    let (_, seen) = read
        .one_of(&["visibs", "visibility", "pred_visibility"])?
        .ok_or_else(|| SourceErrorCause::missing("visibs or visibility", "save which points were seen"))?;
    if (seen.second, seen.third) != (k, 1) {
        let what = format!("visibility of {} points for {k} tracks", seen.second * seen.third);
        return Err(SourceErrorCause::bad(what, "save one for each track and frame"));
    }
    let colours = read.colours(k)?;
    let place = |p: &[f64; 3]| {
        let known = p.iter().all(|v| v.is_finite() && v.abs() < f64::from(f32::MAX));
        if known { p.map(|v| v as f32) } else { [f32::NAN; 3] }
    };
    let xyz = xyz.as_chunks::<3>().0.iter().map(place).collect();
    let visible = seen.values.iter().map(|&v| v > SEEN).collect();
    let wrong = |e: m4_core::ShapeError| SourceErrorCause::bad(e.to_string(), "save the tracks again");
    let tracks = Tracks::new(n, k, xyz, visible).map_err(wrong)?;
    match colours {
        Some(rgb) => tracks.with_colours(rgb).map_err(wrong),
        None => Ok(tracks),
    }
}
