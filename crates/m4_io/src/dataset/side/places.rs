//! Places of tracks in the world of a clip: from a world with its own cameras, or from pixels and depth.

use super::tracks::Numbers;
use crate::Fault;
use crate::dataset::{Distortion, Lens, ListedFrame, step};
use m4_core::nalgebra::Vector3;
use m4_core::{CompactDepth, Progress, Se3};

/// Ratio of scales that is taken for rounding.
const SAME_SCALE_WITHIN: f64 = 1e-3;
/// A camera moves when its places spread by this share of how far the points are.
const MOVES_FROM: f64 = 1e-3;

/// Places `[frames][tracks][3]` through `w2c`, one per frame, to the world of `frames`.
///
/// Each place is seen from its frame's camera there, scaled, and put before our camera. The scale is how far our cameras spread over how
/// far those spread; 1 where either is static.
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

/// Places `[frames][tracks][3]` of `[frames][tracks][2]` pixels (centre of the first: 0, 0), whose depth is looked up, or `[3]`: pixels and
/// z-depth. Pixels are of images of `size`, or of those of the frames. NaN where depth is not known.
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
