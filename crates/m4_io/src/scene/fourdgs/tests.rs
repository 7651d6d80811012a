//! A scene to the bytes of a file and back.

use super::{encode, parse};
use crate::ErrorKind;
use crate::scene::{Loss, at_peak};
use m4_core::{
    Column, Scene, SplatLayout, Splats,
    nalgebra::{Vector3, Vector4},
};
use m4_testkit::{SceneSpec, random_scene};
use std::path::Path;

fn scene(sh_degree: usize, time_degree: usize, isotropic: bool) -> Scene {
    random_scene(&SceneSpec {
        layout: SplatLayout {
            isotropic,
            sh_degree,
            time_degree,
        },
        n_static: 300,
        n_dynamic: 400,
        time_frames: 31,
        ..SceneSpec::default()
    })
}

fn name() -> &'static Path {
    Path::new("scene.4dgs")
}

/// The rows of `actual` in the order of the rows of `want`, by the nearest means.
fn matched(want: &Splats, actual: &Splats) -> Vec<usize> {
    let mean = |s: &Splats, i: usize| Vector3::from_fn(|k, _| s.column(Column::Mean, k)[i]);
    (0..want.n())
        .map(|i| {
            let is_static = i < want.n_static();
            let same_kind = |&j: &usize| (j < actual.n_static()) == is_static;
            let distance = |&j: &usize| (mean(actual, j) - mean(want, i)).norm();
            (0..actual.n())
                .filter(same_kind)
                .min_by(|a, b| distance(a).total_cmp(&distance(b)))
                .unwrap()
        })
        .collect()
}

#[test]
fn fourdgs_round_trips_within_bounds() {
    for (sh_degree, time_degree, isotropic) in [(0, 0, false), (3, 1, false), (1, 0, true)] {
        let scene = scene(sh_degree, time_degree, isotropic);
        let (bytes, _) = encode(name(), &scene).unwrap();
        let back = parse(name(), &bytes).unwrap().scene;
        let want = at_peak(&scene.splats);
        let (a, b) = (&*want, &back.splats);
        assert_eq!((a.n_static(), a.n_dynamic()), (b.n_static(), b.n_dynamic()));
        assert_eq!(b.layout().sh_degree, sh_degree);
        let mut scales: Vec<f32> = (0..a.n())
            .flat_map(|i| crate::scene::splats::Row::of(a, i).log_scale)
            .map(f32::exp)
            .collect();
        scales.sort_by(f32::total_cmp);
        // bounds of the profile "default" of the format, section 6
        let bound = 0.05 * scales[scales.len() / 2];
        let step_s = 1.25 / 30.0;
        for (i, j) in matched(a, b).into_iter().enumerate() {
            let (old, new) = (
                crate::scene::splats::Row::of(a, i),
                crate::scene::splats::Row::of(b, j),
            );
            for k in 0..3 {
                assert!(
                    (old.mean[k] - new.mean[k]).abs() <= 1.001 * bound,
                    "mean {k} of {i}"
                );
                assert!(
                    (old.log_scale[k] - new.log_scale[k]).abs() <= 0.02,
                    "scale {k} of {i}"
                );
            }
            let [p, q] = [old.quat, new.quat].map(|q| Vector4::from(q.map(f64::from)));
            assert!(p.dot(&q).abs() > 1.0 - 1e-4, "rotation of {i}");
            let opacity = |r: &crate::scene::splats::Row| crate::scene::splats::sigmoid(r.opacity);
            assert!(
                (opacity(&old) - opacity(&new)).abs() < 1.01 / 255.0,
                "opacity of {i}"
            );
            for c in 0..a.layout().range(Column::Colour).len() {
                let (old, new) = (
                    a.column(Column::Colour, c)[i],
                    b.column(Column::Colour, c)[j],
                );
                let bound = if c < 3 {
                    1.01 / 255.0 / 0.2820948
                } else {
                    4.01 / 255.0
                };
                // black and white stay what they are, but no more than that
                let cut = |v: f32| {
                    if c < 3 {
                        v.clamp(-0.5 / 0.2820948, 0.5 / 0.2820948)
                    } else {
                        v
                    }
                };
                assert!(
                    (cut(old) - new).abs() <= bound,
                    "colour {c} of {i}: {old} {new}"
                );
            }
            if let (Some(i), Some(j)) = (i.checked_sub(a.n_static()), j.checked_sub(b.n_static())) {
                let at =
                    |s: &Splats, column, k: usize, row: usize| f64::from(s.column(column, k)[row]);
                let dt = at(a, Column::TimeMean, 0, i) - at(b, Column::TimeMean, 0, j);
                assert!(dt.abs() * step_s <= 0.00201, "moment of {i}");
                let dsd = at(a, Column::LogTimeSd, 0, i) - at(b, Column::LogTimeSd, 0, j);
                assert!(dsd.abs() <= 0.02, "duration of {i}");
                // over the two seconds that the format promises, or the life if that is shorter
                let life = (at(a, Column::LogTimeSd, 0, i).exp() * 2.448).min(2.0 / step_s);
                for k in 0..3 {
                    let dv = at(a, Column::Velocity, k, i) - at(b, Column::Velocity, k, j);
                    assert!(
                        dv.abs() * life <= 2.01 * f64::from(bound),
                        "velocity {k} of {i}"
                    );
                }
            }
        }
    }
}

