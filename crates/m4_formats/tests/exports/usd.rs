//! USD: text worked out by hand.

use super::common::{self, asymmetric_scene};
use m4_formats::instant;
use m4_formats::usd::{self, UsdOptions, UsdPositions};
use m4_scene::{Column, SplatLayout, Splats};
use std::path::Path;

fn text(scene: &m4_scene::Scene, options: &UsdOptions) -> (String, m4_formats::Written) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.usda");
    let written = usd::write(&path, scene, options).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    assert_eq!(written.bytes, text.len() as u64);
    (text, written)
}

/// What follows `key` on its line.
fn after<'a>(text: &'a str, key: &str) -> &'a str {
    let at = text.find(key).unwrap_or_else(|| panic!("{key:?} is missing in {text}"));
    text[at + key.len()..].lines().next().unwrap()
}

/// The lines of the samples of an attribute.
fn samples<'a>(text: &'a str, name: &str) -> Vec<&'a str> {
    let at = text.find(&format!("{name}.timeSamples = {{")).unwrap();
    text[at..]
        .lines()
        .skip(1)
        .take_while(|l| l.trim() != "}")
        .map(str::trim)
        .collect()
}

#[test]
fn the_text_of_two_splats() {
    let (text, written) = text(
        &asymmetric_scene(1),
        &UsdOptions {
            step_frames: 3,
            ..UsdOptions::default()
        },
    );
    assert!(text.starts_with("#usda 1.0\n"));
    assert_eq!(written.splats, 2);
    // 8 steps in 2 seconds
    assert_eq!(after(&text, "timeCodesPerSecond = "), "4");
    assert_eq!(after(&text, "endTimeCode = "), "8");
    assert_eq!(after(&text, "upAxis = "), "\"Y\"");
    // y up, z back; the second is at (-1, 0.5, 3) at frame 2 and moves (0.25, 0, -0.5) a frame:
    // (-1.5, 0.5, 4) at frame 0, (0.5, 0.5, 0) at frame 8
    assert_eq!(
        samples(&text, "positions"),
        ["0: [(1,-2,-6),(-1.5,-0.5,-4)],", "8: [(1,-2,-6),(0.5,-0.5,0)],"]
    );
    // without a time: as at the sample in the middle, frame 6
    assert_eq!(after(&text, "positions = "), "[(1,-2,-6),(0,-0.5,-1)]");
    assert_eq!(after(&text, "opacities = "), "[0.8,0.068]");
    // 0.5 exp(-(t - 2)^2 / 8) at 0, 3, 6 and 8; at 8 the marginal of 0.0111 is below 0.05
    assert_eq!(
        samples(&text, "opacities"),
        ["0: [0.8,0.303],", "3: [0.8,0.441],", "6: [0.8,0.068],", "8: [0.8,0],"]
    );
    assert_eq!(
        after(&text, "quatf[] orientations = "),
        "[(0.7071,0,-0.7071,0),(1,0,0,0)]"
    );
    assert_eq!(
        after(&text, "float3[] scales = "),
        "[(3.679e-1,1.353e-1,4.979e-2),(1.832e-2,1.832e-2,1.832e-2)]"
    );
    assert_eq!(after(&text, "sphericalHarmonicsDegree = "), "1");
    assert_eq!(
        after(&text, "sphericalHarmonicsCoefficients = "),
        "[(1,0,-1),(0,0,0),(0,0,0),(0,0,0),(0,2,0.5),(0,0,0),(0,0,0),(0,0,0)]"
    );
    // 36 / 64 x 80; square pixels would be 48 high: 45 x 48 / 75
    assert_eq!(after(&text, "float focalLength = "), "45");
    assert_eq!(after(&text, "float verticalAperture = "), "28.8");
    // the principal point lies 2 of 64 pixels left of the middle and 1 of 48 below it
    assert_eq!(after(&text, "float horizontalApertureOffset = "), "1.125");
    assert_eq!(after(&text, "float verticalApertureOffset = "), "0.6");
    let poses = samples(&text, "xformOp:transform");
    assert_eq!(poses.len(), 9);
    assert_eq!(poses[3], "3: ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (3, 0, 0, 1)),");
}

