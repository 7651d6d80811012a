//! What a frame shows of a part: where its middle is, and whether all of it is seen.

use super::super::{Clip, Tracklet};
use nalgebra::{Vector2, Vector3};

/// A part of less than this share of what it was in the frames around is half hidden.
const WHOLE: f64 = 0.75;
/// How many frames around are looked at, on each side.
const AROUND: usize = 4;
/// A part that shares more than this of its edge with another may be behind it.
const SHARED: f64 = 0.08;

/// What one frame shows of a part.
pub(super) struct Observation {
    /// Two directions in the world, across the ray to the middle: their product with what leads from the camera to a
    /// point of depth 1 is how far the point is seen from the middle, pixels at the working size.
    pub across: [Vector3<f64>; 2],
    /// Of a disc of the same area, over the focal length.
    pub radius: f64,
    /// The same in pixels.
    pub radius_px: f64,
    /// All of the part is in the image and nothing is in front of it, as far as one can tell.
    pub whole: bool,
}

/// By frame of the tracklet.
pub(super) fn observations(clip: &Clip<'_>, tracklet: &Tracklet) -> Vec<Observation> {
    let area: Vec<f64> = tracklet.parts.iter().map(|p| p.len() as f64).collect();
    let mut own = vec![false; clip.width * clip.height];
    (0..area.len())
        .map(|k| {
            let camera = &clip.cameras[tracklet.first + k];
            let lens = &camera.intrinsics;
            let outline = outline(clip, tracklet, k, &mut own);
            let around = &area[k.saturating_sub(AROUND)..(k + AROUND + 1).min(area.len())];
            let usual = around.iter().copied().fold(0.0, f64::max);
            let radius_px = (area[k] / std::f64::consts::PI).sqrt();
            let [u, v] = [outline.middle.x + 0.5, outline.middle.y + 0.5];
            Observation {
                across: [
                    camera.c2w.rotation * Vector3::new(lens.fx, 0.0, lens.cx - u),
                    camera.c2w.rotation * Vector3::new(0.0, lens.fy, lens.cy - v),
                ],
                radius: radius_px / lens.fx,
                radius_px,
                whole: outline.clear && area[k] > WHOLE * usual,
            }
        })
        .collect()
}

struct Outline {
    /// Pixel coordinates of its middle.
    middle: Vector2<f64>,
    /// It touches neither the border of the image nor, for long, another part.
    clear: bool,
}

/// `own` is room to work in, all false before and after.
fn outline(clip: &Clip<'_>, tracklet: &Tracklet, k: usize, own: &mut [bool]) -> Outline {
    let (w, h) = (clip.width, clip.height);
    let (pixels, moving) = (&tracklet.parts[k], &clip.moving[tracklet.first + k]);
    for &p in pixels {
        own[p as usize] = true;
    }
    let (mut sum, mut border) = (Vector2::zeros(), false);
    let (mut edge, mut shared) = (0usize, 0usize);
    for &p in pixels {
        let p = p as usize;
        let (x, y) = (p % w, p / w);
        sum += Vector2::new(x as f64, y as f64);
        if x < 2 || y < 2 || x + 3 > w || y + 3 > h {
            border = true;
            continue;
        }
        let next = [p - 1, p + 1, p - w, p + w];
        edge += usize::from(next.iter().any(|&n| !own[n]));
        shared += usize::from(next.iter().any(|&n| !own[n] && moving[n] > 0));
    }
    for &p in pixels {
        own[p as usize] = false;
    }
    Outline {
        middle: sum / pixels.len().max(1) as f64,
        clear: !border && (shared as f64) < SHARED * edge as f64,
    }
}