#[test]
fn extra_metadata_round_trips() {
    let scene = scene(0, 0, false);
    let (bytes, losses) = encode(name(), &scene).unwrap();
    let file = parse(name(), &bytes).unwrap();
    let back = &file.scene;
    assert_eq!(
        (
            back.background,
            back.time_frames,
            back.duration_s,
            back.mip,
            back.near
        ),
        (scene.background, 31, Some(1.25), true, 0.02)
    );
    assert_eq!(file.up, Some([0.0, -1.0, 0.0]));
    assert!(file.losses.is_empty(), "{:?}", file.losses);
    assert_eq!(back.source.len(), 31);
    for (a, b) in scene.source.iter().zip(&back.source) {
        assert_eq!(a.camera.intrinsics, b.camera.intrinsics);
        assert!((a.t - b.t).abs() < 1e-9);
        assert!((a.camera.c2w.matrix() - b.camera.c2w.matrix()).amax() < 1e-12);
    }
    assert!(
        losses
            .iter()
            .any(|l| matches!(l, Loss::Dropped(what) if what.contains("Mip")))
    );
    assert!(!losses.iter().any(|l| matches!(l, Loss::Baked(_))));
}

#[test]
fn scenes_without_duration_use_30_frames_per_second() {
    let mut scene = scene(0, 2, false);
    scene.duration_s = None;
    scene.source[3].exposure.offset = [0.1; 3];
    let (bytes, losses) = encode(name(), &scene).unwrap();
    let header = ::fourdgs::read_bytes(&bytes).unwrap().header;
    assert!((header.duration_sec - 31.0 / 30.0).abs() < 1e-6);
    let baked = losses
        .iter()
        .filter(|l| matches!(l, Loss::Baked(_)))
        .count();
    assert_eq!(baked, 2, "seconds and harmonics of time: {losses:?}");
    assert!(
        losses
            .iter()
            .any(|l| l.to_string() == "dropped: the exposure of every frame")
    );
    let back = parse(name(), &bytes).unwrap().scene;
    assert_eq!((back.time_frames, back.duration_s), (31, None));
    assert!((back.source[30].t - 30.0).abs() < 1e-9);
}

#[test]
fn changed_values_fail_verification() {
    use ::fourdgs::quantization::{Bounds, Profile};
    let scene = scene(1, 0, false);
    let (bytes, _) = encode(name(), &scene).unwrap();
    let mut file = ::fourdgs::read_bytes(&bytes).unwrap();
    let clip = super::convert::ClipTime {
        step_s: 1.25 / 30.0,
        frames: 31,
    };
    let (set, _) = super::convert::to_set(&scene.splats, &clip);
    let mut scales = set.scales.clone();
    scales.sort_by(f32::total_cmp);
    let middle = scales.len() / 2;
    let median = 0.5 * (f64::from(scales[middle - 1]) + f64::from(scales[middle]));
    let bounds = Bounds::for_profile(Profile::Default, median);
    super::convert::verify(&set, &bounds, &file).unwrap();
    let tight = Bounds {
        pos: 0.5 * bounds.pos,
        ..bounds
    };
    assert!(
        super::convert::verify(&set, &tight, &file)
            .unwrap_err()
            .contains("position")
    );
    file.gaussians.mu_t[600] = f32::from_bits(file.gaussians.mu_t[600].to_bits() + 1);
    assert!(super::convert::verify(&set, &bounds, &file).is_err());
    file.gaussians.mu_t.pop();
    assert!(super::convert::verify(&set, &bounds, &file).is_err());
}

#[test]
fn empty_scenes_are_written() {
    let mut scene = scene(0, 0, false);
    scene.splats = Splats::zeros(scene.splats.layout(), 0, 0);
    let (bytes, _) = encode(name(), &scene).unwrap();
    assert_eq!(parse(name(), &bytes).unwrap().scene.splats.n(), 0);
    scene.splats = Splats::zeros(scene.splats.layout(), 1, 0);
    scene.splats.column_mut(Column::Mean, 0)[0] = f32::NAN;
    let error = encode(name(), &scene).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::BadData, "{error}");
}