#[test]
fn what_was_written_is_read_back_at_any_instant() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.usda");
    let scene = common::random_scene(2, 40, 60);
    usd::write(&path, &scene, &UsdOptions::default()).unwrap();
    for t in [0.0, 7.0, 15.0] {
        let expected = instant(&scene.splats, t, 16.0);
        let read = usd::read(&path, t).unwrap();
        assert_eq!(read.n(), expected.n(), "frame {t}");
        common::assert_columns(&read, &expected, Column::Mean, 2e-6);
        common::assert_columns(&read, &expected, Column::LogScale, 6e-4);
        common::assert_columns(&read, &expected, Column::Colour, 6e-5);
        common::assert_rotations(&read, &expected, 1e-3);
        let opacity = |s: &Splats, i: usize| 1.0 / (1.0 + (-s.column(Column::Opacity, 0)[i]).exp());
        for i in 0..read.n() {
            let (got, wanted) = (opacity(&read, i), opacity(&expected, i));
            assert!((got - wanted).abs() < 6e-4, "splat {i} at {t}: {got}, not {wanted}");
        }
    }
    // between two samples, by hand: opacities 0.303 at frame 0 and 0.441 at 3, places at -1.5 and 0.5 at 0 and 8
    let every_third = UsdOptions {
        step_frames: 3,
        ..UsdOptions::default()
    };
    usd::write(&path, &asymmetric_scene(0), &every_third).unwrap();
    let read = usd::read(&path, 1.0).unwrap();
    let logit = read.column(Column::Opacity, 0)[1];
    assert!((1.0 / (1.0 + (-logit).exp()) - 0.349).abs() < 1e-6, "{logit}");
    assert!((read.column(Column::Mean, 0)[1] + 1.25).abs() < 1e-6);
    assert_eq!(read.column(Column::Mean, 1)[1], 0.5, "our y points down");
    assert_eq!(usd::read(&path, 8.0).unwrap().n(), 1, "the second has no opacity left");
}

#[test]
fn other_uses_of_usd_are_named() {
    let (text, _) = text(&asymmetric_scene(0), &UsdOptions::default());
    let error = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        let changed = text.replacen(from, to, 1);
        let error = usd::parse(Path::new("a.usda"), changed.as_bytes(), 0.0).unwrap_err();
        error.to_string()
    };
    for (from, to, says) in [
        ("#usda", "PXR-USDC", "no USD text"),
        ("\"Y\"", "\"Z\"", "up axis \"Z\""),
        ("def Particle", "def Cube \"c\" { }\n def Particle", ""),
        (
            "ParticleField3DGaussianSplat",
            "Points",
            "no ParticleField3DGaussianSplat",
        ),
        ("(\n    kind", "( # prim\n kind", ""),
        (
            "    def Camera",
            "    uniform token[] xformOpOrder = []\n    def Camera",
            "moved by a transform",
        ),
        ("float3[] scales", "half3[] scalesh", "splats without scales"),
        (
            "sphericalHarmonicsDegree = 0",
            "sphericalHarmonicsDegree = 4",
            "degree 4",
        ),
        ("[(1,0,-1),", "[", "1 radiance"),
        ("[0.8,0.303]", "[0.8,0.3o3]", "\"0.3o3\""),
        (
            "    def Camera",
            "    variantSet \"v\" = {}\n    def Camera",
            "variants",
        ),
        (
            "quatf[] orientations = ",
            "quatf[] orientations.timeSamples = ",
            "that turn",
        ),
    ] {
        if says.is_empty() {
            let changed = text.replacen(from, to, 1);
            assert_eq!(usd::parse(Path::new("a.usda"), changed.as_bytes(), 0.0).unwrap().n(), 2);
        } else {
            let error = error(from, to);
            assert!(error.contains(says) && error.contains("a.usda"), "{error}");
        }
    }
    let dir = tempfile::tempdir().unwrap();
    let error = usd::read(&dir.path().join("gone.usda"), 0.0).unwrap_err().to_string();
    assert!(error.contains("gone.usda"), "{error}");
    assert!(usd::read(dir.path(), 0.0).is_err());
}

