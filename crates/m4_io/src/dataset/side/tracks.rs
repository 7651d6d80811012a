//! Point trajectories from an npz archive of a tracker, as positions in the world.

use crate::dataset::{Distortion, Lens, ListedFrame, step};
use crate::npy::{Npz, Number};
use crate::{Fault, pose};
use m4_core::nalgebra::Vector3;
use m4_core::{CompactDepth, Progress, Se3, Tracks};
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
/// Errors: names, shapes or counts that do not fit, or no depth to look up.
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
            return Err(Fault::bad(format!("{key} are matrices of {second} x {third}; 4 x 4 were expected"), HINT));
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

/// Ratio of scales that is taken for rounding.
const SAME_SCALE_WITHIN: f64 = 1e-3;
/// A camera moves when its places spread by this share of how far the points are.
const MOVES_FROM: f64 = 1e-3;

/// Places `[frames][tracks][3]` through `w2c`, one per frame, to the world of `frames`.
///
/// Each place is seen from its frame's camera there, scaled, and put before our camera. The scale is how far our cameras
/// spread over how far those spread; 1 where either is static.
pub(super) fn to_our_world(
    xyz: &mut [f64],
    tracks: usize,
    w2c: &[Se3<f64>],
    frames: &[ListedFrame],
    progress: &dyn Progress,
) {
    let theirs: Vec<Se3<f64>> = w2c.iter().map(Se3::inverse).collect();
    let scale = scale(&theirs, frames, xyz);
    if (scale - 1.0).abs() > 0.0 {
        progress.warn(&format!(
            "the tracks are of a world whose cameras moved {:.4} times as far as those of the clip; they are scaled",
            1.0 / scale
        ));
    }
    if tracks == 0 {
        return;
    }
    for ((row, w2c), frame) in xyz.chunks_exact_mut(3 * tracks).zip(w2c).zip(frames) {
        for place in row.as_chunks_mut::<3>().0 {
            let seen = w2c.transform(&Vector3::from(*place)) * scale;
            *place = frame.c2w.transform(&seen).into();
        }
    }
}

fn scale(theirs: &[Se3<f64>], frames: &[ListedFrame], xyz: &[f64]) -> f64 {
    let centres: Vec<Vector3<f64>> = theirs.iter().map(|c| c.translation).collect();
    let ours: Vec<Vector3<f64>> = frames.iter().map(|f| f.c2w.translation).collect();
    let (a, b) = (spread(&centres), spread(&ours));
    let places: Vec<Vector3<f64>> =
        xyz.as_chunks::<3>().0.iter().map(|p| Vector3::from(*p)).filter(|p| p.iter().all(|v| v.is_finite())).collect();
    let far = centres
        .first()
        .map_or(0.0, |c| places.iter().map(|p| (p - c).norm()).sum::<f64>() / places.len().max(1) as f64);
    let ratio = b / a;
    if a <= MOVES_FROM * far || !ratio.is_finite() || ratio <= 0.0 || (ratio - 1.0).abs() < SAME_SCALE_WITHIN {
        return 1.0;
    }
    ratio
}

/// Root of the mean square distance from the mean.
fn spread(places: &[Vector3<f64>]) -> f64 {
    let n = places.len().max(1) as f64;
    let mean = places.iter().sum::<Vector3<f64>>() / n;
    (places.iter().map(|p| (p - mean).norm_squared()).sum::<f64>() / n).sqrt()
}

/// Steps of the search for the ray of a distorted pixel, and how far from it the search may end, pixels of a focal length of 1.
const STEPS: usize = 100;
const FOUND_WITHIN: f64 = 1e-6;

