//! Metrics against independent programs: images against the oracle, trajectories against `evo`.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use m4_core::nalgebra::{Matrix3, Vector3};
use m4_core::{Mask, Plane, RgbImage, Se3};
use m4_eval::geometry::{ErrorStatistics, PathAlignment, absolute_error, relative_error};
use m4_eval::image::{Metric, PlanarImage, PsnrKind, SsimKind, psnr_db, ssim};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

#[derive(Deserialize)]
struct Fixture {
    psnr: BTreeMap<PsnrKind, f64>,
    psnr_unclamped: BTreeMap<PsnrKind, f64>,
    ssim: BTreeMap<SsimKind, f64>,
    masked: BTreeMap<String, Masked>,
    raw: Vec<f32>,
}

#[derive(Deserialize)]
struct Masked {
    psnr: BTreeMap<PsnrKind, f64>,
    ssim: BTreeMap<SsimKind, Option<f64>>,
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/metrics")
}

fn fixture() -> Fixture {
    serde_json::from_slice(&fs::read(folder().join("image.json")).unwrap()).unwrap()
}

fn read_image(name: &str) -> PlanarImage {
    let image = image::open(folder().join(name)).unwrap().to_rgb8();
    let (w, h) = (image.width() as usize, image.height() as usize);
    PlanarImage::from(&RgbImage::from_vec(w, h, image.pixels().map(|p| p.0).collect()).unwrap())
}

fn mask(name: &str) -> Mask {
    let image = image::open(folder().join(format!("mask_{name}.png")))
        .unwrap()
        .to_luma8();
    Plane::from_vec(
        image.width() as usize,
        image.height() as usize,
        image.into_raw(),
    )
    .unwrap()
}

fn near(what: &str, got: f64, want: f64) {
    assert!(want.abs() > 0.1, "{what}: {want} says little");
    assert!(
        (got - want).abs() < 1e-6,
        "{what}: {got} where {want} is wanted"
    );
}

/// SSIM padded with zeros is that of `oracles/image_metrics.py`, which no program was compared
/// with.
#[test]
fn agrees_with_scikit_image_and_opencv() {
    let fixture = fixture();
    let (image, reference) = (read_image("image.png"), read_image("reference.png"));
    for (&kind, &want) in &fixture.psnr {
        let got = Metric::Psnr(kind)
            .score(&image, &reference, None)
            .unwrap()
            .unwrap();
        near(&format!("{kind:?}"), got, want);
    }
    for (&kind, &want) in &fixture.ssim {
        let got = Metric::Ssim(kind)
            .score(&image, &reference, None)
            .unwrap()
            .unwrap();
        near(&format!("{kind:?}"), got, want);
    }
    assert_eq!(fixture.psnr.len() + fixture.ssim.len(), Metric::ALL.len());
}

#[test]
fn unclamped_psnr_uses_values_outside_0_to_1() {
    let fixture = fixture();
    let reference = read_image("reference.png");
    let (w, h) = reference.size();
    let planes = [0, 1, 2].map(|c| {
        fixture
            .raw
            .iter()
            .skip(c)
            .step_by(3)
            .copied()
            .collect::<Vec<f32>>()
    });
    let planes = planes.each_ref().map(|p| &p[..]);
    let raw = PlanarImage::from_planes_unclamped(w, h, planes).unwrap();
    let clamped = PlanarImage::from_planes(w, h, planes).unwrap();
    assert_eq!(fixture.psnr_unclamped.len(), 3);
    for (&kind, &want) in &fixture.psnr_unclamped {
        let score = |image| psnr_db(kind, image, &reference, None).unwrap().unwrap();
        near(&format!("{kind:?}"), score(&raw), want);
        let differs = (score(&clamped) - want).abs() > 1e-3;
        assert_eq!(differs, kind != PsnrKind::EightBit, "{kind:?}");
    }
}

/// Formulas stated anew in `oracles/image_metrics.py`; `oracles/check_programs.py` compares
/// DyCheck's with the authors' program.
#[test]
fn agrees_with_restated_formulas_inside_masks() {
    let fixture = fixture();
    let (image, reference) = (read_image("image.png"), read_image("reference.png"));
    assert_eq!(fixture.masked.len(), 3);
    let mut scores = 0;
    for (name, want) in &fixture.masked {
        let mask = mask(name);
        for (&kind, &want) in &want.psnr {
            let got = psnr_db(kind, &image, &reference, Some(&mask))
                .unwrap()
                .unwrap();
            near(&format!("{name}, {kind:?}"), got, want);
            scores += 1;
        }
        for (&kind, &want) in &want.ssim {
            let got = ssim(kind, &image, &reference, Some(&mask)).unwrap();
            assert_eq!(got.is_some(), want.is_some(), "{name}, {kind:?}");
            if let (Some(got), Some(want)) = (got, want) {
                near(&format!("{name}, {kind:?}"), got, want);
                scores += 1;
            }
        }
    }
    assert!(scores >= 15, "{scores}");
}

#[derive(Deserialize)]
struct TrajectoryFixture {
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    truth: Vec<Vec<f64>>,
    estimate: Vec<Vec<f64>>,
    errors: BTreeMap<PathAlignment, Errors>,
}

#[derive(Deserialize)]
struct Errors {
    scale: f64,
    absolute: ErrorStatistics,
    absolute_rotation_deg: ErrorStatistics,
    relative: BTreeMap<usize, Relative>,
}

#[derive(Deserialize)]
struct Relative {
    translation: ErrorStatistics,
    rotation_deg: ErrorStatistics,
}

fn poses(rows: &[Vec<f64>]) -> Vec<Se3<f64>> {
    let pose = |r: &Vec<f64>| Se3 {
        rotation: Matrix3::new(r[0], r[1], r[2], r[4], r[5], r[6], r[8], r[9], r[10]),
        translation: Vector3::new(r[3], r[7], r[11]),
    };
    rows.iter().map(pose).collect()
}

fn same(what: &str, got: &ErrorStatistics, want: &ErrorStatistics) {
    let numbers = |s: &ErrorStatistics| [s.rmse, s.mean, s.median, s.std, s.min, s.max];
    assert!(want.rmse > 1e-3, "{what}: nothing is wrong with it");
    for (got, want) in numbers(got).into_iter().zip(numbers(want)) {
        assert!(
            (got - want).abs() < 1e-6,
            "{what}: {got} where {want} is wanted"
        );
    }
}

#[test]
fn agrees_with_evo() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/metrics/trajectory.json");
    let fixture: TrajectoryFixture = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    assert_eq!(fixture.cases.len(), 2);
    for case in &fixture.cases {
        let (truth, estimate) = (poses(&case.truth), poses(&case.estimate));
        assert_eq!(case.errors.len(), 3);
        for (&alignment, want) in &case.errors {
            let what = format!("{} poses, {alignment:?}", truth.len());
            let absolute = absolute_error(&estimate, &truth, alignment).unwrap();
            assert!(
                (absolute.scale - want.scale).abs() < 1e-9,
                "{what}: {}",
                absolute.scale
            );
            same(&what, &absolute.translation, &want.absolute);
            same(&what, &absolute.rotation_deg, &want.absolute_rotation_deg);
            assert_eq!(want.relative.len(), 2);
            for (&delta, want) in &want.relative {
                let relative = relative_error(&estimate, &truth, alignment, delta).unwrap();
                assert_eq!(relative.pairs, (truth.len() - 1) / delta);
                same(&what, &relative.translation, &want.translation);
                same(&what, &relative.rotation_deg, &want.rotation_deg);
            }
        }
    }
}
