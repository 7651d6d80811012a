//! Ballistic prior: between two contacts the centre of an object moves along a parabola, with one acceleration for all
//! objects.
//!
//! ```text
//! tracklets -> observation: where the middle of a part is seen, and in which frames all of the part is
//!           -> rate: the acceleration, first from the estimated depth of the parts
//!           -> flight: stretches of frames on one parabola (parabola: the fit)  <-.
//!           -> rate: from how the camera moved, and from the ground that nothing falls through --'
//!           -> depth by frame
//! ```
//!
//! The rays to an object on a parabola `p + u t + g t^2 / 2` say where it is once `g` is known: every frame gives two
//! linear equations for the six unknowns of `p` and `u`. Down is the normal of the ground; how fast things fall, in the
//! unit of the cameras, is one number for the whole clip. Needs no size and no shape, but a ground, and a way that bends.

mod flight;
mod observation;
mod parabola;
mod rate;

use super::ground::Ground;
use super::{Clip, Tracklet};
use flight::Flight;
use m4_core::{Camera, quantile};
use observation::Observation;

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
            observations: observation::observations(clip, t),
            depth,
        })
        .collect();
    let mut g = rate::first(&objects, ground)?;
    let mut flights = Vec::new();
    for _ in 0..ROUNDS {
        flights = flight::find(&objects, ground, g);
        if flights.iter().flatten().map(Flight::frames).sum::<usize>() < EVIDENCE {
            return None;
        }
        g = rate::settle(&objects, &flights, ground)?;
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
    Some(
        objects
            .iter()
            .zip(&flights)
            .map(|(object, f)| along(object, f))
            .collect(),
    )
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