/// Places `[frames][tracks][3]` of `[frames][tracks][2]` pixels (centre of the first: 0, 0), whose depth is looked up, or
/// `[3]`: pixels and z-depth. Pixels are of images of `size`, or of those of the frames. NaN where depth is not known.
pub(super) fn lift(
    tracks: &Numbers,
    frames: &[ListedFrame],
    size: Option<(usize, usize)>,
    progress: &dyn Progress,
) -> Result<Vec<f64>, Fault> {
    let columns = tracks.third;
    let mut out = Vec::with_capacity(tracks.values.len() / columns.max(1) * 3);
    let rows = tracks.values.chunks(tracks.second.max(1) * columns);
    for (i, (row, frame)) in rows.zip(frames).enumerate() {
        step("lift tracks", i, frames.len(), progress)?;
        let k = &frame.lens.intrinsics;
        let (w, h) = size.unwrap_or((k.width, k.height));
        let (sx, sy) = (k.width as f64 / w as f64, k.height as f64 / h as f64);
        let depth = match (&frame.depth, columns) {
            (_, 3) => None,
            (Some(depth), _) => Some(depth.get()?),
            (None, _) => {
                let what = format!("tracks in pixels, and no depth of frame {} to lift them with", frame.name);
                return Err(Fault::bad(what, "give depth maps too, or tracks in space"));
            }
        };
        for place in row.chunks_exact(columns) {
            // corner-based, of the stored image
            let (u, v) = ((place[0] + 0.5) * sx, (place[1] + 0.5) * sy);
            let z = match &depth {
                Some(map) => at(map, u / k.width as f64, v / k.height as f64),
                None => place[2],
            };
            let ray = ray(&frame.lens, u, v).filter(|_| z.is_finite() && z > 0.0);
            match ray {
                Some([x, y]) => out.extend(frame.c2w.transform(&Vector3::new(x * z, y * z, z)).iter()),
                None => out.extend([f64::NAN; 3]),
            }
        }
    }
    Ok(out)
}

/// Depth at a share of width and height, 0 outside.
fn at(map: &CompactDepth, x: f64, y: f64) -> f64 {
    let (w, h) = map.size();
    if !((0.0..1.0).contains(&x) && (0.0..1.0).contains(&y)) {
        return 0.0;
    }
    let (x, y) = ((x * w as f64) as usize, (y * h as f64) as usize);
    f64::from(map.at(x.min(w - 1), y.min(h - 1)))
}

/// Pinhole coordinates of what a pixel of the stored image shows; `None` where the lens has none.
fn ray(lens: &Lens, u: f64, v: f64) -> Option<[f64; 2]> {
    let k = &lens.intrinsics;
    let (bx, by) = ((u - k.cx) / k.fx, (v - k.cy) / k.fy);
    if lens.distortion == Distortion::None {
        return Some([bx, by]);
    }
    let (mut x, mut y) = (bx, by);
    for _ in 0..STEPS {
        let [dx, dy] = lens.distortion.distorted(x, y);
        (x, y) = (x + (bx - dx), y + (by - dy));
    }
    let [dx, dy] = lens.distortion.distorted(x, y);
    ((dx - bx).hypot(dy - by) < FOUND_WITHIN).then_some([x, y])
}

#[cfg(test)]
mod tests {
    use super::ray;
    use crate::dataset::{Distortion, Lens};
    use m4_core::Intrinsics;

    #[test]
    fn undistorted_rays_project_to_their_pixel() {
        let intrinsics = Intrinsics::centred(120, 80, 100.0);
        let distortion = Distortion::brown(-0.2, 0.05, 0.0, 0.002, -0.003);
        let lens = Lens { intrinsics, distortion };
        for (u, v) in [(0.5, 0.5), (60.0, 40.0), (119.0, 3.0)] {
            let [x, y] = ray(&lens, u, v).unwrap();
            let [dx, dy] = distortion.distorted(x, y);
            assert!((dx * 100.0 + 60.0 - u).abs() < 1e-3 && (dy * 100.0 + 40.0 - v).abs() < 1e-3);
            let straight = ray(&Lens::pinhole(intrinsics), u, v).unwrap();
            assert!((straight[0] - (u - 60.0) / 100.0).abs() < 1e-12);
        }
        // 1 - 40 r^2 turns back: nothing lands in the corner
        let folds = Lens { intrinsics, distortion: Distortion::brown(-40.0, 0.0, 0.0, 0.0, 0.0) };
        assert_eq!(ray(&folds, 0.5, 0.5), None);
    }
}