#[test]
fn every_sample_of_the_places_on_request() {
    let options = UsdOptions {
        step_frames: 4,
        fps: Some(12.0),
        positions: UsdPositions::EverySample,
    };
    let (text, _) = text(&asymmetric_scene(0), &options);
    assert_eq!(after(&text, "timeCodesPerSecond = "), "12");
    assert_eq!(
        samples(&text, "positions"),
        [
            "0: [(1,-2,-6),(-1.5,-0.5,-4)],",
            "4: [(1,-2,-6),(-0.5,-0.5,-2)],",
            "8: [(1,-2,-6),(0.5,-0.5,0)],"
        ]
    );
}

#[test]
fn what_no_sample_sees_is_left_out_and_said() {
    let mut scene = common::random_scene(0, 50, 50);
    scene.splats.column_mut(Column::Opacity, 0)[3] = -9.0;
    scene.splats.column_mut(Column::TimeMean, 0)[4] = -900.0;
    let (_, all) = text(&scene, &UsdOptions::default());
    assert_eq!(all.splats, 98);
    assert!(
        all.losses
            .iter()
            .any(|l| l.to_string().contains("2 splats that no sample sees")),
        "{:?}",
        all.losses
    );
    scene.duration_s = None;
    let (text, written) = text(&scene, &UsdOptions::default());
    assert_eq!(after(&text, "timeCodesPerSecond = "), "30");
    assert!(written.losses.iter().any(|l| l.to_string().contains("not recorded")));
}

#[test]
fn harmonics_of_time_are_sampled() {
    let layout = SplatLayout {
        isotropic: true,
        sh_degree: 0,
        time_degree: 1,
    };
    let mut scene = asymmetric_scene(0);
    scene.splats = Splats::zeros(layout, 0, 1);
    scene.splats.column_mut(Column::LogTimeSd, 0)[0] = 5.0;
    scene.splats.column_mut(Column::Colour, 0)[0] = 0.5;
    scene.splats.column_mut(Column::Colour, 3)[0] = 0.25;
    scene.time_frames = 5;
    scene.source.clear();
    let (text, _) = text(
        &scene,
        &UsdOptions {
            step_frames: 4,
            ..UsdOptions::default()
        },
    );
    // at frame 4 of a period of 5: 0.5 + 0.25 cos(0.8 turns)
    assert_eq!(
        samples(&text, "sphericalHarmonicsCoefficients"),
        ["0: [(0.75,0,0)],", "4: [(0.5773,0,0)],"]
    );
    assert!(!text.contains("Camera"));
    assert_eq!(after(&text, "quatf[] orientations = "), "[(1,0,0,0)]");
}

#[test]
fn what_cannot_be_written_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let scene = asymmetric_scene(0);
    let error = |path: &str, scene: &m4_scene::Scene, options: &UsdOptions| {
        usd::write(&dir.path().join(path), scene, options)
            .unwrap_err()
            .to_string()
    };
    let default = UsdOptions::default();
    assert!(error("a.usdc", &scene, &default).contains(".usda"));
    let none = UsdOptions {
        step_frames: 0,
        ..default.clone()
    };
    assert!(error("a.usda", &scene, &none).contains("step_frames = 0"));
    let slow = UsdOptions {
        fps: Some(-1.0),
        ..default.clone()
    };
    assert!(error("a.usda", &scene, &slow).contains("fps = -1"));
    let mut broken = scene.clone();
    broken.splats.column_mut(Column::Mean, 0)[0] = f32::NAN;
    assert!(error("a.usda", &broken, &default).contains("not a number"));
    let mut faint = scene;
    faint.splats.column_mut(Column::Opacity, 0).fill(-9.0);
    assert!(error("a.usda", &faint, &default).contains("no splat is seen"));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}
