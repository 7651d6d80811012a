//! Depth of a clip without parallax: layers.
//!
//! A camera that does not move from its place cannot measure depth, so depth is made up such that
//! what occludes is nearer than what it occludes. The static background lies on a sphere of radius
//! 1 around the camera, which is one surface for all frames, however the camera turns. Every
//! dynamic region lies in front of it by [`MARGIN`], in front of the dynamic regions that it surely
//! occludes by [`STEP`] more, and static occluders lie in front of all of them.
//!
//! ```text
//! masks, flow -> rigid_objects::tracklet: regions through time
//!             -> order: which of two regions that touch is in front
//!             -> occluders: static pixels in front of dynamic regions
//! ```

mod occluders;

use super::regions::Components;
use super::rigid_objects::{ROUND_TRIP_PX, Tracklet, follow};
use super::shot::Shot;
use super::working::{WorkingClip, pixel_at};
use crate::flow::{FlowPair, Way};
use m4_core::{Camera, quantile};
use occluders::Occluders;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Distance from the background to the farthest dynamic layer, as a share of the latter: more than
/// ten times the extent of a splat in depth, so that static splats are never sorted in front of
/// dynamic ones, also where training moved them; 2 to 3 pixels when the camera swings by 3 degrees.
const MARGIN: f32 = 0.1;
/// The same between dynamic layers: less, since an order may change in the course of a clip, and a
/// person should not fall apart into limbs.
const STEP: f32 = 0.03;

/// Disparity of a point on the unit sphere around the camera, `[height][width]`: the length of the
/// ray of z-depth 1.
pub(super) fn sphere(camera: &Camera) -> Vec<f32> {
    let k = &camera.intrinsics;
    (0..k.width * k.height)
        .map(|p| {
            let x = ((p % k.width) as f64 + 0.5 - k.cx) / k.fx;
            let y = ((p / k.width) as f64 + 0.5 - k.cy) / k.fy;
            (x * x + y * y + 1.0).sqrt() as f32
        })
        .collect()
}

/// Disparity of every pixel of every frame, `[height][width]` each. `clip.disparity` is [`sphere`]
/// of each camera, `shots` have the colours, and a flow whose round trip misses by more than
/// [`ROUND_TRIP_PX`] saw an occlusion.
pub(super) fn place(clip: &WorkingClip<'_>, shots: &[Shot]) -> Vec<Vec<f32>> {
    let (w, h) = (clip.width, clip.height);
    let tracklets = follow(clip);
    let labels = labels(clip, &tracklets);
    let ranks = ranks(clip, &labels, tracklets.len());
    let front = ranks.iter().max().map_or(0, |r| r + 1);
    let occluders = Occluders::find(clip, shots);
    let frame = |i: usize| {
        let layer = dynamic_layers(w, h, &clip.dynamic[i], &labels[i], &ranks);
        let occludes = occluders.in_frame(&clip.cameras[i], w, h);
        let layer = |p: usize| {
            if layer[p] == 0 && occludes[p] {
                front + 1
            } else {
                layer[p]
            }
        };
        (0..w * h)
            .map(|p| clip.disparity[i][p] * nearer(layer(p)))
            .collect()
    };
    (0..clip.dynamic.len()).into_par_iter().map(frame).collect()
}

/// Times the background's, the disparity of a layer: 0 for the background, from 1 on in front of
/// it.
fn nearer(layer: usize) -> f32 {
    match layer {
        0 => 1.0,
        _ => (1.0 + MARGIN) * (1.0 + STEP).powi(layer as i32 - 1),
    }
}

/// One plus the tracklet of every pixel of every frame, 0 for none.
fn labels(clip: &WorkingClip<'_>, tracklets: &[Tracklet]) -> Vec<Vec<u32>> {
    let mut out = vec![vec![0u32; clip.width * clip.height]; clip.dynamic.len()];
    for (k, tracklet) in tracklets.iter().enumerate() {
        for (frame, pixels) in out[tracklet.first..].iter_mut().zip(&tracklet.parts) {
            for &p in pixels {
                frame[p as usize] = k as u32 + 1;
            }
        }
    }
    out
}

