//! `fixtures/import/record3d/clip.r3d`: lenses of 96 x 72 for images of 48 x 36, depth of 24 x 18.

use super::truth::*;
use crate::dataset::support::{edit, fixture, refused};
use m4_io::dataset::{ImportOptions, SourceFormat};
use std::fs::File;
use std::path::{Path, PathBuf};

const FORMAT: SourceFormat = SourceFormat::Record3d;

fn check(path: &Path) {
    let clip = import(path, FORMAT, &ImportOptions::default()).unwrap();
    assert!(clip.test.is_none());
    let train = clip.train;
    assert_poses(&train, "c2w");
    assert_true_lens(&train);
    assert_images(&train, &truth("rgb"), 24.0, 1.5);
    // the first is NaN
    assert_sensed(&train, 1e-6, |x, y| (x, y) == (0, 0));
    assert_near(&times(&train), &[0.0, 1.0, 2.0, 3.0, 4.0], 1e-9);
    assert!((train.duration_s.unwrap() - 0.4).abs() < 1e-9 && train.metric);
}

/// The archive as a folder.
fn unpacked() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("unpacked");
    let archive = File::open(fixture("import/record3d/clip.r3d")).unwrap();
    zip::ZipArchive::new(archive).unwrap().extract(&path).unwrap();
    (dir, path)
}

#[test]
fn record3d_matches_the_clip_it_was_written_from() {
    check(&fixture("import/record3d/clip.r3d"));
}

#[test]
fn large_record3d_depth_maps_are_read() {
    let clip = import(&fixture("import/record3d/large.r3d"), FORMAT, &ImportOptions::default())
        .unwrap()
        .train;
    assert_eq!(
        (clip.frames.len(), clip.time_frames, clip.duration_s),
        (1, 1, Some(0.0))
    );
    let depth = truth("depth");
    let twice: Vec<f64> = (0..4 * W * H)
        .map(|i| depth[i / (2 * W) / 2 * W + i % (2 * W) / 2])
        .collect();
    assert_depth(&clip, 0, &twice, 1e-6, |_, _| true);
}

#[test]
fn an_unpacked_record3d_folder_gives_the_same_clip() {
    check(&unpacked().1);
}

#[test]
fn record3d_without_timestamps_is_evenly_spaced() {
    let (_dir, path) = unpacked();
    edit(&path.join("metadata"), "frameTimestamps", "other");
    edit(&path.join("metadata"), "perFrameIntrinsicCoeffs", "another");
    let clip = import(&path, FORMAT, &ImportOptions::default()).unwrap().train;
    assert_true_lens(&clip);
    assert_near(&times(&clip), &[0.0, 1.0, 2.0, 3.0, 4.0], 0.0);
    assert!((clip.duration_s.unwrap() - 4.0 / 60.0).abs() < 1e-12);
    // frames that come unevenly
    let (_dir, path) = unpacked();
    edit(
        &path.join("metadata"),
        "[7.0, 7.1, 7.2, 7.3, 7.4]",
        "[7.0, 7.1, 7.3, 7.7, 7.8]",
    );
    let clip = import(&path, FORMAT, &ImportOptions::default()).unwrap().train;
    assert_near(&times(&clip), &[0.0, 0.5, 1.5, 3.5, 4.0], 1e-9);
}

#[test]
fn malformed_record3d_is_rejected_with_file_and_reason() {
    let broken = |from: &str, to: &str, says: &[&str]| {
        let (_dir, path) = unpacked();
        edit(&path.join("metadata"), from, to);
        let why = refused(&path, FORMAT, &ImportOptions::default());
        assert!(says.iter().all(|s| why.contains(s)), "{why}");
    };
    broken(
        r#""dw": 24, "dh": 18"#,
        r#""dw": 18, "dh": 24"#,
        &["metadata", "rotated"],
    );
    broken(
        r#""dw": 24, "dh": 18"#,
        r#""dw": 25, "dh": 18"#,
        &["frame 0", "rgbd/0.depth", "1800 bytes"],
    );
    broken(
        r#""dw": 24, "dh": 18"#,
        r#""dw": 24000, "dh": 18000"#,
        &["metadata", "24000 x 18000"],
    );
    broken(r#""w": 96, "h": 72"#, r#""w": 96, "h": 54"#, &["48 x 36", "96 x 54"]);
    broken("7.2, 7.3", "7.3, 7.2", &["frameTimestamps"]);
    broken(r#""fps": 60"#, r#""fps": 0"#, &["fps is 0"]);
    broken(r#""K": [100.0, 0.0, 0.0"#, r#""K": [100.0, 0.0, 49.0"#, &["K is"]);
    let (_dir, path) = unpacked();
    std::fs::copy(path.join("rgbd/4.jpg"), path.join("rgbd/5.jpg")).unwrap();
    let why = refused(&path, FORMAT, &ImportOptions::default());
    assert!(why.contains("rgbd/5.jpg has no pose"), "{why}");
    std::fs::remove_dir_all(path.join("rgbd")).unwrap();
    std::fs::create_dir(path.join("rgbd")).unwrap();
    let why = refused(&path, FORMAT, &ImportOptions::default());
    assert!(why.contains("every rgbd/N.jpg is missing"), "{why}");
}
