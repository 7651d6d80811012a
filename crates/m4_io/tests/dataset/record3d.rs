//! `fixtures/import/record3d/clip.r3d` (lenses of 96 x 72 for images of 48 x 36, depth of 24 x 18),
//! and depth and masks of other tools for it (`fixtures/import/side`).

use super::truth::*;
use crate::dataset::{edit, fixture, refuses, says};
use m4_core::Silent;
use m4_io::dataset::depth::read_depth;
use m4_io::dataset::{ImportOptions, Imported, SourceFormat, read};
use std::fs::File;
use std::path::{Path, PathBuf};

fn check(path: &Path) {
    let clip = import(path, SourceFormat::Record3d, &ImportOptions::default()).unwrap();
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
    zip::ZipArchive::new(archive)
        .unwrap()
        .extract(&path)
        .unwrap();
    (dir, path)
}

#[test]
fn record3d_matches_the_clip_it_was_written_from() {
    check(&fixture("import/record3d/clip.r3d"));
    check(&unpacked().1);
}

#[test]
fn large_record3d_depth_maps_are_read() {
    let clip = import(
        &fixture("import/record3d/large.r3d"),
        SourceFormat::Record3d,
        &ImportOptions::default(),
    )
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
fn record3d_without_timestamps_is_evenly_spaced() {
    let (_dir, path) = unpacked();
    edit(&path.join("metadata"), "frameTimestamps", "other");
    edit(&path.join("metadata"), "perFrameIntrinsicCoeffs", "another");
    let clip = import(&path, SourceFormat::Record3d, &ImportOptions::default())
        .unwrap()
        .train;
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
    let clip = import(&path, SourceFormat::Record3d, &ImportOptions::default())
        .unwrap()
        .train;
    assert_near(&times(&clip), &[0.0, 0.5, 1.5, 3.5, 4.0], 1e-9);
}

#[test]
fn malformed_record3d_is_rejected_with_file_and_reason() {
    let broken = |from: &str, to: &str, says: &[&str]| {
        let (_dir, path) = unpacked();
        edit(&path.join("metadata"), from, to);
        refuses(&path, SourceFormat::Record3d, says);
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
    broken(
        r#""w": 96, "h": 72"#,
        r#""w": 96, "h": 54"#,
        &["48 x 36", "96 x 54"],
    );
    broken("7.2, 7.3", "7.3, 7.2", &["frameTimestamps"]);
    broken(r#""fps": 60"#, r#""fps": 0"#, &["fps is 0"]);
    broken(
        r#""K": [100.0, 0.0, 0.0"#,
        r#""K": [100.0, 0.0, 49.0"#,
        &["K is"],
    );
    let (_dir, path) = unpacked();
    std::fs::copy(path.join("rgbd/4.jpg"), path.join("rgbd/5.jpg")).unwrap();
    refuses(&path, SourceFormat::Record3d, &["rgbd/5.jpg has no pose"]);
    std::fs::remove_dir_all(path.join("rgbd")).unwrap();
    std::fs::create_dir(path.join("rgbd")).unwrap();
    refuses(
        &path,
        SourceFormat::Record3d,
        &["every rgbd/N.jpg is missing"],
    );
}

fn with(change: impl Fn(&mut ImportOptions)) -> Result<Imported, String> {
    let mut options = ImportOptions::default();
    change(&mut options);
    let path = fixture("import/record3d/clip.r3d");
    read(&path, SourceFormat::Record3d, &options, &Silent).map_err(|e| e.to_string())
}

fn side(name: &str) -> Option<PathBuf> {
    Some(fixture("import/side").join(name))
}

#[test]
fn every_depth_format_matches_its_source() {
    let small = truth("small");
    let n = 24 * 18;
    for (name, step, within) in [
        ("depth_exr", 1.0, [1e-6, 2e-3, 1e-6, 2e-3, 1e-6]),
        // in steps of half a thousandth, where thousandths are read
        ("depth_png", 2.0, [0.000_52; 5]),
        ("depth_npy", 1.0, [1e-6; 5]),
    ] {
        let train = with(|o| o.depth = side(name)).unwrap().train;
        for i in 0..5 {
            let want: Vec<f64> = small[i * n..(i + 1) * n].iter().map(|z| z * step).collect();
            // NaN, infinite, below 0, 0, NaN
            assert_depth(&train, i, &want, within[i], |x, y| (x, y) != (3, 2));
        }
    }
}

#[test]
fn depth_of_exr_files_with_parts_is_found_and_of_cropped_ones_refused() {
    let map = read_depth(&fixture("import/side/exr_other/parts.exr"), 1.0).unwrap();
    assert_eq!(map.size(), (24, 18));
    for (got, want) in map.every(1).zip(truth("small")) {
        assert!((f64::from(got) - want).abs() < 1e-6);
    }
    let cropped = read_depth(&fixture("import/side/exr_other/cropped.exr"), 1.0);
    says(
        &cropped.unwrap_err(),
        &["24 x 18 pixels of an image of 34 x 28"],
    );
}

#[test]
fn every_mask_format_matches_its_source() {
    let mask = truth("mask");
    for name in ["masks_png", "masks_palette"] {
        let clip = with(|o| o.masks = side(name)).unwrap();
        for (i, frame) in clip.train.frames.iter().enumerate() {
            let got = frame.mask.as_ref().unwrap();
            assert!(got.count() > 50 && got.count() < W * H - 50);
            for (at, moves) in mask[i * W * H..(i + 1) * W * H].iter().enumerate() {
                assert_eq!(got.at(at % W, at / W), *moves > 0.0, "{name} {i} {at}");
            }
        }
    }
}

#[test]
fn malformed_side_files_are_rejected_with_file_and_reason() {
    let refused = |change: &dyn Fn(&mut ImportOptions), says: &[&str]| {
        let why = with(change).unwrap_err();
        assert!(says.iter().all(|s| why.contains(s)), "{why}");
    };
    let dir = tempfile::tempdir().unwrap();
    for i in 0..4 {
        std::fs::write(dir.path().join(format!("{i}.exr")), b"v/1\x01").unwrap();
    }
    let folder = Some(dir.path().to_path_buf());
    refused(
        &|o| o.depth = folder.clone(),
        &["4 depth maps (0.exr to 3.exr) for 5 training frames"],
    );
    refused(
        &|o| o.masks = folder.clone(),
        &["0 masks", "5 training frames"],
    );
    std::fs::write(dir.path().join("4.exr"), b"x").unwrap();
    refused(&|o| o.depth = folder.clone(), &["frame 0", "0.exr", "EXR"]);
    for i in 0..4 {
        std::fs::copy(
            fixture("import/side/depth_exr/frame8.exr"),
            dir.path().join(format!("{i}.exr")),
        )
        .unwrap();
    }
    refused(
        &|o| o.depth = folder.clone(),
        &["frame 4", "4.exr", "not supported for depth maps"],
    );
    refused(&|o| o.depth = side("nothing"), &["nothing"]);
}
