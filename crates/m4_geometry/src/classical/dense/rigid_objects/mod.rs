//! Depth of dynamic regions, part by part. Each part is taken for a rigid body: its motion relative
//! to the camera reveals its shape and how its distance changes, but not its size. Its size follows
//! from what it hides, where it touches the ground, and how it moves.
//!
//! ```text
//! masks, flow -> tracklet: one part through time; objects that touch in the image are separated by other frames
//!             -> edges: where its pixels are in other frames; silhouette: how near it is by its size
//!             -> rigid: dense bundle adjustment of camera against part (crate::dba), shape and distance up to scale;
//!                reversal: frames that took the mirror image are turned back
//!             -> pieces: the largest piece that is rigid, by the space of its paths; it is adjusted alone, and
//!                relief carries its shape on to the rest
//!             -> scale: the one number that is left
//!             -> ballistic: objects in flight share one acceleration
//! ```
//!
//! docs/spec/front-end.md 7.1, item 7, (a) contact and (b) rigid motion with unknown
//! scale.

mod ballistic;
mod edges;
mod flight;
mod ground;
mod hinge;
mod pieces;
mod relief;
mod residual;
mod reversal;
mod rigid;
mod scale;
mod shape;
mod silhouette;
mod subspace;
mod tracklet;
mod vote;

use super::sources::DenseError;
use super::working::{WorkingClip, each};
use crate::smooth::Smoother;
use flight::Flight;
use m4_core::{Progress, quantile};
use rayon::prelude::*;
use scale::Decision;
pub(super) use tracklet::{Tracklet, follow};
use vote::Vote;

/// Distance of the pixels that are adjusted, pixels at the working size.
const BLOCK_PX: usize = 4;
/// Regions smaller than this share of the image are not shaped.
const LEAST_SHARE: f32 = 0.002;
/// Shortest time that a region is followed, seconds, and fewest frames, which its adjustment needs
/// at any rate.
const SHORTEST_S: f64 = 0.2;
const FEWEST: usize = 5;
/// Flow whose round trip misses by more than this is not followed, pixels at the working size.
pub(super) const ROUND_TRIP_PX: f32 = 1.5;
/// A part may seem to lie behind what it hides by up to this factor of depth. Background that is
/// nearer still is not behind it but was filled in from a static occluder, and a scale that puts
/// the part farther still is wrong.
const OCCLUSION_RANGE: f32 = 1.2;
/// Strength of the edge-aware spreading, pixels squared (Min et al. 2014, lambda).
const FILL_LAMBDA: f32 = 100.0;

/// Fewest frames of a region.
fn shortest(clip: &WorkingClip<'_>) -> usize {
    clip.rate.frames(SHORTEST_S).max(FEWEST)
}

/// A part that was adjusted, and what its frames say about its scale.
type Body<'a> = (&'a Tracklet, shape::Shape, scale::Reading);

/// What gives the distance of a dynamic object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DistanceCue {
    /// The ground under it.
    Contact,
    /// A point that stays in place while the object turns or swings about it.
    FixedPoint,
    /// Its fall.
    Ballistic,
    /// Nothing: it is taken to be as far as the others, in front of what it hides.
    Assumed,
}

/// A dynamic object in consecutive frames.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DynamicObject {
    /// Its first frame, of those that the estimate was made of.
    pub first_frame: usize,
    /// Number of frames.
    pub frames: usize,
    /// Its mean share of the image, 0..1.
    pub share: f64,
    /// What gives its distance.
    pub cue: DistanceCue,
    /// Standard deviation of its distance, per cent.
    pub sigma_percent: f64,
}

/// Objects smaller than this share of the image do not count for a frame.
const COUNTED_SHARE: f64 = 0.001;
/// Least deviation of a frame: on exact data an estimate may be 0, which says that there is none.
const LEAST_SIGMA: f64 = 1e-6;

