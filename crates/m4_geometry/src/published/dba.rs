//! Dense bundle adjustment against numbers of the published geometry code (f64).

use super::{Golden, difference, pose_difference};
use crate::dba::tests::{narrow, narrow_factors, narrow_geometry};
use crate::dba::{
    DbaOptions, Factor, Free, Geometry, Problem, adjust, adjust_reference, edge_system,
    observability, observability_reference, project,
};
use m4_core::{Se3, nalgebra::Vector6};

/// What the Python twin of the solver does differently from ours by default.
fn published(options: DbaOptions) -> DbaOptions {
    DbaOptions {
        min_depth: 0.2,
        python_twin: true,
        ..options
    }
}

#[test]
fn projection_and_jacobians_are_those_of_the_published_code() {
    let golden = Golden::load("geometry/projection.safetensors");
    let (grid, disparity) = golden.planes("disps");
    let poses = golden.poses("poses");
    let (sources, targets) = (golden.indices("ii"), golden.indices("jj"));
    let lens = golden.lens("intrinsics");
    let mut got: [Vec<f64>; 6] = Default::default();
    let mut valid = Vec::new();
    for (&i, &j) in sources.iter().zip(&targets) {
        let g = poses[j].compose(&poses[i].inverse());
        for n in 0..grid.len() {
            let (u, v) = ((n % grid.width) as f64, (n / grid.width) as f64);
            let p = project(&g, &lens, 1.0, u, v, disparity[i][n]);
            got[0].extend(p.pixel.iter());
            got[1].extend(p.by_source.transpose().iter());
            got[2].extend(p.by_target.transpose().iter());
            got[3].extend(p.by_disparity.iter());
            // Behind the camera, where nothing counts, the published derivative divides by the true
            // depth.
            got[4].extend(p.by_focal.iter().map(|&x| if p.z > 0.2 { x } else { 0.0 }));
            valid.push(f64::from(u8::from(p.z > 0.2)));
        }
    }
    for (got, name) in got.iter().zip(["coords", "Ji", "Jj", "Jz", "Jf"]) {
        let mut want = golden.values(name);
        if name == "Jf" {
            want.iter_mut()
                .zip(valid.iter().flat_map(|v| [v, v]))
                .for_each(|(x, v)| *x *= v);
        }
        let scale = want.iter().fold(1.0_f64, |m, x| m.max(x.abs()));
        let off = difference(got, &want);
        assert!(
            off <= 1e-10 * scale,
            "{name} is off by {off:e}, largest value {scale}"
        );
    }
    assert_eq!(valid, golden.values("valid"));
}

#[test]
fn rigid_motions_are_those_of_the_published_code() {
    let golden = Golden::load("geometry/projection.safetensors");
    let poses = golden.poses("poses");
    let xi = golden.values("xi");
    let twists: Vec<Vector6<f64>> = xi.chunks(6).map(Vector6::from_column_slice).collect();
    let exp: Vec<Se3<f64>> = twists.iter().map(Se3::exp).collect();
    let moved: Vec<Se3<f64>> = exp.iter().zip(&poses).map(|(e, p)| e.compose(p)).collect();
    let inverse: Vec<Se3<f64>> = poses.iter().map(Se3::inverse).collect();
    let (sources, targets) = (golden.indices("ii"), golden.indices("jj"));
    let pairs = sources.iter().zip(&targets);
    let relative: Vec<Se3<f64>> = pairs
        .map(|(&i, &j)| poses[j].compose(&poses[i].inverse()))
        .collect();
    for (name, got) in [
        ("exp_xi", &exp),
        ("retr", &moved),
        ("inverse", &inverse),
        ("relative", &relative),
    ] {
        let off = pose_difference(got, &golden.poses(name));
        assert!(off < 1e-10, "{name} is off by {off:e}");
    }
    let adjoint: Vec<f64> = poses
        .iter()
        .flat_map(|g| g.adjoint().transpose().as_slice().to_vec())
        .collect();
    let off = difference(&adjoint, &golden.values("adjoint"));
    assert!(off < 1e-10, "adjoint is off by {off:e}");
}

