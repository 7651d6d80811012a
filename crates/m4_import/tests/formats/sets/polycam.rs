//! `fixtures/import/polycam`: corrected cameras, and the device's own half a metre aside.

use super::truth::*;
use crate::support::{Heard, copied, edit, fixture, refused};
use m4_import::{ImportOptions, SourceFormat, read};

const FORMAT: SourceFormat = SourceFormat::Polycam;

#[test]
fn it_is_the_clip_that_was_written() {
    for path in [fixture("import/polycam"), fixture("import/polycam/keyframes")] {
        let train = import(&path, FORMAT, &ImportOptions::default()).unwrap().train;
        assert_poses(&train, "c2w");
        assert_true_lens(&train);
        assert_pictures(&train, &truth("rgb"), 24.0, 1.5);
        assert_sensed(&train, 0.000_51, |_, _| false);
        // names that have a digit more from the middle on are in order of time
        assert_near(&times(&train), &[0.0, 1.0, 2.0, 3.0, 4.0], 1e-9);
        assert!((train.duration_s.unwrap() - 0.4).abs() < 1e-9 && train.metric);
    }
}

#[test]
fn without_corrected_cameras_the_device_s_are_taken() {
    let (_dir, path) = copied("import/polycam");
    std::fs::remove_dir_all(path.join("keyframes/corrected_cameras")).unwrap();
    let heard = Heard::default();
    let train = read(&path, FORMAT, &ImportOptions::default(), &heard).unwrap().train;
    assert!(heard.all().contains("no corrected cameras"), "{}", heard.all());
    let want = truth("c2w");
    for (i, frame) in train.frames.iter().enumerate() {
        assert!((frame.camera.c2w.translation.x - want[16 * i + 3] - 0.5).abs() < 1e-9);
    }
    let centimetres = ImportOptions {
        depth_unit: Some(0.01),
        ..ImportOptions::default()
    };
    let ten = import(&path, FORMAT, &centimetres).unwrap().train;
    let at = |c: &m4_scene::Capture| c.frames[1].depth.as_ref().unwrap().at(20, 9);
    assert!((at(&ten) / at(&train) - 10.0).abs() < 1e-4);
    // frames that a device left out are further apart in time
    let (_dir, path) = copied("import/polycam");
    std::fs::remove_file(path.join("keyframes/corrected_images/9999900000.jpg")).unwrap();
    let train = import(&path, FORMAT, &ImportOptions::default()).unwrap().train;
    assert_near(&times(&train), &[0.0, 1.5, 2.25, 3.0], 1e-9);
}

#[test]
fn faults_say_where_they_are() {
    let broken = |from: &str, to: &str, says: &[&str]| {
        let (_dir, path) = copied("import/polycam");
        edit(&path.join("keyframes/corrected_cameras/9999900000.json"), from, to);
        let why = refused(&path, FORMAT, &ImportOptions::default());
        assert!(
            why.contains("9999900000") && says.iter().all(|s| why.contains(s)),
            "{why}"
        );
    };
    broken("t_11", "s_11", &["missing field `t_11`"]);
    broken(
        r#""t_11": "#,
        r#""t_11": 5.0, "was": "#,
        &["t_00 to t_23", "not a rotation"],
    );
    broken(r#""width": 48"#, r#""width": 36"#, &["48 x 36"]);
    broken(r#""fx": "#, r#""fx": -"#, &["focal lengths"]);
    let (_dir, path) = copied("import/polycam");
    std::fs::copy(
        fixture("import/dycheck/covisible/2x/val/1_00001.png"),
        path.join("keyframes/confidence/9999900000.png"),
    )
    .unwrap();
    let why = refused(&path, FORMAT, &ImportOptions::default());
    assert!(
        why.contains("9999900000.png") && why.contains("48 x 36 pixels for depth of 24 x 18"),
        "{why}"
    );
    std::fs::rename(
        path.join("keyframes/corrected_images/9999900000.jpg"),
        path.join("keyframes/corrected_images/a.jpg"),
    )
    .unwrap();
    let why = refused(&path, FORMAT, &ImportOptions::default());
    assert!(why.contains("a.jpg") && why.contains("microseconds"), "{why}");
}
