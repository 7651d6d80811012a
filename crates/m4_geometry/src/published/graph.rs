//! Distances and choices of edges against numbers of the published code.

use super::Golden;
use crate::dba::Geometry;
use crate::megasam::graph::{
    FactorGraph, ProximitySettings, frame_distance, frame_distance_reference, neighbourhood, select_proximity,
};

fn geometry(golden: &Golden) -> Geometry<f32> {
    let (grid, disparity) = golden.planes("disps");
    let disparity: Vec<Vec<f32>> = disparity.iter().map(|p| p.iter().map(|&x| x as f32).collect()).collect();
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
                assert!((slow - want).abs() < 5e-6, "{name} {i} {j}: {slow} where {want} was expected");
                assert!((fast - want).abs() < 2e-5, "{name} {i} {j}: {fast} where {want} was expected");
            }
        }
    }
}

/// The mean of both directions, from the stored matrix.
fn stored(golden: &Golden, name: &str) -> impl Fn(&[(usize, usize)]) -> Vec<f64> {
    let all = golden.values(name);
    let n = (all.len() as f64).sqrt() as usize;
    move |pairs| pairs.iter().map(|&(i, j)| 0.5 * (all[i * n + j] + all[j * n + i])).collect()
}

#[test]
fn chosen_edges_are_those_of_the_published_code() {
    let golden = Golden::load("geometry/edges.safetensors");
    let backend = ProximitySettings {
        first_source: 0,
        first_target: 0,
        radius: 2,
        suppression: 3,
        threshold_px: 16.0,
        beta: 0.3,
        max_factors: 16 * 24,
    };
    let edges = select_proximity(24, &[], &backend, stored(&golden, "dist_directed_b03"));
    assert_eq!(edges, golden.pairs("backend_edges"));
    let tight = ProximitySettings { radius: 1, suppression: 1, threshold_px: 6.0, beta: 0.25, ..backend };
    let edges = select_proximity(24, &[], &tight, stored(&golden, "dist_directed_b025"));
    assert_eq!(edges, golden.pairs("tight_edges"));
    let near = neighbourhood(0, 8, 3);
    assert_eq!(near, golden.pairs("frontend_init_neighborhood"));
}

/// Adds what a choice from the stored distances gives.
fn add(graph: &mut FactorGraph, golden: &Golden, matrix: &str, settings: &ProximitySettings, make_room: bool) {
    let geometry = geometry(golden);
    let frames: Vec<usize> = (0..geometry.frames()).collect();
    let pairs = select_proximity(24, &graph.all_pairs(), settings, stored(golden, matrix));
    graph.add(&pairs, &geometry, &frames, make_room);
}

fn ends(edges: &[crate::megasam::graph::GraphEdge]) -> Vec<(usize, usize)> {
    edges.iter().map(|e| e.ends()).collect()
}

#[test]
fn the_front_end_adds_and_retires_as_the_published_code() {
    let golden = Golden::load("geometry/edges.safetensors");
    let geometry = geometry(&golden);
    let frames: Vec<usize> = (0..geometry.frames()).collect();
    let mut graph = FactorGraph::new(48).with_permuted_ranks(true);
    let list = |name: &str| -> Vec<(usize, usize)> {
        let (a, b) = (name.replace("ij", "ii"), name.replace("ij", "jj"));
        golden.indices(&a).into_iter().zip(golden.indices(&b)).collect()
    };
    // The inactive ones are added first and retired, so that they come first.
    graph.add(&list("frontend_before_ij_inac"), &geometry, &frames, false);
    graph.retire(|_| true);
    graph.add(&list("frontend_before_ij"), &geometry, &frames, false);
    for (edge, age) in graph.active.iter_mut().zip(golden.indices("frontend_before_age")) {
        edge.age = age as u32;
    }
    graph.bad = list("frontend_before_ij_bad");
    graph.take_changes();
    let settings = ProximitySettings {
        first_source: 19,
        first_target: 0,
        radius: 2,
        suppression: 1,
        threshold_px: 12.0,
        beta: 0.3,
        max_factors: 48,
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
    graph.add_neighbourhood(0, 8, 3, &geometry, &frames);
    let settings = ProximitySettings {
        first_source: 0,
        first_target: 0,
        radius: 2,
        suppression: 2,
        threshold_px: 12.0,
        beta: 0.25,
        max_factors: 48,
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
    assert_eq!((changes.entered[3].source_frame, changes.entered[3].target_frame), (6, 4));
}
