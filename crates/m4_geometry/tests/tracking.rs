//! A room, a moving ball and a camera that walks: everything is recovered from noisy flow.

use m4_core::{
    CounterRng, Se3, Silent, Sim3,
    nalgebra::{Vector3, Vector6},
};
use m4_geometry::dba::{Grid, Pinhole};
use m4_geometry::megasam::graph::{EdgeChanges, EdgeId};
use m4_geometry::megasam::tracker::{
    Correspondence, CorrespondenceError, FrameInput, Revision, Tracked, TrackerInput,
    TrackerSettings, track,
};
use std::collections::HashMap;

const GRID: Grid = Grid {
    width: 96,
    height: 64,
};
const LENS: Pinhole<f64> = Pinhole {
    fx: 84.0,
    fy: 84.0,
    cx: 47.5,
    cy: 31.5,
};
const FRAMES: usize = 20;
const BALL: f64 = 0.5;

/// Standard deviation of the flow, pixels of the grid.
const NOISE_PX: f64 = 0.1;

/// Of all disparities; that of a network is about this.
const DAMPING: f32 = 0.005;

/// Flow from one frame to another. Planes are `[height * width]` on the grid of the tracker.
struct DenseFlow {
    /// Motion of each pixel, pixels of the grid; u, then v.
    flow_px: [Vec<f32>; 2],
    /// Confidence, 0..=1.
    confidence: Vec<f32>,
    /// 1 where a pixel is static, as a network tells.
    still: Vec<f32>,
}

/// Targets that do not depend on the projection: the pixel plus its flow, asked of `flow(i, j)`
/// when an edge enters and dropped when it leaves.
struct FlowCorrespondence {
    flow: fn(usize, usize) -> DenseFlow,
    edges: HashMap<EdgeId, DenseFlow>,
}

impl FlowCorrespondence {
    fn new(flow: fn(usize, usize) -> DenseFlow) -> Self {
        let edges = HashMap::new();
        Self { flow, edges }
    }
}

impl Correspondence for FlowCorrespondence {
    fn change(&mut self, changes: &EdgeChanges) -> Result<(), CorrespondenceError> {
        for key in &changes.entered {
            let flow = (self.flow)(key.source_frame, key.target_frame);
            self.edges.insert(key.id, flow);
        }
        for key in &changes.left {
            self.edges.remove(&key.id);
        }
        Ok(())
    }

    fn revise(&mut self, revision: &mut Revision<'_>) -> Result<(), CorrespondenceError> {
        let width = revision.grid.width;
        for edge in &mut revision.edges {
            let Some(flow) = self.edges.get(&edge.key.id) else {
                let reason = "the edge was never announced";
                return Err(CorrespondenceError(reason.into()));
            };
            for n in 0..revision.grid.len() {
                edge.target_px[0][n] = (n % width) as f32 + flow.flow_px[0][n];
                edge.target_px[1][n] = (n / width) as f32 + flow.flow_px[1][n];
            }
            for plane in edge.weight.iter_mut() {
                plane.copy_from_slice(&flow.confidence);
            }
            edge.static_confidence.copy_from_slice(&flow.still);
        }
        for source in &mut revision.sources {
            source.damping.fill(DAMPING);
        }
        Ok(())
    }

    fn motion_px(
        &mut self,
        from_frame: usize,
        to_frame: usize,
    ) -> Result<f64, CorrespondenceError> {
        let flow = (self.flow)(from_frame, to_frame);
        let [u, v] = &flow.flow_px;
        let (mut sum, mut weight) = (0.0, 0.0);
        for (n, &c) in flow.confidence.iter().enumerate() {
            sum += f64::from(c) * f64::from(u[n].hypot(v[n]));
            weight += f64::from(c);
        }
        // Nothing in common: as far apart as can be.
        Ok(if weight > 0.0 {
            sum / weight
        } else {
            f64::INFINITY
        })
    }
}

/// Where the ball is at a frame, metres.
fn ball(frame: usize) -> Vector3<f64> {
    let t = frame as f64 / (FRAMES - 1) as f64;
    Vector3::new(-0.7 + 1.4 * t, 0.2 - 0.6 * (8.0 * t).sin(), 3.2)
}

/// Camera to world at a frame.
fn camera(frame: usize) -> Se3<f64> {
    let t = frame as f64 / (FRAMES - 1) as f64;
    let turn = Vector6::new(
        0.0,
        0.0,
        0.0,
        0.05 * (4.0 * t).sin(),
        0.2 - 0.4 * t,
        0.04 * (5.0 * t).cos(),
    );
    Se3 {
        translation: Vector3::new(-0.9 + 1.8 * t, 0.25 * (6.0 * t).sin(), 0.7 * t * t),
        rotation: Se3::exp(&turn).rotation,
    }
}