/// The layer of every pixel: 0 for static ones, one plus the rank of its tracklet for dynamic ones.
/// What is in no tracklet goes with most of what it is connected to, or into the farthest dynamic
/// layer.
fn dynamic_layers(
    w: usize,
    h: usize,
    dynamic: &[u8],
    labels: &[u32],
    ranks: &[usize],
) -> Vec<usize> {
    let mut out = vec![0usize; w * h];
    for pixels in Components::of(w, h, dynamic).pixels {
        let rank = |p: u32| {
            (labels[p as usize] as usize)
                .checked_sub(1)
                .map(|k| ranks[k])
        };
        let mut count: BTreeMap<usize, usize> = BTreeMap::new();
        for rank in pixels.iter().filter_map(|&p| rank(p)) {
            *count.entry(rank).or_default() += 1;
        }
        let most = count
            .into_iter()
            .max_by_key(|&(rank, n)| (n, rank))
            .map_or(0, |(rank, _)| rank);
        for p in pixels {
            out[p as usize] = 1 + rank(p).unwrap_or(most);
        }
    }
    out
}

/// How far from a region its neighbour is asked, in image widths.
const BAND: f32 = 0.006;
/// Standard deviations by which the shares of hidden pixels must differ to be believed.
const SURE: f32 = 3.0;

/// What is known of region `a` next to region `b`.
#[derive(Debug, Clone, Copy, Default)]
struct Beside {
    /// Pixels of `a` near `b`, all frames together.
    pixels: usize,
    /// Those of them that land in `b`, moved on as `a` moves.
    hidden: usize,
}

/// The rank of every tracklet by which of two regions that touch is in front: the outline between
/// them moves with the front one, so pixels of the back one are covered and uncovered there (Stein
/// and Hebert 2009). A pixel of the back region, moved on as its region moves, lands in the front
/// one.
///
/// 0 for the farthest; greater than those of all that it touches and surely occludes. Regions that
/// touch without a sure order share a rank: they may be parts of one body.
fn ranks(clip: &WorkingClip<'_>, labels: &[Vec<u32>], count: usize) -> Vec<usize> {
    let mut beside: BTreeMap<(usize, usize), Beside> = BTreeMap::new();
    for t in 0..labels.len() {
        observe(clip, labels, t, &mut beside);
    }
    // By tracklet: those that it touches in a sure order, with how surely it is in front of them.
    let mut ordered: Vec<Vec<(usize, f32)>> = vec![Vec::new(); count];
    for (&(a, b), x) in &beside {
        let score = beside.get(&(b, a)).map_or(0.0, |y| in_front(*x, *y));
        if score.abs() >= SURE {
            ordered[a].push((b, score));
        }
    }
    // The farthest first: what is least in front of those that are left.
    let mut lead: Vec<f32> = ordered
        .iter()
        .map(|with| with.iter().map(|(_, s)| s).sum())
        .collect();
    let mut rank: Vec<Option<usize>> = vec![None; count];
    for _ in 0..count {
        let left = (0..count).filter(|&a| rank[a].is_none());
        let Some(a) = left.min_by(|&a, &b| lead[a].total_cmp(&lead[b])) else {
            break;
        };
        let behind = ordered[a].iter().filter_map(|&(b, _)| rank[b]);
        rank[a] = Some(behind.max().map_or(0, |r| r + 1));
        for &(b, score) in &ordered[a] {
            lead[b] += score;
        }
    }
    rank.into_iter().map(Option::unwrap_or_default).collect()
}

/// How surely `a` is in front of `b`, standard deviations; below 0 where it is behind.
fn in_front(a: Beside, b: Beside) -> f32 {
    let (n, m) = (a.pixels as f32, b.pixels as f32);
    let mean = (a.hidden + b.hidden) as f32 / (n + m);
    let sigma = (mean * (1.0 - mean) * (1.0 / n + 1.0 / m)).sqrt();
    (b.hidden as f32 / m - a.hidden as f32 / n) / sigma.max(1e-6)
}