/// Returns the relative standard deviation of the distance of the objects in `frame`, counted as
/// [`DynamicObject::first_frame`]: the root mean square over them, weighted by their shares of the
/// image. `None` where there is none of at least 0.1 % of the image.
#[must_use]
pub fn distance_sigma(objects: &[DynamicObject], frame: usize) -> Option<f32> {
    let [mut sum, mut weight] = [0.0f64; 2];
    for object in objects {
        let lasts = object.first_frame..object.first_frame + object.frames;
        if lasts.contains(&frame) && object.share >= COUNTED_SHARE {
            sum += object.share * (object.sigma_percent / 100.0).powi(2);
            weight += object.share;
        }
    }
    (weight > 0.0).then(|| (sum / weight).sqrt().max(LEAST_SIGMA) as f32)
}

/// Standard deviation of the logarithm of the distance by a fall, and of an assumed one.
const BALLISTIC_SIGMA: f64 = 0.12;
const ASSUMED_SIGMA: f64 = 0.5;

/// Replaces the disparity of dynamic parts, `[height][width]` by frame, where a part could be
/// followed long enough to be understood as a rigid object; what flies takes its distance from how
/// it falls, where there is a ground. Returns these objects, in order of their first frames.
pub(super) fn place<'s>(
    clip: &WorkingClip<'_>,
    smoother: impl Fn(usize) -> Smoother + Sync + 's,
    disparity: &mut [Vec<f32>],
    progress: &dyn Progress,
) -> Result<Vec<DynamicObject>, DenseError> {
    let tracklets = follow(clip);
    let before: &[Vec<f32>] = disparity;
    let bodies = each(tracklets.len(), "shaping moving parts", progress, |i| {
        let t = &tracklets[i];
        let shape = rigid::reconstruct(clip, t, before)?;
        let reading = scale::read(clip, t, &shape)?;
        Some((t, shape, reading))
    })?;
    let bodies: Vec<Body<'_>> = bodies.into_iter().flatten().collect();
    let scales = scale::settle(
        &bodies
            .iter()
            .map(|(_, _, reading)| reading)
            .collect::<Vec<_>>(),
    );
    let falls = match ground::find(clip) {
        Some(ground) => falls(clip, &ground, &bodies, &scales),
        None => vec![None; bodies.len()],
    };
    let decisions: Vec<Option<Decision>> = bodies
        .iter()
        .zip(&falls)
        .map(|((_, _, reading), fall)| reading.decide_with(*fall))
        .collect();
    // Part by part onto the pixels, along the edges of the image.
    let mut values: Vec<Vec<(u32, f32)>> = vec![Vec::new(); disparity.len()];
    for (((tracklet, shape, _), decision), scale) in bodies.iter().zip(&decisions).zip(&scales) {
        let scale = decision.map_or(*scale, |decision| decision.vote.factor as f32);
        for k in 0..tracklet.parts.len() {
            values[tracklet.first + k].extend(shape.values(clip, k).map(|(p, d)| (p, d * scale)));
        }
    }
    disparity
        .par_iter_mut()
        .enumerate()
        .for_each(|(i, disparity)| {
            if !values[i].is_empty() {
                spread(clip, i, &smoother(i), &bodies, &values[i], disparity);
            }
        });
    let mut objects: Vec<DynamicObject> = bodies
        .iter()
        .zip(decisions)
        .map(|(body, decision)| describe(clip, body, decision))
        .collect();
    objects.sort_by_key(|object| object.first_frame);
    Ok(objects)
}

fn describe(
    clip: &WorkingClip<'_>,
    (tracklet, _, _): &Body<'_>,
    decision: Option<Decision>,
) -> DynamicObject {
    let (cue, sigma) = decision.map_or((DistanceCue::Assumed, ASSUMED_SIGMA), |decision| {
        (decision.cue, decision.vote.sigma)
    });
    let frames = tracklet.parts.len();
    let pixels: usize = tracklet.parts.iter().map(Vec::len).sum();
    DynamicObject {
        first_frame: tracklet.first,
        frames,
        share: pixels as f64 / (frames * clip.width * clip.height) as f64,
        cue,
        sigma_percent: 100.0 * sigma,
    }
}

