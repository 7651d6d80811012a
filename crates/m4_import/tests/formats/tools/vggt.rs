//! Archives of VGGT.

use super::truth::{Truth, read};
use m4_import::ImportOptions;
use m4_import::SourceFormat::Vggt;

#[test]
fn an_archive_is_the_clip() {
    let truth = Truth::read();
    let got = read("import/vggt/predictions.npz", Vggt, &ImportOptions::default())
        .unwrap()
        .train;
    truth.same_cameras(&got, (0, 0.0));
    truth.same_depth(&got, 1e-6, 0.0);
    assert!(got.frames.iter().all(|f| f.mask.is_none()) && !got.metric);
    // other arrays are named
    let message = read("tracks/numpy.npz", Vggt, &ImportOptions::default())
        .unwrap_err()
        .to_string();
    assert!(message.contains("depth") && message.contains("coords"), "{message}");
}
