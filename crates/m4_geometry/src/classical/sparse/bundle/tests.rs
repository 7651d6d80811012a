//! Derivatives against differences, and known answers.

use super::{Bend, Bundle, BundleOptions, Jacobian, Observation, project};
use m4_core::{
    CounterRng, Se3, Silent, Sim3, exp_so3,
    nalgebra::{Vector3, Vector6},
};

/// Eight cameras on an arc around 60 points, all seen everywhere, every tenth sighting wrong.
fn scene() -> Bundle {
    let mut rng = CounterRng::new(11, 0, 0);
    let poses: Vec<Se3<f64>> = (0..8)
        .map(|i| Se3 {
            rotation: exp_so3(&Vector3::new(
                0.02,
                0.08 * f64::from(i),
                0.01 * f64::from(i),
            )),
            translation: Vector3::new(0.05 * f64::from(i), 0.0, 5.0),
        })
        .collect();
    let points: Vec<Vector3<f64>> = (0..60)
        .map(|_| Vector3::from_fn(|_, _| 1.2 * rng.normal()))
        .collect();
    let mut observations = Vec::new();
    for (point, x) in points.iter().enumerate() {
        for (pose, w2c) in poses.iter().enumerate() {
            let p = w2c.transform(x);
            let off = if observations.len() % 10 == 9 {
                30.0 * rng.normal()
            } else {
                0.0
            };
            observations.push(Observation {
                pose,
                point,
                at: [400.0 * p.x / p.z + off, 400.0 * p.y / p.z],
            });
        }
    }
    Bundle {
        weights: vec![1.0; points.len()],
        poses,
        points,
        log_focal: 400.0_f64.ln(),
        bend: Bend::NONE,
        observations,
    }
}

fn options(free_focal: bool) -> BundleOptions {
    BundleOptions {
        cauchy_px: 1.0,
        iterations: 60,
        tolerance: 1e-9,
        free_focal,
        free_bend: false,
    }
}

#[test]
fn poses_points_and_focal_length_return_to_the_truth() {
    let truth = scene();
    let mut rng = CounterRng::new(12, 0, 0);
    let mut bundle = truth.clone();
    for pose in bundle.poses.iter_mut().skip(1) {
        *pose = pose.retract(&Vector6::from_fn(|_, _| 0.01 * rng.normal()));
    }
    for point in &mut bundle.points {
        *point += Vector3::from_fn(|_, _| 0.03 * rng.normal());
    }
    bundle.log_focal += 0.08;
    let report = bundle.adjust(&options(true), &Silent);
    assert!(
        (bundle.focal() / 400.0 - 1.0).abs() < 2e-3,
        "{}",
        bundle.focal()
    );
    let fit = Sim3::umeyama(&bundle.points, &truth.points).expect("a cloud");
    let worst = bundle
        .points
        .iter()
        .zip(&truth.points)
        .map(|(a, b)| (fit.transform(a) - b).norm())
        .fold(0.0, f64::max);
    assert!(worst < 0.02, "{worst}");
    assert!(
        report.log_focal_sigma > 1e-4 && report.log_focal_sigma < 0.05,
        "{report:?}"
    );
    assert_eq!(bundle.poses[0], truth.poses[0]);
}

#[test]
fn a_free_coefficient_explains_a_lens_that_bends() {
    let mut bundle = scene();
    let bend = Bend {
        coefficient: -0.25,
        radius_px: 400.0,
    };
    for o in &mut bundle.observations {
        o.at = bend.distorted(o.at).expect("barrels show all");
    }
    let straight = bundle.clone().adjust(&options(true), &Silent);
    bundle.bend = Bend {
        coefficient: 0.0,
        ..bend
    };
    let free = BundleOptions {
        free_bend: true,
        ..options(true)
    };
    let report = bundle.adjust(&free, &Silent);
    let coefficient = bundle.bend.coefficient;
    assert!((coefficient + 0.25).abs() < 5e-3, "{coefficient}");
    assert!(
        (bundle.focal() / 400.0 - 1.0).abs() < 5e-3,
        "{}",
        bundle.focal()
    );
    assert!(report.cost < straight.cost, "{report:?} {straight:?}");
    assert!(
        report.bend_sigma > 1e-5 && report.bend_sigma < 0.05,
        "{report:?}"
    );
    assert_eq!(straight.bend_sigma, f64::INFINITY);
}

#[test]
fn a_fixed_focal_length_stays_and_cost_never_rises() {
    let mut bundle = scene();
    bundle.log_focal += 0.05;
    let before = bundle.cost(&options(false)) / bundle.observations.len() as f64;
    let focal = bundle.log_focal;
    let report = bundle.adjust(&options(false), &Silent);
    assert!(report.cost < before && report.log_focal_sigma.is_infinite());
    assert_eq!(bundle.log_focal, focal);
}

#[test]
fn nothing_to_adjust_is_no_error() {
    let mut bundle = Bundle {
        poses: Vec::new(),
        points: Vec::new(),
        weights: Vec::new(),
        log_focal: 6.0,
        bend: Bend::NONE,
        observations: Vec::new(),
    };
    assert_eq!(bundle.adjust(&options(true), &Silent).cost, 0.0);
}

#[test]
fn derivatives_match_central_differences() {
    let pose = Se3 {
        rotation: exp_so3(&Vector3::new(0.3, -0.5, 0.2)),
        translation: Vector3::new(0.2, -0.4, 3.0),
    };
    let (x, focal, at) = (Vector3::new(0.7, -0.3, 1.1), 420.0_f64, [30.0, -12.0]);
    // A huge scale makes all weights 1.
    let bend = Bend {
        coefficient: -0.2,
        radius_px: 300.0,
    };
    let j = Jacobian::new(&pose, &x, focal, bend, at, 1e9);
    // Variables 0 to 5: the pose, 6 to 8: the point, 9: the logarithm of the focal length, 10:
    // the coefficient of the distortion.
    let moved = |k: usize, h: f64| {
        let step = |from: usize| move |i: usize, _: usize| if from + i == k { h } else { 0.0 };
        let focal = if k == 9 { focal * h.exp() } else { focal };
        let coefficient = bend.coefficient + if k == 10 { h } else { 0.0 };
        let bend = Bend {
            coefficient,
            ..bend
        };
        project(
            &pose.retract(&Vector6::from_fn(step(0))),
            &(x + Vector3::from_fn(step(6))),
            focal,
            bend,
            at,
        )
    };
    let h = 1e-6;
    for k in 0..11 {
        let (a, b) = (
            moved(k, h).expect("in front"),
            moved(k, -h).expect("in front"),
        );
        for i in 0..2 {
            let want = match k {
                0..6 => j.pose[(i, k)],
                6..9 => j.point[(i, k - 6)],
                _ => j.lens[k - 9][i],
            };
            assert!(
                ((a[i] - b[i]) / (2.0 * h) - want).abs() < 1e-4,
                "variable {k}, component {i}"
            );
        }
    }
}

#[test]
fn behind_the_camera_nothing_pulls() {
    let j = Jacobian::new(
        &Se3::identity(),
        &Vector3::new(0.0, 0.0, -1.0),
        400.0,
        Bend::NONE,
        [0.0, 0.0],
        1.0,
    );
    assert_eq!(
        (j.residual.norm(), j.pose.norm(), j.point.norm()),
        (0.0, 0.0, 0.0)
    );
}
