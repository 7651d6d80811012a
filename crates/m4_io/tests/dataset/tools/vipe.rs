//! ViPE's artifacts, EXR files by OpenEXR 3.5, the clip by x264.

use super::truth::{Truth, read, with_images};
use crate::dataset::support::{copied, refused};
use m4_io::dataset::ImportOptions;
use m4_io::dataset::SourceFormat::Vipe;

#[test]
fn vipe_matches_the_clip_it_was_written_from() {
    let truth = Truth::read();
    for name in ["import/vipe", "import/vipe/pose/dog.npz"] {
        let got = read(name, Vipe, &ImportOptions::default()).unwrap().train;
        // 4:2:0 video
        truth.same_cameras(&got, (24, 5.0));
        // halves: 11 bits
        truth.same_depth(&got, 1.0 / 2048.0, 0.0);
        // the sky is an instance that does not move
        truth.same_masks(&got);
        let ids = got.frames[1].instances.as_ref().unwrap();
        assert_eq!([ids.at(0, 0), ids.at(13, 12), ids.at(5, 30)], [1, 2, 0]);
        assert!(got.metric);
        assert!((got.duration_s.unwrap() - 0.4).abs() < 1e-3, "{:?}", got.duration_s);
    }
    let got = read("import/vipe", Vipe, &with_images()).unwrap().train;
    truth.same_cameras(&got, (0, 0.0));
}

#[test]
fn missing_and_unsupported_vipe_files_are_named() {
    let (_dir, here) = copied("import/vipe");
    let plain = ImportOptions::default();
    std::fs::write(here.join("intrinsics/dog_camera.txt"), "0: PINHOLE\n1: MEI\n").unwrap();
    let message = refused(&here, Vipe, &plain);
    assert!(message.contains("MEI") && message.contains("line 2"), "{message}");
    std::fs::remove_file(here.join("intrinsics/dog_camera.txt")).unwrap();
    std::fs::rename(here.join("rgb/dog.mp4"), here.join("rgb/cat.mp4")).unwrap();
    let message = refused(&here, Vipe, &plain);
    assert!(
        message.contains("rgb/dog.mp4") && message.contains("images"),
        "{message}"
    );
    std::fs::rename(here.join("rgb/cat.mp4"), here.join("rgb/dog.mp4")).unwrap();
    for part in ["pose", "intrinsics"] {
        std::fs::copy(here.join(part).join("dog.npz"), here.join(part).join("cat.npz")).unwrap();
    }
    let message = refused(&here, Vipe, &plain);
    assert!(message.contains("cat, dog"), "{message}");
    // depth and masks may be missing
    std::fs::remove_dir_all(here.join("depth")).unwrap();
    std::fs::remove_dir_all(here.join("mask")).unwrap();
    let got = m4_io::dataset::read(&here.join("pose/dog.npz"), Vipe, &plain, &m4_core::Silent)
        .unwrap()
        .train;
    assert!(got.frames.len() == 5 && got.frames.iter().all(|f| f.depth.is_none() && f.mask.is_none()));
}
