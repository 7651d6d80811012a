//! Two blocks that pass each other behind a pole, before a wall, seen by a static or panning camera.

use super::super::flow::FlowPair;
use super::super::rigid_objects::Clip;
use super::super::shot::Shot;
use super::super::sweep::Range;
use super::super::working::WorkingFrame;
use super::{MARGIN, STEP, place, sphere};
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
    cameras: Vec<Camera>,
    shots: Vec<Shot>,
    moving: Vec<Vec<u8>>,
    background: Vec<Vec<f32>>,
    flows: Vec<FlowPair>,
}

/// Flow from frame `t` to `to` with the miss of its round trip: none where the same thing is seen at both ends.
fn flow(t: usize, to: usize) -> (Flow, Vec<f32>) {
    let mut flow = Flow::zero(W, H);
    let mut trip = vec![0.0; W * H];
    for p in 0..W * H {
        let (x, y) = ((p % W) as isize, p / W);
        let seen = thing(x, y, t);
        let step = velocity(seen) * (to as isize - t as isize);
        flow.u[p] = step as f32;
        if thing(x + step, y, to) != seen {
            trip[p] = 10.0;
        }
    }
    (flow, trip)
}

fn world() -> World {
    let camera = Camera { intrinsics: Intrinsics::centred(W, H, 90.0), c2w: Se3::identity() };
    let things = |t: usize| (0..W * H).map(move |p| thing((p % W) as isize, p / W, t));
    let shot = |t: usize| {
        let image = Plane::from_fn(W, H, |x, y| match thing(x as isize, y, t) {
            Thing::Wall => [90 + (x * 7 + y * 3) as u8 % 5; 3],
            Thing::Front => [200, 60, 60],
            Thing::Back => [60, 200, 60],
            Thing::Pole => [20, 20, 60],
        });
        let range = Range { least: 1.0, step: 1.0, count: 1 };
        Shot {
            frame: WorkingFrame::new(&image, &camera, W, H),
            census: Vec::new(),
            points: Vec::new(),
            partners: Vec::new(),
            range,
        }
    };
    let dynamic = |thing: Thing| {
        if matches!(thing, Thing::Front | Thing::Back) { 255 } else { 0 }
    };
    World {
        cameras: vec![camera; FRAMES],
        shots: (0..FRAMES).map(shot).collect(),
        moving: (0..FRAMES).map(|t| things(t).map(dynamic).collect()).collect(),
        background: vec![sphere(&camera); FRAMES],
        flows: (1..FRAMES)
            .map(|t| {
                let ((forward, forward_round_trip), (backward, backward_round_trip)) = (flow(t - 1, t), flow(t, t - 1));
                FlowPair { forward, backward, forward_round_trip, backward_round_trip }
            })
            .collect(),
    }
}

#[test]
fn layers_follow_occlusion() {
    let world = world();
    let clip = Clip {
        width: W,
        height: H,
        cameras: &world.cameras,
        moving: &world.moving,
        background: &world.background,
        flows: &world.flows,
    };
    let out = place(&clip, &world.shots);
    // In units of the background's.
    let least_and_most = |t: usize, of: Thing| {
        let found = (0..W * H).filter(|&p| thing((p % W) as isize, p / W, t) == of);
        found.map(|p| out[t][p] / world.background[t][p]).fold((f32::MAX, f32::MIN), |(a, b), d| (a.min(d), b.max(d)))
    };
    let (first, step) = (1.0 + MARGIN, 1.0 + STEP);
    for t in 0..FRAMES {
        let (nearest_wall, dynamic) = (least_and_most(t, Thing::Wall).1, least_and_most(t, Thing::Back));
        assert!(nearest_wall < 1.001, "frame {t}: wall at {nearest_wall}");
        assert!(dynamic.0 > 0.999 * first, "frame {t}: {dynamic:?}");
        let pole = least_and_most(t, Thing::Pole);
        let nearest = dynamic.1.max(least_and_most(t, Thing::Front).1);
        assert!(pole.0 > 0.999 * step * nearest, "frame {t}: {pole:?}, dynamic {nearest}");
    }
    // They overlap in frames 9 to 12; at the very outline labels are a few pixels off.
    let median = |t: usize, of: Thing| {
        let found = (0..W * H).filter(|&p| thing((p % W) as isize, p / W, t) == of);
        quantile(&mut found.map(|p| out[t][p] / world.background[t][p]).collect::<Vec<_>>(), 0.5).unwrap_or(0.0)
    };
    for t in 9..13 {
        let (front, back) = (median(t, Thing::Front), median(t, Thing::Back));
        assert!(front > 0.999 * step * back, "frame {t}: {front} {back}");
    }
}

#[test]
fn turning_camera_sees_one_background_surface() {
    let camera = Camera { intrinsics: Intrinsics::centred(W, H, 90.0), c2w: Se3::identity() };
    let turned = Camera { c2w: camera.c2w.retract(&Vector6::new(0.0, 0.0, 0.0, 0.02, 0.1, 0.0)), ..camera };
    for camera in [camera, turned] {
        for (p, disparity) in sphere(&camera).into_iter().enumerate() {
            let point = camera.unproject((p % W) as f64, (p / W) as f64, 1.0 / f64::from(disparity));
            assert!((point.norm() - 1.0).abs() < 1e-6);
        }
    }
}
