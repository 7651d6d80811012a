//! Tracks: what is written comes back, and what is damaged is refused with a reason.

use crate::common::{npy, says, temporary};
use m4_core::{Camera, Capture, CaptureFrame, Intrinsics, Plane, Se3, Silent, Tracks};
use m4_io::capture::{self, CaptureOptions, Split, TRACKS_FILE};
use m4_io::tracks::{read, write};
use m4_io::{ErrorKind, ReadError};
use std::fs::{self, File};
use std::io::{Cursor, Write};
use std::path::Path;

const LIMIT: u64 = 1 << 20;

/// Track `k` is at `(k, frame, 2)` where `k + frame` is not a multiple of 3, and unseen in frame 1.
fn test_tracks(frames: usize, count: usize) -> Tracks {
    let place = |i: usize| {
        let (t, k) = (i / count, i % count);
        if (t + k).is_multiple_of(3) {
            [f32::NAN; 3]
        } else {
            [k as f32, t as f32, 2.0]
        }
    };
    let visible = |i: usize| i / count != 1;
    let n = frames * count;
    Tracks::new(
        frames,
        count,
        (0..n).map(place).collect(),
        (0..n).map(visible).collect(),
    )
    .unwrap()
}

fn same(a: &Tracks, b: &Tracks) {
    let bits = |t: &Tracks| {
        t.xyz()
            .as_flattened()
            .iter()
            .map(|v| v.to_bits())
            .collect::<Vec<_>>()
    };
    assert_eq!((a.frames(), a.count()), (b.frames(), b.count()));
    assert_eq!(bits(a), bits(b));
    assert_eq!((a.visible(), a.colours()), (b.visible(), b.colours()));
    assert_eq!(a.confidence_steps(), b.confidence_steps());
}

#[test]
fn tracks_round_trip_exactly() {
    let (_dir, path) = temporary("tracks.npz");
    let plain = test_tracks(5, 7);
    write(&path, &plain).unwrap();
    same(&read(&path, 5, LIMIT).unwrap(), &plain);
    let first = fs::read(&path).unwrap();
    write(&path, &plain).unwrap();
    assert_eq!(
        fs::read(&path).unwrap(),
        first,
        "the same tracks give the same bytes"
    );

    let coloured = plain
        .with_colours((0..7).map(|k| [k, 2 * k, 9]).collect())
        .unwrap();
    write(&path, &coloured).unwrap();
    same(&read(&path, 5, LIMIT).unwrap(), &coloured);

    let trusted = coloured.with_confidence(&[0.3; 35]).unwrap();
    assert!(trusted.confidence_steps().is_some());
    write(&path, &trusted).unwrap();
    same(&read(&path, 5, LIMIT).unwrap(), &trusted);
}

/// Written by numpy 2.4 (`savez_compressed`, with a member more): `oracles/README.md`.
#[test]
fn a_file_of_numpy_is_read() {
    let path = Path::new(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../fixtures/tracks/numpy.npz"
    ));
    let got = read(path, 3, LIMIT).unwrap();
    assert_eq!((got.frames(), got.count()), (3, 2));
    assert_eq!(got.place(1, 0), Some([6.0, 7.0, 8.0]));
    assert_eq!(got.place(2, 1), None);
    assert_eq!(got.visible(), [true, false, true, true, true, false]);
    assert_eq!(got.colours(), None);
}

