//! Files of MegaSaM, as numpy writes them; damaged ones are refused.

use crate::common::npy;
use crate::dataset::{Heard, fixture as any_fixture, says};
use m4_core::{Capture, Intrinsics, Progress, Se3, Silent, exp_so3, nalgebra::Vector3};
use m4_io::dataset::ImportOptions;
use m4_io::dataset::SourceFormat::Megasam;
use m4_io::{ErrorKind, ReadError};
use std::fs;
use std::path::{Path, PathBuf};

fn fixture(name: &str) -> PathBuf {
    any_fixture("megasam").join(name)
}

fn read(
    path: &Path,
    options: &ImportOptions,
    progress: &dyn Progress,
) -> Result<Capture, ReadError> {
    Ok(m4_io::dataset::read(path, Megasam, options, progress)?.train)
}

fn read_ok(path: &Path) -> Capture {
    read(path, &ImportOptions::default(), &Silent).unwrap()
}

/// What `oracles/megasam_files.py` says of the three fixtures.
fn check_fixture(capture: &Capture, depth_within: f32, farthest: f32) {
    assert_eq!(
        (capture.frames.len(), capture.time_frames, capture.metric),
        (3, 3, false)
    );
    assert_eq!(capture.duration_s, Some(2.0 / 30.0));
    for (i, frame) in capture.frames.iter().enumerate() {
        let t = i as f64;
        assert_eq!((frame.t, frame.rgb.size()), (t, (24, 16)));
        let k = Intrinsics {
            width: 24,
            height: 16,
            fx: 20.0,
            fy: 21.0,
            cx: 12.0,
            cy: 8.5,
        };
        assert_eq!(frame.camera.intrinsics, k);
        let c2w = Se3 {
            rotation: exp_so3(&Vector3::new(0.0, 0.1 * t, 0.0)),
            translation: Vector3::new(0.2 * t, -0.05 * t, 0.1 * t),
        };
        assert!(
            (frame.camera.c2w.matrix() - c2w.matrix()).amax() < 1e-6,
            "frame {i}"
        );
        let map = frame.depth.as_ref().unwrap();
        let mask = frame.mask.as_ref().unwrap();
        for y in 0..16 {
            for x in 0..24 {
                assert_eq!(
                    frame.rgb[(x, y)],
                    [(9 * x) as u8, (13 * y) as u8, (x + y + 40 * i) as u8]
                );
                let expected = match (i, x, y) {
                    (_, 0..5, 0) => 0.0,
                    (1, 3, 3) => farthest,
                    _ => 0.4 + 0.01 * x as f32 + 0.02 * y as f32 + 0.05 * i as f32,
                };
                let z = map.at(x, y);
                assert!(
                    (z - expected).abs() <= depth_within * expected,
                    "frame {i} ({x}, {y}): {z}, {expected}"
                );
            }
        }
        // the middle of the dynamic block, and of the one above it
        assert!(mask.at(8 * i + 4, 13) && !mask.at(8 * i + 4, 3));
        assert!((20..64).contains(&mask.count()), "{}", mask.count());
    }
}

#[test]
fn files_of_numpy_are_read() {
    // MegaSaM adds 1e-6 to depth before it takes the inverse, and does not take it off again
    check_fixture(&read_ok(&fixture("outputs/dog_droid.npz")), 4e-6, 250.0);
    check_fixture(
        &read_ok(&fixture("outputs_cvd/dog_sgd_cvd_hr.npz")),
        5e-4,
        100.0,
    );
    check_fixture(&read_ok(&fixture("reconstructions/dog")), 2e-5, 250.0);
}