/// Adds what frame `t` shows together with the frames before and after it.
fn observe(
    clip: &WorkingClip<'_>,
    labels: &[Vec<u32>],
    t: usize,
    beside: &mut BTreeMap<(usize, usize), Beside>,
) {
    let (w, h) = (clip.width, clip.height);
    let reach = ((BAND * w as f32).round() as usize).max(1);
    let label = &labels[t];
    let mut pairs: Vec<(usize, u32)> = Vec::new();
    for p in (0..w * h).filter(|&p| label[p] > 0) {
        let (x, y) = (p % w, p / w);
        let first = pairs.len();
        for ny in y.saturating_sub(reach)..(y + reach + 1).min(h) {
            for &other in &label[ny * w + x.saturating_sub(reach)..ny * w + (x + reach + 1).min(w)]
            {
                if other > 0 && other != label[p] && pairs[first..].iter().all(|&(_, l)| l != other)
                {
                    pairs.push((p, other));
                }
            }
        }
    }
    if pairs.is_empty() {
        return;
    }
    for later in [true, false] {
        let Some(way) = FlowPair::step(clip.flows, t, later) else {
            continue;
        };
        let other_labels = &labels[if later { t + 1 } else { t - 1 }];
        let motion = motions(label, way);
        for &(p, other) in &pairs {
            let Some([u, v]) = motion.get(&label[p]) else {
                continue;
            };
            if let Some(q) = pixel_at(w, h, (p % w) as f32 + u, (p / w) as f32 + v) {
                let counts = beside
                    .entry((label[p] as usize - 1, other as usize - 1))
                    .or_default();
                counts.pixels += 1;
                counts.hidden += usize::from(other_labels[q] == other);
            }
        }
    }
}

/// Median flow of each label, of the pixels whose flow comes back.
fn motions(label: &[u32], way: Way<'_>) -> BTreeMap<u32, [f32; 2]> {
    let mut all: BTreeMap<u32, [Vec<f32>; 2]> = BTreeMap::new();
    for p in (0..label.len()).filter(|&p| label[p] > 0 && way.round_trip_px(p) <= ROUND_TRIP_PX) {
        let [u, v] = all.entry(label[p]).or_default();
        u.push(way.flow.u[p]);
        v.push(way.flow.v[p]);
    }
    let median = |v: &mut Vec<f32>| quantile(v, 0.5).unwrap_or(0.0);
    all.into_iter()
        .map(|(l, [mut u, mut v])| (l, [median(&mut u), median(&mut v)]))
        .collect()
}

#[cfg(test)]
mod tests {
    //! Two blocks that pass each other behind a pole, before a wall, seen by a static or panning
    //! camera.

    use super::super::working::ClipData;
    use super::{FlowPair, MARGIN, STEP, Shot, place, sphere};
    use m4_core::{Camera, Flow, Intrinsics, Plane, Se3, nalgebra::Vector6, quantile};

    const W: usize = 96;
    const H: usize = 64;
    const FRAMES: usize = 28;
    /// Columns of the world that the pole fills.
    const POLE: std::ops::Range<isize> = 84..90;

    /// What is seen at a place of the world.
    #[derive(Debug, Clone, Copy, PartialEq)]
    enum Thing {
        Wall,
        /// In front of [`Thing::Back`].
        Front,
        Back,
        Pole,
    }

    /// The thing in column `x` and row `y` in frame `t`.
    fn thing(x: isize, y: usize, t: usize) -> Thing {
        let left = |start: isize, step: isize| start + step * t as isize;
        if POLE.contains(&x) {
            Thing::Pole
        } else if (left(4, 3)..left(4, 3) + 14).contains(&x) && (18..38).contains(&y) {
            Thing::Front
        } else if (left(66, -3)..left(66, -3) + 16).contains(&x) && (30..52).contains(&y) {
            Thing::Back
        } else {
            Thing::Wall
        }
    }

    /// Columns that a thing moves per frame.
    fn velocity(thing: Thing) -> isize {
        match thing {
            Thing::Wall | Thing::Pole => 0,
            Thing::Front => 3,
            Thing::Back => -3,
        }
    }

    struct World {
        clip: ClipData,
        shots: Vec<Shot>,
    }

