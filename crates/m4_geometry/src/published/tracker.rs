//! Distances, choices of edges, front end and back end, with an oracle in place of the network.

use super::{Golden, difference, pose_difference};
use crate::dba::{Geometry, Pinhole, project};
use crate::megasam::graph::{
    EdgeChanges, FactorGraph, GraphEdge, ProximitySettings, frame_distance,
    frame_distance_reference, neighbourhood, select_proximity,
};
use crate::megasam::prior::MonoAlignment;
use crate::megasam::tracker::{
    Backend, Correspondence, CorrespondenceError, FrameInput, Frontend, Keyframes,
    PUBLISHED_TIME_GUARD, Revision, Submitted, TrackerSettings, interpolate_pose,
};
use m4_core::{Se3, Silent};

/// The true reprojection, at most 8 pixels from the present one.
struct Oracle {
    poses: Vec<Se3<f64>>,
    disparity: Vec<Vec<f64>>,
    lens: Pinhole<f64>,
}

impl Oracle {
    fn new(golden: &Golden) -> Self {
        Self {
            poses: golden.poses("gt_poses"),
            disparity: golden.planes("gt_disps").1,
            lens: golden.lens("intrinsics"),
        }
    }
}

impl Correspondence for Oracle {
    fn change(&mut self, _changes: &EdgeChanges) -> Result<(), CorrespondenceError> {
        Ok(())
    }

    fn revise(&mut self, revision: &mut Revision<'_>) -> Result<(), CorrespondenceError> {
        for edge in &mut revision.edges {
            let (i, j) = (edge.key.source_frame, edge.key.target_frame);
            let g = self.poses[j].compose(&self.poses[i].inverse());
            for n in 0..revision.grid.len() {
                let (u, v) = (
                    (n % revision.grid.width) as f64,
                    (n / revision.grid.width) as f64,
                );
                let p = project(&g, &self.lens, 1.0, u, v, self.disparity[i][n]).pixel;
                for k in 0..2 {
                    let from = f64::from(edge.projected_px[k][n]);
                    edge.target_px[k][n] = (from + (p[k] - from).clamp(-8.0, 8.0)) as f32;
                }
            }
            for plane in edge.weight.iter_mut() {
                plane.fill(0.8);
            }
            edge.static_confidence.fill(0.9);
        }
        for source in &mut revision.sources {
            source.damping.fill(0.005);
        }
        Ok(())
    }

    fn motion_px(&mut self, _from: usize, _to: usize) -> Result<f64, CorrespondenceError> {
        Ok(f64::INFINITY)
    }
}

/// The trace was made with the Python twin of the solver.
fn settings() -> TrackerSettings {
    TrackerSettings {
        min_depth: 0.2,
        python_twin: true,
        ..TrackerSettings::default()
    }
}

fn sorted(mut pairs: Vec<(usize, usize)>) -> Vec<(usize, usize)> {
    pairs.sort_unstable();
    pairs
}

fn ends(edges: &[GraphEdge]) -> Vec<(usize, usize)> {
    edges.iter().map(GraphEdge::ends).collect()
}

fn numbers(plane: &[Vec<f32>]) -> Vec<f64> {
    plane.concat().into_iter().map(f64::from).collect()
}