#[test]
fn frame_rate_is_given_or_assumed() {
    let path = fixture("outputs/dog_droid.npz");
    let heard = Heard::default();
    let options = ImportOptions {
        fps: Some(10.0),
        ..ImportOptions::default()
    };
    let capture = read(&path, &options, &heard).unwrap();
    assert_eq!(capture.duration_s, Some(0.2));
    assert_eq!(heard.all(), "", "nothing was assumed");

    let heard = Heard::default();
    read(&path, &ImportOptions::default(), &heard).unwrap();
    assert!(heard.all().contains("30 frames per second are assumed"));

    for (options, says) in [
        (
            ImportOptions {
                fps: Some(0.0),
                ..options.clone()
            },
            "fps is 0",
        ),
        (
            ImportOptions {
                fps: Some(f64::NAN),
                ..options.clone()
            },
            "fps is NaN",
        ),
        (
            ImportOptions {
                max_memory_bytes: 4000,
                ..options
            },
            "max_memory_bytes",
        ),
    ] {
        let error = read(&path, &options, &Silent).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
}

/// Writes a map of motion for the fixture's clip.
fn motion(path: &Path, frames: usize, value: f32) {
    let bytes = value.to_le_bytes().repeat(frames * 6);
    fs::write(path, npy("<f4", &format!("({frames}, 2, 3)"), &bytes)).unwrap();
}

#[test]
fn the_motion_map_is_found_and_checked() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("dog_droid.npz");
    fs::copy(fixture("outputs/dog_droid.npz"), &path).unwrap();
    let heard = Heard::default();
    let alone = read(&path, &ImportOptions::default(), &heard).unwrap();
    assert!(alone.frames.iter().all(|f| f.mask.is_none()));
    assert!(heard.all().contains("no motion map was found"));

    let beside = dir.path().join("motion_prob.npy");
    motion(&beside, 3, 1.0);
    let all_static = read_ok(&path);
    assert!(
        all_static
            .frames
            .iter()
            .all(|f| f.mask.as_ref().unwrap().count() == 0),
        "1 is static"
    );

    // one by the name of the clip comes first; everything dynamic is improbable
    let named = dir.path().join("reconstructions/dog");
    fs::create_dir_all(&named).unwrap();
    motion(&named.join("motion_prob.npy"), 3, 0.1);
    let heard = Heard::default();
    read(&path, &ImportOptions::default(), &heard).unwrap();
    says(
        &heard.all(),
        &["100 % of the pixels count as dynamic", "1 - motion_prob"],
    );

    for (frames, value, says) in [
        (4, 1.0, "another clip"),
        (3, 7.0, "holds 7"),
        (3, f32::NAN, "holds NaN"),
    ] {
        motion(&named.join("motion_prob.npy"), frames, value);
        let error = read(&path, &ImportOptions::default(), &Silent)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains(says) && error.contains("motion_prob"),
            "{error}"
        );
    }
}

fn refused(path: &Path) -> ReadError {
    read(path, &ImportOptions::default(), &Silent).unwrap_err()
}

#[test]
fn other_files_are_refused_with_a_reason() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("dog_droid.npz");
    fs::write(&path, b"no archive").unwrap();
    let error = refused(&path);
    assert!(error.to_string().contains("not an npz archive") && error.kind() == ErrorKind::BadData);
    assert!(error.to_string().contains("dog_droid.npz"));
    fs::copy(fixture("../tracks/numpy.npz"), &path).unwrap();
    says(
        &refused(&path),
        &["the array `images` is missing", "coords"],
    );
    assert_eq!(
        refused(Path::new("/nowhere/a_droid.npz")).kind(),
        ErrorKind::NotFound
    );

    let folder = dir.path().join("dog");
    fs::create_dir_all(&folder).unwrap();
    let again = || {
        for name in ["images", "disps", "poses", "intrinsics", "motion_prob"] {
            let file = format!("{name}.npy");
            fs::copy(
                fixture("reconstructions/dog").join(&file),
                folder.join(&file),
            )
            .unwrap();
        }
    };
    for (name, other, says) in [
        ("images", "disps", "save it as uint8"),
        ("images", "poses", "save it as uint8"),
        ("disps", "images", "save it as float16"),
        ("disps", "poses", "shape [3, 7]"),
        ("poses", "intrinsics", "tx ty tz qx qy qz qw"),
        ("intrinsics", "poses", "fx fy cx cy"),
        ("motion_prob", "disps", "holds"),
        ("motion_prob", "poses", "another clip"),
    ] {
        again();
        fs::copy(
            folder.join(format!("{other}.npy")),
            folder.join(format!("{name}.npy")),
        )
        .unwrap();
        let text = refused(&folder).to_string();
        assert!(
            text.contains(says) && text.contains(name),
            "{name} as {other}: {text}"
        );
    }
    for name in ["images", "disps", "poses", "intrinsics"] {
        again();
        fs::remove_file(folder.join(format!("{name}.npy"))).unwrap();
        let text = refused(&folder).to_string();
        assert!(
            text.contains(&format!("the array `{name}` is missing")),
            "{text}"
        );
    }
}
