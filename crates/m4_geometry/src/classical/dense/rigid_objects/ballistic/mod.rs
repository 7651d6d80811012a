//! Ballistic prior: between two contacts the centre of an object moves along a parabola, with one acceleration for all
//! objects.
//!
//! ```text
//! tracklets -> observations: where the middle of a part is seen, and in which frames all of the part is
//!           -> the acceleration, first from the estimated depth of the parts
//!           -> flight: stretches of frames on one parabola (parabola: the fit)  <-.
//!           -> the acceleration from how the camera moved, and from the ground that nothing falls through --'
//!           -> depth by frame
//! ```
//!
//! The rays to an object on a parabola `p + u t + g t^2 / 2` say where it is once `g` is known: every frame gives two
//! linear equations for the six unknowns of `p` and `u`. Down is the normal of the ground; how fast things fall, in the
//! unit of the cameras, is one number for the whole clip. Needs no size and no shape, but a ground, and a way that bends.

mod flight;
mod parabola;

use super::ground::Ground;
use super::{Clip, Tracklet};
use flight::Flight;
use m4_core::{Camera, quantile};
use nalgebra::{Vector2, Vector3};

/// Frames in flight that make a clip one in which things fall.
const EVIDENCE: usize = 16;
/// How often flights and the rate are found in turn.
const ROUNDS: usize = 3;
/// Flights of one part may differ by this factor in its size.
const RESIZED: f32 = 1.3;
/// The mean depth of what is seen of an object is nearer than its middle by this share of its radius: two thirds for a ball.
const BULGE: f64 = 0.6;

/// An object that may be in flight.
struct RigidObject<'a> {
    /// Of its frames.
    cameras: &'a [Camera],
    observations: Vec<Observation>,
    /// z-depth that it seems to have, by frame.
    depth: &'a [f64],
}

/// The depth of what flies, by part and frame: of what is seen of it, not of its middle. `None` where nothing flies.
///
/// `depth` is the z-depth that each part seems to have by frame, of which only the order of magnitude matters.
pub(super) fn depths(
    clip: &Clip<'_>,
    ground: &Ground,
    tracklets: &[&Tracklet],
    depth: &[Vec<f64>],
) -> Option<Vec<Vec<Option<f64>>>> {
    let objects: Vec<RigidObject<'_>> = tracklets
        .iter()
        .zip(depth)
        .map(|(t, depth)| RigidObject {
            cameras: &clip.cameras[t.first..t.first + t.parts.len()],
            observations: observations(clip, t),
            depth,
        })
        .collect();
    let mut g = flight::first_rate(&objects, ground)?;
    let mut flights = Vec::new();
    for _ in 0..ROUNDS {
        flights = flight::find(&objects, ground, g);
        if flights.iter().flatten().map(Flight::frames).sum::<usize>() < EVIDENCE {
            return None;
        }
        g = flight::settled_rate(&objects, &flights, ground)?;
    }
    let along = |object: &RigidObject<'_>, flights: &[Flight]| {
        let mut out = vec![None; object.depth.len()];
        if one_size(object, flights, ground, g) {
            for flight in flights {
                for (k, out) in out.iter_mut().enumerate().take(flight.end).skip(flight.first) {
                    let z = flight.parabola.depth(&object.cameras[k], k, ground, g);
                    *out = Some(z * (1.0 - BULGE * object.observations[k].radius));
                }
            }
        }
        out
    };
    Some(objects.iter().zip(&flights).map(|(object, f)| along(object, f)).collect())
}

/// Whether a part keeps its size from flight to flight; two things whose images touch may not.
fn one_size(object: &RigidObject<'_>, flights: &[Flight], ground: &Ground, g: f64) -> bool {
    let size = |flight: &Flight| {
        let mut all: Vec<f32> = (flight.first..flight.end)
            .filter(|&k| object.observations[k].whole)
            .map(|k| (object.observations[k].radius * flight.parabola.depth(&object.cameras[k], k, ground, g)) as f32)
            .collect();
        quantile(&mut all, 0.5)
    };
    let sizes: Vec<f32> = flights.iter().filter_map(size).collect();
    let least = sizes.iter().copied().fold(f32::INFINITY, f32::min);
    sizes.iter().all(|s| *s < RESIZED * least)
}

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
    Outline { middle: sum / pixels.len().max(1) as f64, clear: !border && (shared as f64) < SHARED * edge as f64 }
}