#[test]
fn the_front_end_follows_the_published_trace() {
    let golden = Golden::load("geometry/frontend_trace.safetensors");
    let mut oracle = Oracle::new(&golden);
    let (grid, sensor) = golden.planes("sensor_disps");
    let mut frontend = Frontend::new(grid, oracle.lens, settings());
    let mut distances = Vec::new();
    for (frame, plane) in sensor.iter().enumerate() {
        let input = FrameInput {
            frame,
            time_s: frame as f64,
            sensor: plane.iter().map(|&x| x as f32).collect(),
        };
        let done = frontend
            .submit(&input, false, &mut oracle)
            .expect("a sound trace");
        match done {
            Submitted::Tracked { distance_px, .. } => distances.push(distance_px),
            Submitted::Waiting => assert!(frame < 7),
            Submitted::Initialised => assert_eq!(frame, 7),
            Submitted::Skipped => panic!("no frame is skipped"),
        }
        if frame < 7 {
            continue;
        }
        let at = |name: &str| format!("s{frame:02}_{name}");
        assert_eq!(
            frontend.keyframes.frame,
            golden.indices(&at("frame")),
            "frame {frame}"
        );
        let active = golden
            .indices(&at("ii"))
            .into_iter()
            .zip(golden.indices(&at("jj")));
        assert_eq!(
            sorted(ends(&frontend.graph.active)),
            sorted(active.collect()),
            "active after frame {frame}"
        );
        let inactive = golden.pairs(&at("inac"));
        assert_eq!(
            sorted(ends(&frontend.graph.inactive)),
            sorted(inactive),
            "inactive after frame {frame}"
        );
        let ages: Vec<usize> = frontend
            .graph
            .active
            .iter()
            .map(|e| e.age as usize)
            .collect();
        assert_eq!(ages, golden.indices(&at("age")), "ages after frame {frame}");
        let off = pose_difference(
            &frontend.keyframes.geometry.poses,
            &golden.poses(&at("poses")),
        );
        assert!(off < 1e-4, "poses after frame {frame} are off by {off:e}");
    }
    let off = difference(&distances, &golden.values("distances"));
    assert!(off < 1e-3, "distances are off by {off:e}");
    assert_eq!(frontend.keyframes.frame, golden.indices("final_frame"));
    // the published times stay behind when a keyframe is dropped; ours go with their frames
    let times: Vec<f64> = frontend.keyframes.frame.iter().map(|&f| f as f64).collect();
    assert_eq!(frontend.keyframes.time_s, times);
    let off = difference(
        &numbers(&frontend.keyframes.geometry.disparity),
        &golden.values("final_disps"),
    );
    assert!(off < 1e-3, "disparities are off by {off:e}");
}

/// The state that the back end starts from.
fn backend_input(golden: &Golden, front: &Golden, lens: Pinhole<f64>) -> Keyframes {
    let (grid, disparity) = golden.planes("in_disps");
    let sensor = front.planes("sensor_disps").1;
    let mut keyframes = Keyframes::new(grid, lens);
    let poses = golden.poses("in_poses");
    for (k, frame) in golden.indices("in_frame").into_iter().enumerate() {
        let input = FrameInput {
            frame,
            time_s: frame as f64,
            sensor: sensor[frame].iter().map(|&x| x as f32).collect(),
        };
        keyframes.push(&input, poses[k], None);
        keyframes.geometry.disparity[k] = disparity[k].iter().map(|&x| x as f32).collect();
    }
    keyframes
}

#[test]
fn the_back_end_follows_the_published_trace() {
    let golden = Golden::load("geometry/backend_trace.safetensors");
    let front = Golden::load("geometry/frontend_trace.safetensors");
    let mut oracle = Oracle::new(&front);
    let lens = oracle.lens;
    let mut keyframes = backend_input(&golden, &front, lens);
    let mut backend = Backend::new(&keyframes, settings());
    assert_eq!(
        sorted(ends(&backend.graph.active)),
        sorted(golden.pairs("edges"))
    );
    backend
        .run(&mut keyframes, &mut oracle, 2, false, Some(1e-5), &Silent)
        .expect("a sound trace");
    let off = pose_difference(&keyframes.geometry.poses, &golden.poses("A_poses"));
    assert!(off < 1e-4, "poses are off by {off:e}");
    let off = difference(
        &numbers(&keyframes.geometry.disparity),
        &golden.values("A_disps"),
    );
    assert!(off < 1e-3, "disparities are off by {off:e}");
    let off = difference(
        &numbers(&backend.static_confidence(&keyframes)),
        &golden.values("A_motion_prob"),
    );
    assert!(off < 1e-5, "static confidence is off by {off:e}");
    let actual = backend.observability(&keyframes).expect("a sound graph");
    let want = golden.values("A_observability");
    assert!(
        (actual.depth / want[0] - 1.0).abs() < 1e-3 && (actual.focal / want[1] - 1.0).abs() < 1e-3,
        "{actual:?}, {want:?}"
    );

    let mut keyframes = backend_input(&golden, &front, golden.lens("B_intrinsics_in"));
    let mut backend = Backend::new(&keyframes, settings());
    backend
        .run(&mut keyframes, &mut oracle, 3, true, None, &Silent)
        .expect("a sound trace");
    let want = golden.lens("B_intrinsics");
    assert!(
        (keyframes.geometry.lens.fx - want.fx).abs() < 1e-3,
        "{:?}, {want:?}",
        keyframes.geometry.lens
    );
    let off = pose_difference(&keyframes.geometry.poses, &golden.poses("B_poses"));
    assert!(
        off < 1e-4,
        "poses with a free focal length are off by {off:e}"
    );
    let off = difference(
        &numbers(&keyframes.geometry.disparity),
        &golden.values("B_disps"),
    );
    assert!(
        off < 1e-3,
        "disparities with a free focal length are off by {off:e}"
    );
}