    /// Flow from frame `t` to `to` with the miss of its round trip: none where the same thing is
    /// seen at both ends.
    fn flow(t: usize, to: usize) -> Flow {
        let mut flow = Flow::zero(W, H);
        for p in 0..W * H {
            let label = thing((p % W) as isize, p / W, t);
            flow.u[p] = (velocity(label) * (to as isize - t as isize)) as f32;
        }
        flow
    }

    fn world() -> World {
        let camera = Camera {
            intrinsics: Intrinsics::centred(W, H, 90.0),
            c2w: Se3::identity(),
        };
        let things = |t: usize| (0..W * H).map(move |p| thing((p % W) as isize, p / W, t));
        let shot = |t: usize| {
            let image = Plane::from_fn(W, H, |x, y| match thing(x as isize, y, t) {
                Thing::Wall => [90 + (x * 7 + y * 3) as u8 % 5; 3],
                Thing::Front => [200, 60, 60],
                Thing::Back => [60, 200, 60],
                Thing::Pole => [20, 20, 60],
            });
            Shot::of_colours(&image)
        };
        let dynamic = |thing: Thing| if velocity(thing) != 0 { 255 } else { 0 };
        let clip = ClipData {
            size: (W, H),
            cameras: vec![camera; FRAMES],
            dynamic: (0..FRAMES)
                .map(|t| things(t).map(dynamic).collect())
                .collect(),
            disparity: vec![sphere(&camera); FRAMES],
            flows: (1..FRAMES)
                .map(|t| FlowPair {
                    forward: flow(t - 1, t),
                    backward: flow(t, t - 1),
                })
                .collect(),
        };
        World {
            clip,
            shots: (0..FRAMES).map(shot).collect(),
        }
    }

    #[test]
    fn layers_follow_occlusion() {
        let world = world();
        let out = place(&world.clip.clip(), &world.shots);
        // In units of the background's.
        let ratios = |t: usize, of: Thing| -> Vec<f32> {
            let pixels = (0..W * H).filter(|&p| thing((p % W) as isize, p / W, t) == of);
            pixels
                .map(|p| out[t][p] / world.clip.disparity[t][p])
                .collect()
        };
        let least_and_most = |t: usize, of: Thing| {
            ratios(t, of)
                .into_iter()
                .fold((f32::MAX, f32::MIN), |(a, b), d| (a.min(d), b.max(d)))
        };
        let (first, step) = (1.0 + MARGIN, 1.0 + STEP);
        for t in 0..FRAMES {
            let (nearest_wall, dynamic) = (
                least_and_most(t, Thing::Wall).1,
                least_and_most(t, Thing::Back),
            );
            assert!(nearest_wall < 1.001, "frame {t}: wall at {nearest_wall}");
            assert!(dynamic.0 > 0.999 * first, "frame {t}: {dynamic:?}");
            let pole = least_and_most(t, Thing::Pole);
            let nearest = dynamic.1.max(least_and_most(t, Thing::Front).1);
            assert!(
                pole.0 > 0.999 * step * nearest,
                "frame {t}: {pole:?}, dynamic {nearest}"
            );
        }
        // They overlap in frames 9 to 12; at the very outline labels are a few pixels off.
        let median = |t: usize, of: Thing| quantile(&mut ratios(t, of), 0.5).unwrap_or(0.0);
        for t in 9..13 {
            let (front, back) = (median(t, Thing::Front), median(t, Thing::Back));
            assert!(front > 0.999 * step * back, "frame {t}: {front} {back}");
        }
    }

    #[test]
    fn turning_camera_sees_one_background_surface() {
        let camera = Camera {
            intrinsics: Intrinsics::centred(W, H, 90.0),
            c2w: Se3::identity(),
        };
        let turned = Camera {
            c2w: camera
                .c2w
                .retract(&Vector6::new(0.0, 0.0, 0.0, 0.02, 0.1, 0.0)),
            ..camera
        };
        for camera in [camera, turned] {
            for (p, disparity) in sphere(&camera).into_iter().enumerate() {
                let point =
                    camera.unproject((p % W) as f64, (p / W) as f64, 1.0 / f64::from(disparity));
                assert!((point.norm() - 1.0).abs() < 1e-6);
            }
        }
    }
}
