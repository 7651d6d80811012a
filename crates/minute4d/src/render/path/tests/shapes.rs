//! Spiral, arc and dolly.

use super::{NONE, scene};
use crate::render::path::{PathConfig, PathOptions, shapes};
use crate::render::{Region, Stop};
use m4_math::log_so3;
use m4_scene::Camera;

fn region(reach: [f64; 3], distance: f64, near: f64) -> Region {
    let source = scene(0.0).source[10];
    Region {
        stop: Stop {
            camera: source.camera,
            t: source.t,
            exposure: source.exposure,
        },
        distance,
        near,
        reach,
    }
}

#[test]
fn a_spiral_closes_and_keeps_looking_at_the_middle() {
    let region = region([0.2, 0.1, 0.15], 4.0, 2.0);
    let config = PathConfig::default();
    let at = |share: f64| shapes::spiral(&region, share, &NONE, &config);
    let gap = (at(0.0).c2w.matrix() - at(1.0).c2w.matrix()).norm();
    assert!(gap < 1e-12, "{gap}");
    for i in 0..100 {
        let camera = at(f64::from(i) / 100.0);
        let ([u, v], z) = camera.project(&region.pivot());
        assert!(
            (u - 31.5).abs() < 1e-9 && (v - 23.5).abs() < 1e-9 && z > 3.0,
            "{u} {v} {z}"
        );
        let step = (at(f64::from(i + 1) / 100.0).centre() - camera.centre()).norm();
        assert!(step > 1e-3 && step < 0.1, "{step}");
    }
    // The reach of 0.05 of the distance is within the limits, so half the width is that; asked for half, it is half.
    let half_width = |options: &PathOptions| {
        let side = region.stop.camera.c2w.rotation.column(0).into_owned();
        let ways = (0..400).map(|i| {
            let camera = shapes::spiral(&region, f64::from(i) / 400.0, options, &config);
            side.dot(&(camera.centre() - region.stop.camera.centre()))
        });
        ways.fold(0.0, f64::max)
    };
    assert!((half_width(&NONE) - 0.2).abs() < 1e-9);
    let half = PathOptions {
        amount: Some(0.5),
        ..NONE
    };
    assert!((half_width(&half) - 0.1).abs() < 1e-9);
    let radius = PathOptions {
        radius: Some(0.25),
        ..NONE
    };
    assert!((half_width(&radius) - 1.0).abs() < 1e-9);
}

#[test]
fn an_arc_goes_from_side_to_side_at_one_distance() {
    let region = region([10.0, 0.0, 0.0], 4.0, 2.0);
    let config = PathConfig::default();
    let at = |share: f64| shapes::arc(&region, share, &NONE, &config);
    let turn = |a: &Camera, b: &Camera| {
        log_so3(&(a.c2w.rotation.transpose() * b.c2w.rotation))
            .norm()
            .to_degrees()
    };
    // A wide reach is cut at the limit.
    assert!((turn(&at(0.0), &at(1.0)) - 2.0 * config.side_deg[1]).abs() < 1e-9);
    assert!(turn(&at(0.5), &region.stop.camera) < 1e-9);
    for i in 0..=20 {
        let ([u, v], z) = at(f64::from(i) / 20.0).project(&region.pivot());
        assert!((u - 31.5).abs() < 1e-9 && (v - 23.5).abs() < 1e-9 && (z - 4.0).abs() < 1e-9);
    }
    let forty = PathOptions {
        degrees: Some(20.0),
        ..NONE
    };
    let (a, b) = (
        shapes::arc(&region, 0.0, &forty, &config),
        shapes::arc(&region, 1.0, &forty, &config),
    );
    assert!((turn(&a, &b) - 40.0).abs() < 1e-9);
}

#[test]
fn a_dolly_does_not_enter_what_is_near() {
    let config = PathConfig::default();
    let region = region([0.0, 0.0, 4.0], 4.0, 0.5);
    let far = PathOptions {
        amount: Some(10.0),
        ..NONE
    };
    let axis = region.stop.camera.c2w.rotation.column(2).into_owned();
    for i in 0..=50 {
        let camera = shapes::dolly(&region, f64::from(i) / 50.0, &far, &config);
        let way = camera.centre() - region.stop.camera.centre();
        assert!((way - axis * axis.dot(&way)).norm() < 1e-12, "along the axis");
        assert!(
            (-1e-12..=0.25 + 1e-12).contains(&axis.dot(&way)),
            "half of the way to the nearest"
        );
        assert_eq!(camera.c2w.rotation, region.stop.camera.c2w.rotation);
    }
    let ends = [0.0, 1.0].map(|share| shapes::dolly(&region, share, &far, &config).centre());
    assert!((ends[0] - ends[1]).norm() < 1e-12 && (ends[0] - region.stop.camera.centre()).norm() < 1e-12);
}

#[test]
fn a_dolly_zoom_keeps_the_size_of_what_is_in_the_middle() {
    let config = PathConfig::default();
    let region = region([0.0, 0.0, 0.8], 4.0, 2.0);
    let zoom = PathOptions {
        dolly_zoom: true,
        ..NONE
    };
    let side = region.stop.camera.c2w.rotation.column(0).into_owned();
    let beside = region.pivot() + side * 0.5;
    let before = region.stop.camera.project(&beside).0[0];
    let mut focals = Vec::new();
    for i in 0..=20 {
        let camera = shapes::dolly(&region, f64::from(i) / 20.0, &zoom, &config);
        assert!((camera.project(&beside).0[0] - before).abs() < 1e-9);
        focals.push(camera.intrinsics.fx);
    }
    let widest = focals.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(
        (widest - focals[0]).abs() < 1e-9 && focals[10] > 1.1 * focals[0],
        "{focals:?}"
    );
}