#[test]
fn interpolated_poses_are_those_of_the_published_code() {
    let golden = Golden::load("ops/pose_interpolation.safetensors");
    let (times, keys) = (golden.values("key_times"), golden.poses("key_poses"));
    let got: Vec<Se3<f64>> = golden
        .values("times")
        .iter()
        .map(|&t| interpolate_pose(&times, &keys, t, PUBLISHED_TIME_GUARD))
        .collect();
    let off = pose_difference(&got, &golden.poses("poses"));
    assert!(off < 1e-9, "poses are off by {off:e}");
    let exact = interpolate_pose(&times, &keys, times[1], 0.0);
    assert!(pose_difference(&[exact], &keys[1..2]) < 1e-12);
}

#[test]
fn mono_depth_is_aligned_as_in_the_published_code() {
    let golden = Golden::load("geometry/mono_alignment.safetensors");
    let planes = |name: &str| -> Vec<Vec<f32>> {
        let all = golden.planes(name).1;
        all.iter()
            .map(|p| p.iter().map(|&x| x as f32).collect())
            .collect()
    };
    let relative = planes("mono_disp");
    let got = MonoAlignment::new(&planes("metric_depth"), &relative).expect("sound depth");
    assert_eq!(got.index, golden.indices("index")[0]);
    assert!(difference(&got.scales, &golden.values("scales")) < 1e-5);
    assert!(difference(&got.shifts, &golden.values("shifts")) < 1e-5);
    assert!((got.norm - golden.values("norm")[0]).abs() < 1e-5);
    let depth: Vec<Vec<f32>> = relative.iter().map(|a| got.sensor_depth(a)).collect();
    let off = difference(&numbers(&depth), &golden.values("sensor_depth"));
    assert!(off < 1e-5, "sensor depth is off by {off:e}");
}

fn geometry(golden: &Golden) -> Geometry<f32> {
    let (grid, disparity) = golden.planes("disps");
    let disparity: Vec<Vec<f32>> = disparity
        .iter()
        .map(|p| p.iter().map(|&x| x as f32).collect())
        .collect();
    Geometry {
        grid,
        lens: golden.lens("intrinsics"),
        poses: golden.poses("poses"),
        sensor: vec![vec![0.0; grid.len()]; disparity.len()],
        disparity,
    }
}

#[test]
fn distances_are_those_of_the_published_code() {
    let golden = Golden::load("geometry/edges.safetensors");
    let geometry = geometry(&golden);
    let n = geometry.frames();
    for (name, beta) in [("dist_directed_b025", 0.25), ("dist_directed_b03", 0.3)] {
        let want = golden.values(name);
        assert!(want.contains(&1000.0) && want.iter().any(|&d| d > 1.0 && d < 10.0));
        for i in 0..n {
            for j in 0..n {
                let slow = frame_distance_reference(&geometry, i, j, beta);
                let fast = frame_distance(&geometry, i, j, beta);
                let want = want[i * n + j];
                assert!(
                    (slow - want).abs() < 5e-6,
                    "{name} {i} {j}: {slow} where {want} was expected"
                );
                assert!(
                    (fast - want).abs() < 2e-5,
                    "{name} {i} {j}: {fast} where {want} was expected"
                );
            }
        }
    }
}

/// The mean of both directions, from the stored matrix.
fn stored(golden: &Golden, name: &str) -> impl Fn(&[(usize, usize)]) -> Vec<f64> {
    let all = golden.values(name);
    let n = (all.len() as f64).sqrt() as usize;
    move |pairs| {
        pairs
            .iter()
            .map(|&(i, j)| 0.5 * (all[i * n + j] + all[j * n + i]))
            .collect()
    }
}

/// The back end's choice for 24 keyframes.
const BACKEND: ProximitySettings = ProximitySettings {
    first_source: 0,
    first_target: 0,
    radius: 2,
    suppression: 3,
    threshold_px: 16.0,
    beta: 0.3,
    max_factors: 16 * 24,
};

#[test]
fn chosen_edges_are_those_of_the_published_code() {
    let golden = Golden::load("geometry/edges.safetensors");
    let edges = select_proximity(24, &[], &BACKEND, stored(&golden, "dist_directed_b03"));
    assert_eq!(edges, golden.pairs("backend_edges"));
    let tight = ProximitySettings {
        radius: 1,
        suppression: 1,
        threshold_px: 6.0,
        beta: 0.25,
        ..BACKEND
    };
    let edges = select_proximity(24, &[], &tight, stored(&golden, "dist_directed_b025"));
    assert_eq!(edges, golden.pairs("tight_edges"));
    let near = neighbourhood(0, 8, 3);
    assert_eq!(near, golden.pairs("frontend_init_neighborhood"));
}

