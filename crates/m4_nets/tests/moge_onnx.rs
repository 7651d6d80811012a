//! MoGe-2's ONNX door: a file whose geometry is known goes through ONNX Runtime and comes out as metres.
#![cfg(feature = "ort")]
#![expect(clippy::print_stdout, reason = "what is not tested is said")]

use m4_nets::{LoadError, MoGeError, MoGeOnnx, MoGeOptions};
use m4_scene::{Plane, RgbImage};
use std::path::{Path, PathBuf};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../fixtures/moge2")
        .join(name)
}

/// The file, or nothing where there is no ONNX Runtime.
fn door() -> Option<MoGeOnnx> {
    match MoGeOnnx::load(&fixture("door.onnx")) {
        Ok(net) => Some(net),
        Err(error @ LoadError::Runtime { .. }) if std::env::var_os("ORT_DYLIB_PATH").is_none() => {
            println!("not tested: {error}");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

const SIZE: (usize, usize) = (96, 64);

/// Red rises to the right; blue is bright but in a square.
fn picture() -> RgbImage {
    Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
        let sky = x < 10 && y < 10;
        [(2 * x) as u8, 77, if sky { 20 } else { 230 }]
    })
}

fn options(tokens: usize) -> MoGeOptions {
    MoGeOptions {
        tokens: Some(tokens),
        known_focal_px: None,
    }
}

#[test]
fn what_the_file_says_becomes_metres() {
    let Some(net) = door() else { return };
    assert!(net.has_normals());
    let picture = picture();
    let map = net.infer(&picture, &options(1500)).unwrap();
    // as oracles/moge_onnx.py has it
    let focal_px = 1.25 * (SIZE.0 as f64).hypot(SIZE.1 as f64) / 2.0;
    assert!(
        (map.focal_px / focal_px - 1.0).abs() < 2e-3,
        "{} {focal_px}",
        map.focal_px
    );
    assert_eq!(map.metric_scale, 1.5);
    let normals = map.normal.as_ref().unwrap();
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let here = map.depth_m[(x, y)];
            if x < 10 && y < 10 {
                assert_eq!((here, map.mask[(x, y)]), (0.0, false), "{x} {y}");
                continue;
            }
            let z = 1.0 + f32::from(picture[(x, y)][0]) / 255.0 + (y as f32 + 0.5) / SIZE.1 as f32;
            assert!((here / (1.5 * z) - 1.0).abs() < 5e-3, "{x} {y}: {here} {z}");
            assert_eq!(normals[(x, y)], [0.0, 0.0, -1.0]);
        }
    }
    let known = MoGeOptions {
        known_focal_px: Some(focal_px),
        ..options(2000)
    };
    let map = net.infer(&picture, &known).unwrap();
    let z = 2.0 * (1.0 + 100.0 / 255.0 + 32.5 / 64.0);
    assert!(
        (map.depth_m[(50, 32)] / z - 1.0).abs() < 1e-4,
        "{} {z}",
        map.depth_m[(50, 32)]
    );
}

#[test]
fn what_does_not_fit_is_an_error() {
    let Some(net) = door() else { return };
    let none = Plane::from_vec(0, 0, vec![]).unwrap();
    assert!(matches!(net.infer(&none, &options(1200)), Err(MoGeError::Empty)));
    assert!(matches!(net.infer(&picture(), &options(0)), Err(MoGeError::Tokens(0))));
    let dark = Plane::filled(40, 30, [9, 9, 9]);
    assert!(matches!(net.infer(&dark, &options(1200)), Err(MoGeError::NothingValid)));

    assert!(matches!(
        MoGeOnnx::load(&fixture("nowhere.onnx")),
        Err(LoadError::Missing { .. })
    ));
    let place = tempfile::tempdir().unwrap();
    let whole = std::fs::read(fixture("door.onnx")).unwrap();
    let load = |bytes: &[u8]| {
        let path = place.path().join("other.onnx");
        std::fs::write(&path, bytes).unwrap();
        MoGeOnnx::load(&path)
    };
    for length in (0..whole.len()).step_by(61) {
        let cut = load(&whole[..length]);
        assert!(
            matches!(cut, Err(LoadError::Unreadable { .. } | LoadError::OtherNetwork { .. })),
            "{length} bytes: {cut:?}"
        );
    }
    assert!(matches!(load(b"not a network"), Err(LoadError::Unreadable { .. })));
    // another name of an output, of the same length
    let at = whole.windows(12).rposition(|part| part == b"metric_scale").unwrap();
    let mut renamed = whole.clone();
    for place in whole
        .windows(12)
        .enumerate()
        .filter(|(_, part)| *part == b"metric_scale")
    {
        renamed[place.0..place.0 + 12].copy_from_slice(b"other_scales");
    }
    assert!(at > 0);
    let Err(LoadError::OtherNetwork { missing, .. }) = load(&renamed) else {
        panic!("an output was renamed");
    };
    assert_eq!(missing, ["metric_scale"]);
}
