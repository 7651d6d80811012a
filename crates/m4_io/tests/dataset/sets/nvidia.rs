//! `fixtures/import/nvidia`: five cameras at five moments, held-out views of camera 0 and of cameras 0 to 2.

use super::truth::*;
use crate::dataset::support::{Heard, copied, fixture, refused};
use m4_io::dataset::{ImportOptions, SourceFormat, read};

const FORMAT: SourceFormat = SourceFormat::Nvidia;

fn own(name: &str) -> Vec<f64> {
    array("nvidia/truth.npz", name)
}

#[test]
fn nvidia_matches_the_clip_it_was_written_from() {
    let heard = Heard::default();
    let clip = read(&fixture("import/nvidia"), FORMAT, &ImportOptions::default(), &heard).unwrap();
    assert!(heard.all().contains("disp"), "{}", heard.all());
    let train = &clip.train;
    assert_poses(train, "c2w");
    assert_images(train, &own("rgb"), 0.0, 0.0);
    let mask = truth_mask();
    for (i, frame) in train.frames.iter().enumerate() {
        assert_lens(frame, [50.0, 50.0, 24.0, 18.0]);
        let count = frame.mask.as_ref().unwrap().count();
        // of a lens a little shorter than that of the mask
        assert!(
            count > 50 && count.abs_diff(mask[i]) < mask[i] / 8,
            "{count} {}",
            mask[i]
        );
    }
    // scale and shift of the disparity are found by the bounds
    let depth = own("depth");
    for i in 0..5 {
        assert_depth(train, i, &depth[i * W * H..(i + 1) * W * H], 0.02, |_, _| true);
    }
    assert_near(&times(train), &[0.0, 1.0, 2.0, 3.0, 4.0], 0.0);
    assert!(!train.metric && train.duration_s.is_none());

    let test = clip.test.unwrap();
    assert_images(&test, &own("gt"), 0.0, 0.0);
    assert_near(&times(&test), &[0.0, 1.0, 2.0, 3.0, 4.0], 0.0);
    let first = train.frames[0].camera;
    assert!(
        test.frames
            .iter()
            .all(|f| f.camera == first && f.camera_index == Some(0))
    );
}

/// Pixels that move, a frame.
fn truth_mask() -> Vec<usize> {
    let mask = truth("mask");
    mask.chunks_exact(W * H)
        .map(|m| m.iter().filter(|&&v| v > 0.0).count())
        .collect()
}

#[test]
fn nvidia_holds_out_views_of_other_cameras() {
    let (_dir, path) = copied("import/nvidia");
    std::fs::remove_dir_all(path.join("gt")).unwrap();
    let clip = import(&path, FORMAT, &ImportOptions::default()).unwrap();
    let test = clip.test.unwrap();
    let seen: Vec<(u32, f64)> = test.frames.iter().map(|f| (f.camera_index.unwrap(), f.t)).collect();
    let mut want = Vec::new();
    for t in 0..5u32 {
        want.extend((0..3).filter(|c| *c != t % 3).map(|c| (c, f64::from(t))));
    }
    assert_eq!(seen, want);
    for frame in &test.frames {
        let camera = &clip.train.frames[frame.camera_index.unwrap() as usize].camera;
        assert_eq!(frame.camera, *camera);
    }
    std::fs::remove_dir_all(path.join("mv_images")).unwrap();
    assert!(import(&path, FORMAT, &ImportOptions::default()).unwrap().test.is_none());
}

#[test]
fn malformed_nvidia_is_rejected_with_file_and_reason() {
    let (_dir, path) = copied("import/nvidia");
    let why = refused(
        &path,
        FORMAT,
        &ImportOptions {
            factor: Some(1),
            ..ImportOptions::default()
        },
    );
    assert!(why.contains("images is missing"), "{why}");
    std::fs::rename(path.join("gt/v000_t004.png"), path.join("gt/v000_t005.png")).unwrap();
    let why = refused(&path, FORMAT, &ImportOptions::default());
    assert!(why.contains("v000_t005.png") && why.contains("time 5"), "{why}");
    std::fs::remove_file(path.join("motion_masks/002.png")).unwrap();
    let why = refused(&path, FORMAT, &ImportOptions::default());
    assert!(
        why.contains("motion_masks") && why.contains("4 masks for 5 poses"),
        "{why}"
    );
    std::fs::remove_file(path.join("images_2/002.png")).unwrap();
    let why = refused(&path, FORMAT, &ImportOptions::default());
    assert!(
        why.contains("images_2") && why.contains("4 images for 5 poses"),
        "{why}"
    );
    let bytes = std::fs::read(path.join("poses_bounds.npy")).unwrap();
    std::fs::write(path.join("poses_bounds.npy"), &bytes[..bytes.len() - 8]).unwrap();
    let why = refused(&path, FORMAT, &ImportOptions::default());
    assert!(
        why.contains("poses_bounds.npy") && why.contains("damaged or cut off"),
        "{why}"
    );
}