/// What the ray of a pixel meets: z-depth, and whether it is the ball.
fn cast(c2w: &Se3<f64>, centre: &Vector3<f64>, u: f64, v: f64) -> (f64, bool) {
    let local = Vector3::new((u - LENS.cx) / LENS.fx, (v - LENS.cy) / LENS.fy, 1.0);
    let ray = c2w.rotation * local;
    let from = c2w.translation;
    let mut depth = f64::INFINITY;
    // A room with a cupboard: the walls seen from inside, the cupboard's faces from outside.
    for (axis, wall) in [(0, -3.0), (0, 3.0), (1, -1.6), (1, 1.5), (2, 6.0)] {
        let t = (wall - from[axis]) / ray[axis];
        if t > 0.0 {
            depth = depth.min(t);
        }
    }
    let (low, high) = (Vector3::new(-2.4, -0.4, 4.0), Vector3::new(-0.9, 1.5, 5.0));
    let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
    for axis in 0..3 {
        let (a, b) = (
            (low[axis] - from[axis]) / ray[axis],
            (high[axis] - from[axis]) / ray[axis],
        );
        (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
    }
    if enter < leave && enter > 0.0 {
        depth = depth.min(enter);
    }
    let to = from - centre;
    let (a, b, c) = (
        ray.norm_squared(),
        ray.dot(&to),
        to.norm_squared() - BALL * BALL,
    );
    let inside = b * b - a * c;
    if inside > 0.0 {
        let t = (-b - inside.sqrt()) / a;
        if t > 0.0 && t < depth {
            return (t, true);
        }
    }
    (depth, false)
}

fn pixels() -> impl Iterator<Item = (f64, f64)> {
    (0..GRID.len()).map(|n| ((n % GRID.width) as f64, (n / GRID.width) as f64))
}

/// True flow with noise; confidence 0 where the target is hidden or out of the image.
fn flow(i: usize, j: usize) -> DenseFlow {
    let (from, to) = (camera(i), camera(j).inverse());
    let mut rng = CounterRng::new(5, i as u64, j as u64);
    let mut out = DenseFlow {
        flow_px: [Vec::new(), Vec::new()],
        confidence: Vec::new(),
        still: Vec::new(),
    };
    for (u, v) in pixels() {
        let (depth, moving) = cast(&from, &ball(i), u, v);
        let local = Vector3::new((u - LENS.cx) / LENS.fx, (v - LENS.cy) / LENS.fy, 1.0) * depth;
        let shift = if moving {
            ball(j) - ball(i)
        } else {
            Vector3::zeros()
        };
        let p = to.transform(&(from.transform(&local) + shift));
        let (x, y) = (LENS.fx * p.x / p.z + LENS.cx, LENS.fy * p.y / p.z + LENS.cy);
        let visible = p.z > 0.1
            && (0.0..=95.0).contains(&x)
            && (0.0..=63.0).contains(&y)
            && (cast(&camera(j), &ball(j), x, y).0 / p.z - 1.0).abs() < 0.02;
        let flow_px = |x: f64| if p.z > 0.1 { x as f32 } else { 0.0 };
        out.flow_px[0].push(flow_px(x - u + NOISE_PX * rng.normal()));
        out.flow_px[1].push(flow_px(y - v + NOISE_PX * rng.normal()));
        out.confidence.push(if visible { 1.0 } else { 0.0 });
        out.still.push(if moving { 0.0 } else { 1.0 });
    }
    out
}

/// Disparity of a network: up to 12 % off, unknown in one corner.
fn sensor(frame: usize) -> Vec<f32> {
    let c2w = camera(frame);
    pixels()
        .map(|(u, v)| {
            if u < 12.0 && v < 12.0 {
                return 0.0;
            }
            let wave =
                (0.07 * u + 0.3 * frame as f64).sin() * (0.09 * v - 0.2 * frame as f64).cos();
            ((1.0 + 0.12 * wave) / cast(&c2w, &ball(frame), u, v).0) as f32
        })
        .collect()
}

fn inputs(sensor: impl Fn(usize) -> Vec<f32>) -> Vec<FrameInput> {
    (0..FRAMES)
        .map(|frame| FrameInput {
            frame,
            time_s: frame as f64 / 30.0,
            sensor: sensor(frame),
        })
        .collect()
}

fn run(settings: &TrackerSettings, guess: f64, sensor: fn(usize) -> Vec<f32>) -> Tracked {
    let frames = inputs(sensor);
    let clip = TrackerInput {
        grid: GRID,
        lens: Pinhole {
            fx: LENS.fx * guess,
            fy: LENS.fy * guess,
            ..LENS
        },
        frames: &frames,
    };
    let mut source = FlowCorrespondence::new(flow);
    track(&clip, &mut source, settings, &Silent).expect("a clip that can be tracked")
}

/// Root mean square distance of camera centres after a similarity, over the length of the path.
fn path_error(tracked: &Tracked) -> f64 {
    let got: Vec<Vector3<f64>> = tracked.c2w().iter().map(|p| p.translation).collect();
    let want: Vec<Vector3<f64>> = (0..FRAMES).map(|k| camera(k).translation).collect();
    let fit = Sim3::umeyama(&got, &want).expect("a path");
    let square: f64 = got
        .iter()
        .zip(&want)
        .map(|(a, b)| (fit.transform(a) - b).norm_squared())
        .sum();
    let length: f64 = want.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    (square / FRAMES as f64).sqrt() / length
}

/// Mean `|d / d_true - 1|` over static pixels, after the median ratio of all frames is taken out.
fn depth_error(tracked: &Tracked) -> f64 {
    let mut ratios = Vec::new();
    for frame in 0..FRAMES {
        for ((u, v), &d) in pixels().zip(&tracked.geometry.disparity[frame]) {
            let (depth, moving) = cast(&camera(frame), &ball(frame), u, v);
            if !moving {
                ratios.push(f64::from(d) * depth);
            }
        }
    }
    let mut sorted = ratios.clone();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted[sorted.len() / 2];
    ratios.iter().map(|r| (r / middle - 1.0).abs()).sum::<f64>() / ratios.len() as f64
}

#[test]
fn cameras_focal_length_and_depth_are_recovered_from_flow() {
    let tracked = run(&TrackerSettings::default(), 1.25, sensor);
    let focal = tracked.geometry.lens.fx / LENS.fx - 1.0;
    let (path, depth) = (path_error(&tracked), depth_error(&tracked));
    eprintln!(
        "focal {focal:+.4}, path {path:.5}, depth {depth:.4}, rms {:.3} px",
        tracked.rms_px
    );
    assert!(tracked.focal_adjusted);
    assert!(focal.abs() < 0.02, "focal length off by {focal}");
    assert!(path < 0.02, "path off by {path}");
    assert!(depth < 0.03, "depth off by {depth}");
}

#[test]
fn without_any_hint_of_depth_the_path_is_recovered_too() {
    let settings = TrackerSettings {
        optimise_focal: false,
        ..TrackerSettings::default()
    };
    let tracked = run(&settings, 1.0, |_| vec![0.0; GRID.len()]);
    let (path, depth) = (path_error(&tracked), depth_error(&tracked));
    eprintln!(
        "path {path:.5}, depth {depth:.4}, rms {:.3} px",
        tracked.rms_px
    );
    assert_eq!(tracked.geometry.lens, LENS);
    assert!(path < 0.02, "path off by {path}");
    assert!(depth < 0.03, "depth off by {depth}");
}

/// Nothing moves but noise.
fn still(_i: usize, j: usize) -> DenseFlow {
    let mut rng = CounterRng::new(6, 0, j as u64);
    let mut plane = || {
        (0..GRID.len())
            .map(|_| (NOISE_PX * rng.normal()) as f32)
            .collect()
    };
    let ones = vec![1.0; GRID.len()];
    DenseFlow {
        flow_px: [plane(), plane()],
        confidence: ones.clone(),
        still: ones,
    }
}

#[test]
fn a_camera_on_a_tripod_stays_where_it_is() {
    let frames = inputs(sensor);
    let clip = TrackerInput {
        grid: GRID,
        lens: LENS,
        frames: &frames,
    };
    let mut source = FlowCorrespondence::new(still);
    // The published prior is too weak for noise that looks like parallax.
    let settings = TrackerSettings {
        low_parallax_alpha: 0.05,
        ..TrackerSettings::default()
    };
    let tracked = track(&clip, &mut source, &settings, &Silent).expect("two keyframes are enough");
    eprintln!(
        "{:?}, keyframes {:?}",
        tracked.observability, tracked.keyframes
    );
    assert_eq!(tracked.keyframes, [0, FRAMES - 1]);
    assert!(!tracked.focal_adjusted && tracked.geometry.lens == LENS);
    for pose in &tracked.geometry.poses {
        let moved = (pose.matrix() - Se3::identity().matrix()).amax();
        // The nearest things are 2 m away: under a hundredth of that.
        assert!(moved < 0.02, "moved by {moved}");
    }
    // With no parallax depth is that of the hints.
    let hints = sensor(0);
    let off = hints
        .iter()
        .zip(&tracked.geometry.disparity[0])
        .filter(|(h, _)| **h > 0.0);
    let off = off
        .map(|(h, d)| (d / h - 1.0).abs())
        .fold(0.0_f32, f32::max);
    assert!(off < 0.1, "depth off by {off}");
}

#[test]
fn single_frames_and_unordered_frames_are_rejected() {
    let mut frames = inputs(sensor);
    let mut source = FlowCorrespondence::new(still);
    let settings = TrackerSettings::default();
    let mut ask = |frames: &[FrameInput]| {
        let clip = TrackerInput {
            grid: GRID,
            lens: LENS,
            frames,
        };
        let error = track(&clip, &mut source, &settings, &Silent)
            .expect_err("a clip that cannot be tracked");
        error.to_string()
    };
    assert!(ask(&frames[..1]).contains("1 frame(s)"));
    frames.swap(3, 4);
    assert!(ask(&frames).starts_with("frame 3 is at"));
    frames.swap(3, 4);
    frames[1].sensor.pop();
    assert!(ask(&frames).contains("frame 1 has"));
}