/// Adds what a choice from the stored distances gives.
fn add(
    graph: &mut FactorGraph,
    golden: &Golden,
    matrix: &str,
    settings: &ProximitySettings,
    make_room: bool,
) {
    let geometry = geometry(golden);
    let frames: Vec<usize> = (0..geometry.frames()).collect();
    let pairs = select_proximity(24, &graph.all_pairs(), settings, stored(golden, matrix));
    graph.add(&pairs, &geometry, &frames, make_room);
}

#[test]
fn the_front_end_adds_and_retires_as_the_published_code() {
    let golden = Golden::load("geometry/edges.safetensors");
    let geometry = geometry(&golden);
    let frames: Vec<usize> = (0..geometry.frames()).collect();
    let mut graph = FactorGraph::new(48).with_permuted_ranks(true);
    let list = |name: &str| -> Vec<(usize, usize)> {
        let (a, b) = (name.replace("ij", "ii"), name.replace("ij", "jj"));
        golden
            .indices(&a)
            .into_iter()
            .zip(golden.indices(&b))
            .collect()
    };
    // The inactive ones are added first and retired, so that they come first.
    graph.add(&list("frontend_before_ij_inac"), &geometry, &frames, false);
    graph.retire(|_| true);
    graph.add(&list("frontend_before_ij"), &geometry, &frames, false);
    for (edge, age) in graph
        .active
        .iter_mut()
        .zip(golden.indices("frontend_before_age"))
    {
        edge.age = age as u32;
    }
    graph.bad = list("frontend_before_ij_bad");
    graph.take_changes();
    let settings = ProximitySettings {
        first_source: 19,
        suppression: 1,
        threshold_px: 12.0,
        max_factors: 48,
        ..BACKEND
    };
    add(&mut graph, &golden, "dist_directed_b03", &settings, true);
    assert_eq!(ends(&graph.active), list("frontend_after_ij"));
    assert_eq!(ends(&graph.inactive), list("frontend_after_ij_inac"));
    let changes = graph.take_changes();
    assert_eq!((changes.entered.len(), changes.left.len()), (50, 24));
}

#[test]
fn the_initial_choice_is_that_of_the_published_code() {
    let golden = Golden::load("geometry/edges.safetensors");
    let geometry = geometry(&golden);
    let frames: Vec<usize> = (0..geometry.frames()).collect();
    let mut graph = FactorGraph::new(48).with_permuted_ranks(true);
    graph.add(&neighbourhood(0, 8, 3), &geometry, &frames, false);
    let settings = ProximitySettings {
        suppression: 2,
        threshold_px: 12.0,
        beta: 0.25,
        max_factors: 48,
        ..BACKEND
    };
    add(&mut graph, &golden, "dist_directed_b025", &settings, false);
    assert_eq!(ends(&graph.active), golden.pairs("frontend_init_edges"));
}

#[test]
fn removing_a_keyframe_renumbers_the_rest() {
    let golden = Golden::load("geometry/edges.safetensors");
    let geometry = geometry(&golden);
    let frames: Vec<usize> = (0..geometry.frames()).map(|k| 2 * k).collect();
    let mut graph = FactorGraph::new(48);
    graph.add(&[(0, 1), (1, 2), (2, 3), (3, 2)], &geometry, &frames, false);
    graph.bad = vec![(4, 2), (5, 3)];
    graph.remove_frame(2);
    assert_eq!(ends(&graph.active), [(0, 1)]);
    assert_eq!(graph.bad, [(4, 2)]);
    graph.add(&[(2, 3), (3, 1)], &geometry, &frames, false);
    graph.active[1].age = 5;
    graph.max_factors = 3;
    graph.add(&[(0, 3)], &geometry, &frames, true);
    assert_eq!(ends(&graph.active), [(0, 1), (3, 1), (0, 3)]);
    assert_eq!(ends(&graph.inactive), [(2, 3)]);
    let changes = graph.take_changes();
    assert_eq!((changes.entered.len(), changes.left.len()), (7, 4));
    assert_eq!(
        (
            changes.entered[3].source_frame,
            changes.entered[3].target_frame
        ),
        (6, 4)
    );
}
