//! Point trajectories from an npz archive of a tracker, as positions in the world.

use super::places::{lift, to_our_world};
use crate::dataset::ListedFrame;
use crate::npy::{Npz, Number};
use crate::{Fault, pose};
use m4_core::{Progress, Se3, Tracks};
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
/// [`Fault`]: names, shapes or counts that do not fit, or no depth to look up.
pub fn read_tracks(
    path: &Path,
    frames: &[ListedFrame],
    limit_bytes: u64,
    progress: &dyn Progress,
) -> Result<Tracks, Fault> {
    let n = frames.len();
    let mut read = Read::new(Npz::open(path)?, n, limit_bytes);
    let (key, places) = read.one_of(&["coords", "tracks", "pred_tracks"])?.ok_or_else(|| {
        let what = format!("coords, tracks or pred_tracks (there are: {})", read.names());
        Fault::missing(what, "give an npz file of TAPIP3D, SpatialTracker or CoTracker")
    })?;
    let (k, columns) = (places.second, places.third);
    let xyz = match (key, columns) {
        ("coords", 3) => {
            let mut xyz = places.values;
            if let Some(cameras) = read.cameras("extrinsics")? {
                to_our_world(&mut xyz, k, &cameras, frames, progress);
            }
            xyz
        }
        ("tracks" | "pred_tracks", 2 | 3) => {
            let size = read.video_size()?;
            lift(&places, frames, size, progress)?
        }
        _ => {
            let what = format!("{key} has {columns} numbers per point; 3, or 2 for pixels, were expected");
            return Err(Fault::bad(what, "save the tracks of one clip"));
        }
    };
    let (_, seen) = read
        .one_of(&["visibs", "visibility", "pred_visibility"])?
        .ok_or_else(|| Fault::missing("visibs or visibility", "save which points were seen"))?;
    if (seen.second, seen.third) != (k, 1) {
        let what = format!("visibility of {} points for {k} tracks", seen.second * seen.third);
        return Err(Fault::bad(what, "save one for each track and frame"));
    }
    let colours = read.colours(k)?;
    let place = |p: &[f64; 3]| {
        let known = p.iter().all(|v| v.is_finite() && v.abs() < f64::from(f32::MAX));
        if known { p.map(|v| v as f32) } else { [f32::NAN; 3] }
    };
    let xyz = xyz.as_chunks::<3>().0.iter().map(place).collect();
    let visible = seen.values.iter().map(|&v| v > SEEN).collect();
    let wrong = |e: m4_core::ShapeError| Fault::bad(e.to_string(), "save the tracks again");
    let tracks = Tracks::new(n, k, xyz, visible).map_err(wrong)?;
    match colours {
        Some(rgb) => tracks.with_colours(rgb).map_err(wrong),
        None => Ok(tracks),
    }
}

const HINT: &str = "give the tracks of this clip, one frame for each training frame";

/// Numbers `[frames][second][third]`.
pub(super) struct Numbers {
    pub second: usize,
    pub third: usize,
    pub values: Vec<f64>,
}

/// An archive and what its arrays must fit.
struct Read {
    npz: Npz,
    frames: usize,
    limit_bytes: u64,
}

impl Read {
    fn new(npz: Npz, frames: usize, limit_bytes: u64) -> Self {
        Self {
            npz,
            frames,
            // in memory numbers take 8 bytes, in the file 1 at least
            limit_bytes: limit_bytes / 8,
        }
    }

    /// What the archive holds, for messages.
    fn names(&self) -> String {
        self.npz.names()
    }

    /// The first of `keys` that is there, `[frames][..][..]` or with a dimension of 1 before; two dimensions stand for a last one of 1.
    fn one_of<'k>(&mut self, keys: &[&'k str]) -> Result<Option<(&'k str, Numbers)>, Fault> {
        let Some(key) = self.npz.first_of(keys) else {
            return Ok(None);
        };
        Ok(Some((key, self.numbers(key)?)))
    }

    fn numbers(&mut self, key: &str) -> Result<Numbers, Fault> {
        let array = self.npz.need(key, self.limit_bytes)?;
        let frames = self.frames;
        let (second, third) = match array.shape[..] {
            [n, k, c] | [1, n, k, c] if n == frames => (k, c),
            [n, k] if n == frames => (k, 1),
            [1, n, k] if n == frames => (k, 1),
            _ => {
                let what = format!("{key} has shape {:?} where {frames} frames were expected", array.shape);
                return Err(Fault::bad(what, HINT));
            }
        };
        let values = array.numbers()?.values;
        Ok(Numbers { second, third, values })
    }

    /// One pose per frame.
    fn cameras(&mut self, key: &str) -> Result<Option<Vec<Se3<f64>>>, Fault> {
        if !self.npz.has(key) {
            return Ok(None);
        }
        let Numbers { second, third, values } = self.numbers(key)?;
        if !(3..=4).contains(&second) || third != 4 {
            let what = format!("{key} are matrices of {second} x {third}; 4 x 4 were expected");
            return Err(Fault::bad(what, HINT));
        }
        let pose = |(i, m): (usize, &[f64])| {
            // of 4x4 matrices the last row is ignored
            pose::of_matrix(&format!("{key} of frame {i}"), &m[..12])
        };
        let poses: Result<Vec<_>, _> = values.chunks_exact(4 * second).enumerate().map(pose).collect();
        poses.map(Some)
    }

    /// Width and height of the images that were followed, by the shape of `video`.
    fn video_size(&mut self) -> Result<Option<(usize, usize)>, Fault> {
        let array = self.npz.array("video", u64::MAX)?;
        let Some(array) = array else { return Ok(None) };
        match array.shape[..] {
            [_, h, w, 3] | [_, 3, h, w] | [1, _, h, w, 3] | [1, _, 3, h, w] if w > 0 && h > 0 => Ok(Some((w, h))),
            _ => {
                let what = format!("video has shape {:?}; [frames, height, width, 3] was expected", array.shape);
                Err(Fault::bad(what, HINT))
            }
        }
    }

    /// A colour per track.
    fn colours(&mut self, tracks: usize) -> Result<Option<Vec<[u8; 3]>>, Fault> {
        let array = self.npz.array("colors", self.limit_bytes)?;
        let Some(mut array) = array else { return Ok(None) };
        if array.shape != [tracks, 3] || array.number != Number::U8 {
            let what = format!("colors has shape {:?}; {tracks} colours of 8 bits were expected", array.shape);
            return Err(Fault::bad(what, HINT));
        }
        let bytes = array.next_bytes(3 * tracks)?;
        array.end()?;
        Ok(Some(bytes.as_chunks::<3>().0.to_vec()))
    }
}
