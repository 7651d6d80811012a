//! Files of MegaSaM come through the same door.

use super::truth::read;
use crate::dataset::support::fixture;
use m4_core::Silent;
use m4_io::dataset::ImportOptions;
use m4_io::dataset::SourceFormat::Megasam;
use m4_io::megasam::{self, MegasamOptions};

#[test]
fn all_three_layouts_are_as_their_reader_has_them() {
    for name in [
        "megasam/outputs/dog_droid.npz",
        "megasam/outputs_cvd/dog_sgd_cvd_hr.npz",
        "megasam/reconstructions/dog",
    ] {
        let options = ImportOptions {
            fps: Some(12.0),
            ..ImportOptions::default()
        };
        let got = read(name, Megasam, &options).unwrap().train;
        let direct = MegasamOptions {
            fps: Some(12.0),
            ..MegasamOptions::default()
        };
        let want = megasam::read(&fixture(name), &direct, &Silent).unwrap();
        assert_eq!(
            (got.frames.len(), got.duration_s, got.metric),
            (3, want.duration_s, want.metric)
        );
        for (a, b) in got.frames.iter().zip(&want.frames) {
            assert_eq!((a.camera, a.t, &a.name), (b.camera, b.t, &b.name));
            assert_eq!(
                (&a.rgb, &a.depth, &a.mask, &a.motion),
                (&b.rgb, &b.depth, &b.mask, &b.motion)
            );
        }
    }
    let message = read("import/side/depth.npz", Megasam, &ImportOptions::default())
        .unwrap_err()
        .to_string();
    assert!(message.contains("depth.npz"), "{message}");
}