/// The scales of bodies that fall, by their parabolas; `scales` are those without.
fn falls(
    clip: &WorkingClip<'_>,
    ground: &ground::Ground,
    bodies: &[Body<'_>],
    scales: &[f32],
) -> Vec<Option<Vote>> {
    let typical: Vec<Vec<f64>> = bodies
        .iter()
        .map(|(tracklet, shape, _)| {
            let of_frame = |k: usize| {
                let mut all: Vec<f32> = shape.values(clip, k).map(|(_, d)| d).collect();
                f64::from(quantile(&mut all, 0.5).unwrap_or(1.0))
            };
            (0..tracklet.parts.len()).map(of_frame).collect()
        })
        .collect();
    let depth: Vec<Vec<f64>> = typical
        .iter()
        .zip(scales)
        .map(|(typical, scale)| {
            let depth = |t: &f64| 1.0 / (t * f64::from(*scale));
            typical.iter().map(depth).collect()
        })
        .collect();
    let tracklets: Vec<&Tracklet> = bodies.iter().map(|(t, _, _)| *t).collect();
    let Some(flying) = ballistic::depths(clip, ground, &tracklets, &depth) else {
        return vec![None; bodies.len()];
    };
    flying
        .iter()
        .zip(&typical)
        .map(|(flying, typical)| {
            let mut factors: Vec<f32> = flying
                .iter()
                .zip(typical)
                .filter_map(|(z, typical)| z.map(|z| (1.0 / (z * typical)) as f32))
                .collect();
            Vote::of_frames(&mut factors, BALLISTIC_SIGMA)
        })
        .collect()
}

/// Spreads the values of a frame over the parts that they lie in.
fn spread(
    clip: &WorkingClip<'_>,
    i: usize,
    smoother: &Smoother,
    bodies: &[Body<'_>],
    values: &[(u32, f32)],
    disparity: &mut [f32],
) {
    let n = clip.width * clip.height;
    let (mut value, mut weight) = (vec![0.0f32; n], vec![0.0f32; n]);
    for &(p, d) in values {
        value[p as usize] = d;
        weight[p as usize] = 1.0;
    }
    let (filled, reach) = smoother.fill(&value, &weight, FILL_LAMBDA);
    for (tracklet, _, _) in bodies {
        let Some(pixels) = i
            .checked_sub(tracklet.first)
            .and_then(|k| tracklet.parts.get(k))
        else {
            continue;
        };
        for &p in pixels {
            let p = p as usize;
            if reach[p] > 1e-4 {
                let background = clip.disparity[i][p];
                disparity[p] = if background < OCCLUSION_RANGE * filled[p] {
                    filled[p].max(background)
                } else {
                    filled[p]
                };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    //! Rigid objects on synthetic clips: exact flow, a wrong guess of their distance.

    use super::{DistanceCue, DynamicObject, Smoother, distance_sigma, place};
    use crate::classical::dense::working::ClipData;
    use crate::flow::FlowPair;
    use m4_core::{
        Camera, Flow, Intrinsics, Se3, Silent,
        nalgebra::{Vector3, Vector6},
    };

    const W: usize = 160;
    const H: usize = 120;
    const FRAMES: usize = 20;

    /// A camera that walks an arc.
    fn camera(t: usize) -> Camera {
        let a = 0.08 * t as f64;
        Camera {
            intrinsics: Intrinsics::centred(W, H, 130.0),
            c2w: Se3::identity().retract(&Vector6::new(
                0.9 * a.sin(),
                -0.1 * a,
                0.3 * (1.0 - a.cos()),
                0.0,
                0.02 * a,
                0.0,
            )),
        }
    }

    /// A disc that faces the camera, or a ball: where its middle is and how far it is turned, by
    /// frame.
    struct Disc {
        ball: bool,
        radius: f64,
        middle: fn(usize) -> Vector3<f64>,
        turn_rad: f64,
    }

    #[test]
    fn the_deviation_of_a_frame_is_that_of_its_objects_by_their_shares() {
        let object = |first_frame: usize, share: f64, sigma_percent: f64| DynamicObject {
            first_frame,
            frames: 2,
            share,
            cue: DistanceCue::Contact,
            sigma_percent,
        };
        let objects = [
            object(1, 0.03, 6.0),
            object(2, 0.01, 50.0),
            object(5, 0.0009, 50.0),
            object(8, 0.1, 0.0),
        ];
        // sqrt((3 * 0.06^2 + 0.5^2) / 4)
        let both = 0.255_342_9;
        let mut expected = vec![None, Some(0.06), Some(both), Some(0.5)];
        expected.extend([None, None, None, None, Some(1e-6), Some(1e-6), None]);
        for (frame, expected) in expected.into_iter().enumerate() {
            let sigma = distance_sigma(&objects, frame);
            assert_eq!(sigma.is_some(), expected.is_some(), "{frame}");
            let off = sigma.unwrap_or(0.0) - expected.unwrap_or(0.0);
            assert!(off.abs() < 1e-6, "{frame}: {sigma:?}");
        }
    }

    /// Ground 1 below the first camera, up to a wall at depth 6.
    fn background(camera: &Camera, x: f64, y: f64) -> f64 {
        let (c, far) = (camera.centre(), camera.unproject(x, y, 1.0));
        let ray = far - c;
        let wall = (6.0 - c.z) / ray.z;
        let ground = if ray.y > 1e-9 {
            (1.0 - c.y) / ray.y
        } else {
            f64::INFINITY
        };
        1.0 / wall.min(ground)
    }

    /// The disc's disparity at a pixel of frame `t`, where it is seen there.
    fn disc_disparity(disc: &Disc, camera: &Camera, t: usize, x: f64, y: f64) -> Option<f64> {
        let (c, ray) = (
            camera.centre(),
            camera.unproject(x, y, 1.0) - camera.centre(),
        );
        let middle = (disc.middle)(t);
        let s = if disc.ball {
            // the nearer of the two places where the ray meets the sphere
            let (a, b) = (ray.norm_squared(), ray.dot(&(middle - c)));
            let inside = b * b - a * ((middle - c).norm_squared() - disc.radius.powi(2));
            (inside > 0.0).then(|| (b - inside.sqrt()) / a)?
        } else {
            let s = (middle.z - c.z) / ray.z;
            ((c + ray * s - middle).norm() < disc.radius).then_some(s)?
        };
        Some(1.0 / camera.project(&(c + ray * s)).1)
    }

    /// The clip, and the true disparity of every pixel.
    fn world(disc: &Disc) -> (ClipData, Vec<Vec<f32>>) {
        let cameras: Vec<Camera> = (0..FRAMES).map(camera).collect();
        let at = |p: usize| ((p % W) as f64, (p / W) as f64);
        let part = |t: usize, p: usize| disc_disparity(disc, &cameras[t], t, at(p).0, at(p).1);
        let behind = |t: usize, p: usize| background(&cameras[t], at(p).0, at(p).1);
        // Where a pixel of frame `a` is seen in frame `b`.
        let moved = |a: usize, b: usize, p: usize| {
            let (x, y) = at(p);
            let point = match part(a, p) {
                Some(d) => {
                    let turn = disc.turn_rad * (b as f64 - a as f64);
                    let off = cameras[a].unproject(x, y, 1.0 / d) - (disc.middle)(a);
                    let (s, c) = turn.sin_cos();
                    (disc.middle)(b)
                        + Vector3::new(c * off.x - s * off.y, s * off.x + c * off.y, off.z)
                }
                None => cameras[a].unproject(x, y, 1.0 / behind(a, p)),
            };
            let ([u, v], _) = cameras[b].project(&point);
            ((u - x) as f32, (v - y) as f32)
        };
        let flow = |a: usize, b: usize| {
            let (u, v) = (0..W * H).map(|p| moved(a, b, p)).unzip();
            Flow {
                width: W,
                height: H,
                u,
                v,
            }
        };
        let map = |f: &dyn Fn(usize, usize) -> f64| -> Vec<Vec<f32>> {
            (0..FRAMES)
                .map(|t| (0..W * H).map(|p| f(t, p) as f32).collect())
                .collect()
        };
        let moves = |t: usize, p: usize| if part(t, p).is_some() { 255 } else { 0 };
        let truth = map(&|t, p| part(t, p).unwrap_or_else(|| behind(t, p)));
        let clip = ClipData {
            size: (W, H),
            dynamic: (0..FRAMES)
                .map(|t| (0..W * H).map(|p| moves(t, p)).collect())
                .collect(),
            disparity: map(&|t, p| behind(t, p)),
            flows: (0..FRAMES - 1)
                .map(|t| FlowPair::exact(flow(t, t + 1), flow(t + 1, t)))
                .collect(),
            cameras,
        };
        (clip, truth)
    }

    /// Mean relative error of depth inside the disc, before and after, from a guess that is wrong
    /// by `guess(t)`.
    fn errors(disc: &Disc, guess: impl Fn(usize) -> f32) -> (f32, f32) {
        errors_in(world(disc), guess)
    }

    /// The same in a given world.
    fn errors_in(
        (world, truth): (ClipData, Vec<Vec<f32>>),
        guess: impl Fn(usize) -> f32,
    ) -> (f32, f32) {
        let mut disparity = truth.clone();
        for (t, disparity) in disparity.iter_mut().enumerate() {
            for (d, dynamic) in disparity.iter_mut().zip(&world.dynamic[t]) {
                if *dynamic > 0 {
                    *d *= guess(t);
                }
            }
        }
        let error = |disparity: &[Vec<f32>]| {
            let (mut sum, mut count) = (0.0, 0.0);
            for (t, disparity) in disparity.iter().enumerate() {
                for p in (0..W * H).filter(|&p| world.dynamic[t][p] > 0) {
                    sum += (truth[t][p] / disparity[p] - 1.0).abs();
                    count += 1.0;
                }
            }
            sum / count
        };
        let before = error(&disparity);
        let smoother = |_: usize| Smoother::new(W, H, &[[90; 3]; W * H], 8.0);
        place(&world.clip(), smoother, &mut disparity, &Silent).expect("it is not cancelled");
        (before, error(&disparity))
    }

    #[test]
    fn spinning_wheel_stays_in_place_and_rolling_object_has_the_depth_of_its_contact() {
        let wheel = Disc {
            ball: false,
            radius: 0.5,
            middle: |_| Vector3::new(0.3, -0.1, 3.0),
            turn_rad: 0.15,
        };
        let rolls = |t: usize| Vector3::new(-0.8 + 0.07 * t as f64, 0.6, 3.0 - 0.02 * t as f64);
        let rolling = Disc {
            ball: false,
            radius: 0.4,
            middle: rolls,
            turn_rad: 0.17,
        };
        for (what, disc, guess, most) in
            [("wheel", wheel, 1.2, 0.03), ("rolling", rolling, 0.8, 0.08)]
        {
            let (before, after) = errors(&disc, |t| guess + 0.1 * (t as f32).sin());
            assert!(before > 0.15 && after < most, "{what}: {before} {after}");
        }
    }

    #[test]
    fn something_static_before_an_object_does_not_draw_it_near() {
        let rolls = |t: usize| Vector3::new(-0.8 + 0.07 * t as f64, 0.6, 3.0 - 0.02 * t as f64);
        let (mut clip, truth) = world(&Disc {
            ball: false,
            radius: 0.4,
            middle: rolls,
            turn_rad: 0.17,
        });
        // a post at depth 1 hides what is left of the disc, so the background that is filled in
        // behind its left side is as near
        for (disparity, dynamic) in clip.disparity.iter_mut().zip(&clip.dynamic) {
            let inside: Vec<usize> = (0..W * H).filter(|&p| dynamic[p] > 0).collect();
            let left = inside.iter().map(|p| p % W).min().unwrap_or(0);
            inside
                .into_iter()
                .filter(|p| p % W < left + 6)
                .for_each(|p| disparity[p] = 1.0);
        }
        let (before, after) = errors_in((clip, truth), |t| 0.8 + 0.1 * (t as f32).sin());
        assert!(before > 0.15 && after < 0.1, "{before} {after}");
    }

    #[test]
    fn a_thrown_ball_is_at_the_distance_that_its_parabola_tells() {
        // It leaves the ground in frame 1 and is back in frame 18.
        let ball = Disc {
            ball: true,
            radius: 0.25,
            middle: |t| {
                let t = t as f64;
                let y = 0.03 + 0.01 * (t - 9.5).powi(2);
                Vector3::new(0.1 + 0.02 * t, y.min(0.75), 2.4 + 0.03 * t)
            },
            turn_rad: 0.0,
        };
        let (before, after) = errors(&ball, |t| 0.75 + 0.05 * (t as f32).sin());
        // measured: 0.0174, and 0.351 without the ballistic prior
        assert!(before > 0.25 && after < 0.025, "{before} {after}");
    }
}