/// The inputs of the fixture of bundle adjustment.
fn problem(golden: &Golden, lens: &str) -> (Geometry<f64>, Vec<Factor<f64>>, Vec<Vec<f64>>) {
    let (grid, disparity) = golden.planes("disps");
    let geometry = Geometry {
        grid,
        lens: golden.lens(lens),
        poses: golden.poses("poses"),
        disparity,
        sensor: golden.planes("disps_sens").1,
    };
    let (target, weight) = (golden.values("target"), golden.values("weight"));
    let ends = golden.indices("ii").into_iter().zip(golden.indices("jj"));
    let factors = ends
        .enumerate()
        .map(|(e, (source, target_frame))| {
            let plane = |all: &[f64], k: usize| {
                (0..grid.len())
                    .map(|n| all[2 * (e * grid.len() + n) + k])
                    .collect()
            };
            Factor {
                source,
                target: target_frame,
                target_px: [plane(&target, 0), plane(&target, 1)],
                weight: [plane(&weight, 0), plane(&weight, 1)],
            }
        })
        .collect();
    (geometry, factors, golden.planes("eta").1)
}

/// Every case of the fixture: name, iterations stored, options and window.
fn cases() -> Vec<(&'static str, Vec<usize>, DbaOptions, std::ops::Range<usize>)> {
    let plain = DbaOptions {
        prior_alpha: None,
        ..DbaOptions::default()
    };
    let mono = DbaOptions::default();
    let pose_only = DbaOptions {
        free: Free::Poses,
        ..plain
    };
    [
        ("nomono", vec![1, 2], plain, 1..6),
        ("mono", vec![1, 2], mono, 1..6),
        ("poseonly", vec![1, 2], pose_only, 1..6),
        ("window", vec![1], mono, 2..5),
        (
            "focal_nomono",
            vec![1, 2, 4],
            DbaOptions::backend(true, None),
            1..6,
        ),
        (
            "focal_mono",
            vec![1, 2, 4],
            DbaOptions::backend(true, Some(0.05)),
            1..6,
        ),
    ]
    .map(|(name, stored, options, window)| (name, stored, published(options), window))
    .to_vec()
}

/// Compares what `solve` makes of every case: greatest differences of poses and disparities, and of
/// the focal length.
fn assert_follows(
    bound: f64,
    focal_bound: f64,
    solve: impl Fn(
        &str,
        &mut Geometry<f64>,
        &[Factor<f64>],
        &[Vec<f64>],
        std::ops::Range<usize>,
        &DbaOptions,
    ),
) {
    let golden = Golden::load("geometry/bundle_adjustment.safetensors");
    for (name, stored, options, window) in cases() {
        let lens = if options.free.focal() {
            "focal_intrinsics_0"
        } else {
            "intrinsics"
        };
        for iterations in stored {
            let (mut geometry, factors, eta) = problem(&golden, lens);
            let options = DbaOptions {
                iterations,
                ..options
            };
            solve(
                name,
                &mut geometry,
                &factors,
                &eta,
                window.clone(),
                &options,
            );
            if iterations < 4 {
                let off = pose_difference(
                    &geometry.poses,
                    &golden.poses(&format!("{name}_poses_{iterations}")),
                );
                assert!(
                    off < bound,
                    "{name}: poses after {iterations} are off by {off:e}"
                );
            }
            if options.free.depth() && iterations < 4 {
                let want = golden.values(&format!("{name}_disps_{iterations}"));
                let off = difference(&geometry.disparity.concat(), &want);
                assert!(
                    off < bound,
                    "{name}: disparities after {iterations} are off by {off:e}"
                );
            }
            if options.free.focal() {
                let want = golden.lens(&format!("{name}_intrinsics_{iterations}"));
                let off = (geometry.lens.fx - want.fx)
                    .abs()
                    .max((geometry.lens.fy - want.fy).abs());
                assert!(
                    off < focal_bound,
                    "{name}: focal length after {iterations} is off by {off:e}"
                );
            }
        }
    }
}