/// A file as other programs write it, by hand.
fn foreign(change: impl FnOnce(&mut ::fourdgs::GaussianSet)) -> Vec<u8> {
    let mut set = ::fourdgs::GaussianSet {
        positions: vec![0.0, 0.0, 1.0, 1.0, 0.0, 2.0],
        scales: vec![0.1; 6],
        rotations: vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        colors: vec![0.5; 8],
        motions: vec![0.0; 6],
        mu_t: vec![1.0, 1.0],
        sigma_t: vec![f32::INFINITY, 0.2],
        win_lo: vec![0.0; 2],
        win_hi: vec![2.0; 2],
        ..::fourdgs::GaussianSet::default()
    };
    change(&mut set);
    let options = ::fourdgs::WriteOptions {
        verify: false,
        ..::fourdgs::WriteOptions::default()
    };
    ::fourdgs::write_to_vec(&set, 2.0, &options, &::fourdgs::SceneExtras::default()).unwrap()
}

#[test]
fn fourdgs_of_other_tools_gets_a_clock() {
    let plain = parse(name(), &foreign(|_| {})).unwrap();
    let scene = &plain.scene;
    assert_eq!((scene.time_frames, scene.splats.n_static()), (60, 1));
    assert_eq!(scene.splats.column(Column::TimeMean, 0), &[30.0]);
    assert!((scene.splats.column(Column::LogTimeSd, 0)[0] - 6f32.ln()).abs() < 0.02);
    assert!(plain.losses.is_empty() && plain.up.is_none() && scene.source.is_empty());

    // seen from 0.5 s to 1.5 s, then gone: the marginal reaches 0.05 at the same two moments
    let sudden = parse(
        name(),
        &foreign(|set| {
            set.win_lo[0] = 0.5;
            set.win_hi[0] = 1.5;
            set.motions[0] = 0.3;
        }),
    )
    .unwrap();
    let splats = &sudden.scene.splats;
    assert_eq!(splats.n_dynamic(), 2);
    let row = (0..2)
        .find(|&i| (splats.column(Column::LogTimeSd, 0)[i] - 6f32.ln()).abs() > 0.02)
        .unwrap();
    assert!((splats.column(Column::TimeMean, 0)[row] - 30.0).abs() < 0.1);
    let sd = f64::from(splats.column(Column::LogTimeSd, 0)[row]).exp();
    assert!(((-0.5 * (15.0 / sd).powi(2)).exp() - 0.05).abs() < 1e-4);
    assert!(
        matches!(&sudden.losses[..], [Loss::Baked(_)]),
        "{:?}",
        sudden.losses
    );

    let cut = parse(name(), &foreign(|set| set.win_lo[1] = 0.9)).unwrap();
    assert!(
        matches!(&cut.losses[..], [Loss::Dropped(_)]),
        "{:?}",
        cut.losses
    );
}

#[test]
fn a_small_file_cannot_ask_for_much_memory() {
    // A million equal splats: eleven streams with one row each.
    let set = |n: usize| ::fourdgs::GaussianSet {
        positions: vec![0.0; 3 * n],
        scales: vec![0.1; 3 * n],
        rotations: [0.0, 0.0, 0.0, 1.0].repeat(n),
        colors: vec![0.5; 4 * n],
        motions: vec![0.0; 3 * n],
        mu_t: vec![0.0; n],
        sigma_t: vec![f32::INFINITY; n],
        win_lo: vec![0.0; n],
        win_hi: vec![1.0; n],
        ..::fourdgs::GaussianSet::default()
    };
    let options = ::fourdgs::WriteOptions {
        verify: false,
        ..::fourdgs::WriteOptions::default()
    };
    let bytes = |n| {
        ::fourdgs::write_to_vec(&set(n), 1.0, &options, &::fourdgs::SceneExtras::default()).unwrap()
    };
    let large = bytes(1_000_000);
    assert!(large.len() < 2000);
    let error = parse(name(), &large).unwrap_err();
    assert!(error.to_string().contains("bytes of memory"), "{error}");
    assert_eq!(parse(name(), &bytes(1000)).unwrap().scene.splats.n(), 1000);
}

#[test]
fn import_errors_name_a_remedy() {
    let (bytes, _) = encode(name(), &scene(0, 0, false)).unwrap();
    let cut = parse(name(), &bytes[..bytes.len() / 2]).unwrap_err();
    assert_eq!(cut.kind(), ErrorKind::BadData, "{cut}");
    let other = parse(name(), b"ply\nformat ascii 1.0\n").unwrap_err();
    assert_eq!(other.kind(), ErrorKind::Unsupported, "{other}");
    assert!(other.to_string().contains("scene.4dgs"));
}
