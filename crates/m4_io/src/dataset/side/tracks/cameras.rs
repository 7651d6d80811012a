//! Transforms positions from a world with its own cameras to the world of a clip.

use crate::dataset::ListedFrame;
use m4_core::{Progress, Se3, nalgebra::Vector3};

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
    let places: Vec<Vector3<f64>> = xyz
        .as_chunks::<3>()
        .0
        .iter()
        .map(|p| Vector3::from(*p))
        .filter(|p| p.iter().all(|v| v.is_finite()))
        .collect();
    let far = centres.first().map_or(0.0, |c| {
        places.iter().map(|p| (p - c).norm()).sum::<f64>() / places.len().max(1) as f64
    });
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