#[test]
fn the_reference_follows_the_published_solver() {
    assert_follows(
        1e-8,
        1e-8,
        |name, geometry, factors, eta, window, options| {
            let edges: Vec<&Factor<f64>> = factors.iter().collect();
            let problem = Problem { edges: &edges, eta };
            let failed =
                adjust_reference(geometry, &problem, window, options).expect("a sound problem");
            assert_eq!(failed, 0, "{name}");
        },
    );
}

#[test]
fn the_fast_path_follows_the_published_solver() {
    assert_follows(
        2e-5,
        5e-4,
        |name, geometry, factors, eta, window, options| {
            let mut narrowed = narrow_geometry(geometry);
            let factors = narrow_factors(factors);
            let edges: Vec<&Factor<f32>> = factors.iter().collect();
            let problem = Problem {
                edges: &edges,
                eta: &narrow(eta),
            };
            let report = adjust(&mut narrowed, &problem, window, options).expect("a sound problem");
            assert_eq!(
                (report.failed, report.iterations),
                (0, options.iterations),
                "{name}"
            );
            let wide = |plane: &Vec<f32>| plane.iter().map(|&x| f64::from(x)).collect();
            geometry.disparity = narrowed.disparity.iter().map(wide).collect();
            (geometry.poses, geometry.lens) = (narrowed.poses, narrowed.lens);
        },
    );
}

#[test]
fn the_linear_system_is_that_of_the_published_solver() {
    let golden = Golden::load("geometry/bundle_adjustment.safetensors");
    let (geometry, factors, _) = problem(&golden, "focal_intrinsics_0");
    let options = published(DbaOptions::default());
    let systems: Vec<_> = factors
        .iter()
        .map(|f| edge_system(&geometry, f, &options))
        .collect();
    let mut h = Vec::new();
    for (a, b) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        h.extend(
            systems
                .iter()
                .flat_map(|s| s.h[a][b].transpose().as_slice().to_vec()),
        );
    }
    let v: Vec<f64> = (0..2)
        .flat_map(|a| systems.iter().flat_map(move |s| s.v[a].as_slice().to_vec()))
        .collect();
    let rows = |a: usize| -> Vec<f64> {
        systems
            .iter()
            .flat_map(|s| (0..6).flat_map(move |k| s.e[a].iter().map(move |e| e[k])))
            .collect()
    };
    let flat = |part: &dyn Fn(usize) -> Vec<f64>| -> Vec<f64> {
        (0..systems.len()).flat_map(part).collect()
    };
    for (name, got) in [
        ("sys_Hpose", h),
        ("sys_vpose", v),
        ("sys_Ei", rows(0)),
        ("sys_Ej", rows(1)),
        ("sys_C", flat(&|e| systems[e].c.clone())),
        ("sys_w", flat(&|e| systems[e].b.clone())),
        ("sys_Hff", vec![systems.iter().map(|s| s.focal).sum()]),
        ("sys_vf", vec![systems.iter().map(|s| s.focal_v).sum()]),
    ] {
        let want = golden.values(name);
        let scale = want.iter().fold(1.0_f64, |m, x| m.max(x.abs()));
        let off = difference(&got, &want);
        assert!(
            off <= 1e-8 * scale,
            "{name} is off by {off:e}, largest value {scale}"
        );
    }
}

#[test]
fn observability_is_that_of_the_published_code() {
    let golden = Golden::load("geometry/bundle_adjustment.safetensors");
    let want = golden.values("observability");
    let (geometry, factors, eta) = problem(&golden, "focal_intrinsics_0");
    let options = published(DbaOptions::default());
    let edges: Vec<&Factor<f64>> = factors.iter().collect();
    let got = observability_reference(&geometry, &edges, &options);
    assert!(
        difference(&[got.depth, got.focal], &want) < 1e-8,
        "{got:?}, {want:?}"
    );
    let factors: Vec<Factor<f32>> = narrow_factors(&factors);
    let edges: Vec<&Factor<f32>> = factors.iter().collect();
    let problem = Problem {
        edges: &edges,
        eta: &narrow(&eta),
    };
    let got =
        observability(&narrow_geometry(&geometry), &problem, &options).expect("a sound problem");
    assert!(
        difference(&[got.depth, got.focal], &want) < 1e-4,
        "{got:?}, {want:?}"
    );
}
