//! `fixtures/import/davis`: five images of which four are annotated.

use super::truth::*;
use crate::dataset::support::{copied, fixture};
use m4_core::Silent;
use m4_io::dataset::davis::{detect, read_clip};
use m4_io::video::VideoOptions;

#[test]
fn davis_frames_are_read_with_their_instance_masks() {
    let path = fixture("import/davis/JPEGImages/480p/ball");
    assert!(detect(&path) && !detect(&fixture("import/davis")));
    let clip = read_clip(&path, &VideoOptions::default(), &Silent).unwrap();
    let (rgb, mask) = (truth("rgb"), truth("mask"));
    assert_eq!((clip.video.frames.len(), clip.instances.len()), (5, 5));
    assert!((clip.video.frames[4].time_s - 4.0 / 24.0).abs() < 1e-12);
    for (i, frame) in clip.video.frames.iter().enumerate() {
        let want = &rgb[i * W * H * 3..(i + 1) * W * H * 3];
        let off = frame
            .rgb
            .data()
            .iter()
            .flatten()
            .zip(want)
            .map(|(&g, w)| (f64::from(g) - w).abs());
        assert!(off.sum::<f64>() / want.len() as f64 <= 1.5);
    }
    for i in 0..4 {
        let ids = clip.instances[i].as_ref().unwrap();
        let number = 1 + i as u16 % 2;
        for (at, moves) in mask[i * W * H..(i + 1) * W * H].iter().enumerate() {
            assert_eq!(ids.at(at % W, at / W), if *moves > 0.0 { number } else { 0 });
        }
    }
    assert!(clip.instances[4].is_none());
}

#[test]
fn thinned_davis_frames_keep_their_own_masks() {
    let options = VideoOptions {
        max_frames: Some(2),
        ..VideoOptions::default()
    };
    let clip = read_clip(&fixture("import/davis/JPEGImages/480p/ball"), &options, &Silent).unwrap();
    assert_eq!(clip.instances.len(), 2);
    assert!(clip.instances[0].is_some() && clip.instances[1].is_none());
}

#[test]
fn malformed_davis_is_rejected_with_file_and_reason() {
    let why = read_clip(&fixture("import/davis"), &VideoOptions::default(), &Silent).unwrap_err();
    assert!(why.to_string().contains("JPEGImages"), "{why}");
    let (_dir, path) = copied("import/davis");
    let map = path.join("Annotations/480p/ball/00001.png");
    std::fs::copy(fixture("import/nvidia/motion_masks/001.png"), &map).unwrap();
    let why = read_clip(&path.join("JPEGImages/480p/ball"), &VideoOptions::default(), &Silent).unwrap_err();
    assert!(
        why.to_string().contains("00001.png") && why.to_string().contains("no palette"),
        "{why}"
    );
}
