//! Errors of camera paths against evo's (`oracles/trajectory.py`).

use m4_core::{
    Se3,
    nalgebra::{Matrix3, Vector3},
};
use m4_eval::geometry::{ErrorStatistics, PathAlignment, absolute_error, relative_error};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

#[derive(Deserialize)]
struct Fixture {
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
        assert!((got - want).abs() < 1e-6, "{what}: {got} where {want} is wanted");
    }
}

#[test]
fn agrees_with_evo() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/metrics/trajectory.json");
    let fixture: Fixture = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    assert_eq!(fixture.cases.len(), 2);
    for case in &fixture.cases {
        let (truth, estimate) = (poses(&case.truth), poses(&case.estimate));
        assert_eq!(case.errors.len(), 3);
        for (&alignment, want) in &case.errors {
            let what = format!("{} poses, {alignment:?}", truth.len());
            let absolute = absolute_error(&estimate, &truth, alignment).unwrap();
            assert!((absolute.scale - want.scale).abs() < 1e-9, "{what}: {}", absolute.scale);
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