fn archive(members: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in members {
        zip.start_file(*name, zip::write::SimpleFileOptions::default())
            .unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn refused(bytes: &[u8]) -> ReadError {
    let (_dir, path) = temporary("bad.npz");
    fs::write(&path, bytes).unwrap();
    let error = read(&path, 2, LIMIT).unwrap_err();
    says(&error, &["bad.npz"]);
    error
}

#[test]
fn damaged_files_are_refused_with_a_reason() {
    // two frames, one track
    let coords = || ("coords.npy", npy("<f4", "(2, 1, 3)", &[0; 24]));
    let visibs = || ("visibs.npy", npy("|b1", "(2, 1)", &[1; 2]));
    let dir = tempfile::tempdir().unwrap();
    let good = dir.path().join("good.npz");
    File::create(&good)
        .unwrap()
        .write_all(&archive(&[coords(), visibs()]))
        .unwrap();
    assert_eq!(read(&good, 2, LIMIT).unwrap().count(), 1);

    let coords_as = |descr: &str, shape: &str, bytes: &[u8]| {
        archive(&[("coords.npy", npy(descr, shape, bytes)), visibs()])
    };
    let infinite = f32::INFINITY.to_le_bytes().repeat(6);
    let huge = "(2, 9223372036854775807, 3)";
    let cases: Vec<(Vec<u8>, &str)> = vec![
        (b"not a zip".to_vec(), "not an npz archive"),
        (archive(&[visibs()]), "`coords` is missing"),
        (archive(&[coords()]), "`visibs` is missing"),
        (
            archive(&[("coords.npy", b"PNG".to_vec()), visibs()]),
            "ends in its header",
        ),
        (coords_as("<f8", "(2, 1, 3)", &[0; 48]), "save it as <f4"),
        (
            coords_as("<f4", "(3, 1, 3)", &[0; 36]),
            "(2 frames, tracks, 3)",
        ),
        (
            coords_as("<f4", "(2, 3)", &[0; 24]),
            "(2 frames, tracks, 3)",
        ),
        (
            coords_as("<f4", "(2, 1, 3)", &[0; 20]),
            "ends before all of its numbers",
        ),
        (
            coords_as("<f4", "(2, 1, 3)", &[0; 25]),
            "continues after all of its numbers",
        ),
        (
            coords_as("<f4", huge, &[0; 24]),
            "more than the file can hold",
        ),
        (
            coords_as("<f4", "(2, 100000, 3)", &[0; 2_400_000]),
            "above the limit",
        ),
        (coords_as("<f4", "(2, x, 3)", &[0; 24]), "not understood"),
        (
            coords_as("<f4", "(2, 1, 3)", &infinite),
            "the position of track 0 in frame 0 holds inf; -1e7 to 1e7",
        ),
        (
            archive(&[coords(), ("visibs.npy", npy("|b1", "(2, 2)", &[1; 4]))]),
            "(2 frames, 1 tracks)",
        ),
        (
            archive(&[
                coords(),
                visibs(),
                ("colors.npy", npy("|u1", "(2, 3)", &[1; 6])),
            ]),
            "(1 tracks, 3)",
        ),
    ];
    for (bytes, reason) in cases {
        let error = refused(&bytes);
        says(&error, &[reason]);
        let large = reason == "above the limit";
        let kind = if large {
            ErrorKind::Unsupported
        } else {
            ErrorKind::BadData
        };
        assert_eq!(error.kind(), kind, "{error}");
    }
    let missing = read(Path::new("/nowhere/tracks.npz"), 2, LIMIT).unwrap_err();
    assert_eq!(missing.kind(), ErrorKind::NotFound);
}

fn capture_with(tracks: Option<Tracks>) -> Capture {
    let frame = |i: usize| CaptureFrame {
        name: format!("{i}"),
        camera: Camera {
            intrinsics: Intrinsics::centred(8, 6, 9.0),
            c2w: Se3::identity(),
        },
        t: i as f64,
        rgb: Plane::filled(8, 6, [i as u8; 3]),
        depth: None,
        mask: None,
        motion: None,
        instances: None,
        camera_index: None,
        distance_sigma: None,
    };
    Capture {
        frames: (0..4).map(frame).collect(),
        time_frames: 4,
        duration_s: None,
        metric: true,
        tracks,
    }
}

#[test]
fn capture_tracks_round_trip_and_follow_their_frames() {
    let dir = tempfile::tempdir().unwrap();
    let tracks = test_tracks(4, 6);
    let again = || {
        capture::read(
            dir.path(),
            Split::Train,
            &CaptureOptions::default(),
            &Silent,
        )
    };
    capture::write(
        dir.path(),
        &capture_with(Some(tracks.clone())),
        Split::Train,
        &Silent,
    )
    .unwrap();
    same(&again().unwrap().tracks.unwrap(), &tracks);

    // The list in another order: tracks follow their frames.
    let list = dir.path().join("transforms_train.json");
    let mut json: serde_json::Value = serde_json::from_slice(&fs::read(&list).unwrap()).unwrap();
    assert_eq!(json["tracks_path"], TRACKS_FILE);
    json["frames"].as_array_mut().unwrap().swap(0, 3);
    fs::write(&list, serde_json::to_vec(&json).unwrap()).unwrap();
    let turned = again().unwrap();
    assert_eq!(turned.frames[0].rgb[(0, 0)], [0; 3]);
    same(
        &turned.tracks.unwrap(),
        &tracks.in_order(&[3, 1, 2, 0]).unwrap(),
    );

    fs::remove_file(dir.path().join(TRACKS_FILE)).unwrap();
    let error = again().unwrap_err();
    assert!(error.to_string().contains(TRACKS_FILE), "{error}");
    assert_eq!(error.kind(), ErrorKind::NotFound);

    // Written again without tracks, the capture names none.
    capture::write(dir.path(), &capture_with(None), Split::Train, &Silent).unwrap();
    assert_eq!(again().unwrap().tracks, None);
    let other = capture::write(
        dir.path(),
        &capture_with(Some(test_tracks(3, 6))),
        Split::Train,
        &Silent,
    );
    let error = other.unwrap_err();
    assert_eq!(error.kind(), ErrorKind::BadData);
    assert!(
        error.to_string().contains("4 frames but tracks over 3"),
        "{error}"
    );
}
