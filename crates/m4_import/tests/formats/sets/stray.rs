//! `fixtures/import/stray`: an H.264 video, lenses a frame that differ from `camera_matrix.csv`.

use super::truth::*;
use crate::support::{copied, edit, fixture, refused};
use m4_import::{ImportOptions, SourceFormat};

const FORMAT: SourceFormat = SourceFormat::StrayScanner;

#[test]
fn it_is_the_clip_that_was_written() {
    let train = import(&fixture("import/stray"), FORMAT, &ImportOptions::default())
        .unwrap()
        .train;
    assert_poses(&train, "c2w");
    assert_true_lens(&train);
    // half of the colour is lost at the edge of the ball; the next frame is three times as far
    assert_pictures(&train, &truth("rgb"), 128.0, 4.0);
    assert_sensed(&train, 0.000_51, |_, _| false);
    assert_near(&times(&train), &[0.0, 1.0, 2.0, 3.0, 4.0], 1e-6);
    assert!((train.duration_s.unwrap() - 0.4).abs() < 1e-6 && train.metric);
}

#[test]
fn pictures_of_a_folder_may_stand_for_the_video() {
    let (_dir, path) = copied("import/stray");
    std::fs::remove_file(path.join("rgb.mp4")).unwrap();
    let why = refused(&path, FORMAT, &ImportOptions::default());
    assert!(why.contains("rgb.mp4 is missing") && why.contains("pictures"), "{why}");
    edit(&path.join("odometry.csv"), "fx, fy, cx, cy", "a, b, c, d");
    let options = ImportOptions {
        pictures: Some(fixture("import/davis/JPEGImages/480p/ball")),
        factor: Some(2),
        ..ImportOptions::default()
    };
    let train = import(&path, FORMAT, &options).unwrap().train;
    assert_poses(&train, "c2w");
    // camera_matrix.csv: focal lengths 3 pixels longer, halved with the pictures
    let k = &train.frames[3].camera.intrinsics;
    assert_eq!((k.width, k.height), (24, 18));
    assert_near(&[k.fx, k.fy, k.cx, k.cy], &[26.5, 27.5, 12.25, 8.625], 1e-6);
    assert_eq!(train.frames[3].rgb.size(), (24, 18));
}

#[test]
fn faults_say_where_they_are() {
    let broken = |file: &str, from: &str, to: &str, says: &[&str]| {
        let (_dir, path) = copied("import/stray");
        edit(&path.join(file), from, to);
        let why = refused(&path, FORMAT, &ImportOptions::default());
        assert!(why.contains(file) && says.iter().all(|s| why.contains(s)), "{why}");
    };
    broken("odometry.csv", "qw", "q", &["first line"]);
    broken("odometry.csv", "000002,", "000000,", &["line 4", "not later"]);
    broken("odometry.csv", "100.200000", "x", &["line 4"]);
    broken("odometry.csv", "000002, 0.040000000000", "000002, nan", &["line 4"]);
    let place = "000002, 0.040000000000, 0.060000000000, -0.040000000000, ";
    let far = format!("{place}9, 9, 9, 9, 50, 52, 24.5, 17.25, ");
    broken("odometry.csv", place, &far, &["frame 2", "quaternion"]);
    broken(
        "camera_matrix.csv",
        "53.000000, 0.000000",
        "53.000000, 0.100000",
        &["0, fy, cy"],
    );
    let (_dir, path) = copied("import/stray");
    let text = std::fs::read_to_string(path.join("odometry.csv")).unwrap();
    let few: Vec<&str> = text.lines().take(2).collect();
    std::fs::write(path.join("odometry.csv"), few.join("\n")).unwrap();
    let why = refused(&path, FORMAT, &ImportOptions::default());
    assert!(why.contains("1 poses for 5 frames"), "{why}");
    // pictures that were turned
    let turned = image_turned(&path);
    let options = ImportOptions {
        pictures: Some(turned),
        ..ImportOptions::default()
    };
    let (_dir, whole) = copied("import/stray");
    let why = refused(&whole, FORMAT, &options);
    assert!(
        why.contains("principal point") && why.contains("neither turned"),
        "{why}"
    );
}

fn image_turned(path: &std::path::Path) -> std::path::PathBuf {
    let folder = path.join("turned");
    std::fs::create_dir(&folder).unwrap();
    for i in 0..5 {
        let rgb = m4_io::image::read_rgb(&fixture(&format!("import/davis/JPEGImages/480p/ball/{i:05}.jpg"))).unwrap();
        let turned = m4_scene::Plane::from_fn(H, W, |x, y| rgb[(y, x)]);
        m4_io::image::write_rgb(&folder.join(format!("{i}.png")), &turned).unwrap();
    }
    folder
}
