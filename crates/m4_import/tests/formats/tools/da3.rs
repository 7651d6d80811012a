//! Depth Anything 3.

use super::truth::{Truth, read, with_pictures};
use crate::support::{copied, refused};
use m4_import::ImportOptions;
use m4_import::SourceFormat::Da3;

#[test]
fn an_archive_with_pictures() {
    let truth = Truth::read();
    for name in ["import/da3", "import/da3/exports/npz/results.npz"] {
        let got = read(name, Da3, &ImportOptions::default()).unwrap().train;
        truth.same_cameras(&got, (0, 0.0));
        truth.same_depth(&got, 1e-6, 0.0);
        assert!(!got.metric && got.duration_s.is_some());
    }
}

#[test]
fn an_archive_without_pictures_of_half_the_size() {
    let truth = Truth::read();
    let path = "import/da3/half";
    let message = read(path, Da3, &ImportOptions::default()).unwrap_err().to_string();
    assert!(message.contains("image") && message.contains("pictures"), "{message}");
    let got = read(path, Da3, &with_pictures()).unwrap().train;
    truth.same_cameras(&got, (0, 0.0));
    let depth = got.frames[1].depth.as_ref().unwrap();
    assert_eq!(depth.size(), (24, 18));
    assert!((f64::from(depth.at(7, 5)) - truth.depth[1][10 * 48 + 14]).abs() < 1e-6);
}

#[test]
fn a_streaming_folder() {
    let truth = Truth::read();
    let got = read("import/da3_streaming", Da3, &ImportOptions::default())
        .unwrap()
        .train;
    truth.same_cameras(&got, (0, 0.0));
    truth.same_depth(&got, 1e-6, 0.0);
    let (_dir, here) = copied("import/da3_streaming");
    std::fs::remove_file(here.join("results_output/frame_2.npz")).unwrap();
    let message = refused(&here, Da3, &ImportOptions::default());
    assert!(message.contains("5 poses") && message.contains("4 files"), "{message}");
    std::fs::remove_dir_all(here.join("results_output")).unwrap();
    let message = refused(&here, Da3, &ImportOptions::default());
    assert!(message.contains("save_depth_conf_result"), "{message}");
}
