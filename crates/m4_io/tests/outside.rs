//! Captures that name files outside of their folder.

use crate::bad_inputs::good;
use m4_core::{Capture, Plane, Silent};
use m4_io::ErrorKind;
use m4_io::capture::{self, CaptureOptions, Split};
use m4_io::dataset::ReadSourceError;
use m4_io::image::{write_mask, write_rgb};
use m4_io::reach::Reach;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

fn read(folder: &Path, json: &Value, reach: Reach) -> Result<Capture, ReadSourceError> {
    fs::write(folder.join("transforms_train.json"), json.to_string()).unwrap();
    let options = CaptureOptions {
        reach,
        ..CaptureOptions::default()
    };
    capture::read(folder, Split::Train, &options, &Silent)
}

/// It is refused by a message that names the list, the place, the file and the way out.
fn refused(folder: &Path, json: &Value, words: &[&str]) {
    let error = read(folder, json, Reach::Inside).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::BadData, "{error}");
    let text = error.to_string();
    for word in [&["transforms_train.json", "outside of", "--allow-outside"], words].concat() {
        assert!(text.contains(word), "{word:?} is not in: {text}");
    }
}

#[test]
fn files_outside_the_capture_are_not_read() {
    let (dir, json) = good();
    let folder = dir.path().join("set");
    fs::create_dir(&folder).unwrap();
    for i in 0..2 {
        fs::rename(dir.path().join(format!("{i}.png")), folder.join(format!("{i}.png"))).unwrap();
    }
    let private = dir.path().join("private.png");
    write_rgb(&private, &Plane::filled(20, 10, [77; 3])).unwrap();
    write_mask(&dir.path().join("mask.png"), &Plane::filled(20, 10, 255)).unwrap();
    read(&folder, &json, Reach::Inside).unwrap();

    let original = private.display().to_string();
    for name in [
        "../private.png",
        "../private",
        "../set/../private.png",
        original.as_str(),
    ] {
        let mut json = json.clone();
        json["frames"][1]["file_path"] = json!(name);
        refused(&folder, &json, &["frame 1", "private.png"]);
        let got = read(&folder, &json, Reach::Anywhere).unwrap();
        assert_eq!(got.frames[1].rgb[(0, 0)], [77; 3]);
    }
    for key in ["depth_file_path", "mask_path", "motion_path", "instance_path"] {
        let mut json = json.clone();
        json["frames"][0][key] = json!("../mask.png");
        refused(&folder, &json, &["frame 0", "mask.png"]);
    }
    let mut with_mask = json.clone();
    with_mask["frames"][0]["mask_path"] = json!("../mask.png");
    assert!(
        read(&folder, &with_mask, Reach::Anywhere).unwrap().frames[0]
            .mask
            .is_some()
    );
    let mut with_tracks = json.clone();
    with_tracks["tracks_path"] = json!("../mask.png");
    refused(&folder, &with_tracks, &["tracks_path", "mask.png"]);
}

#[test]
fn paths_within_the_folder_may_be_written_in_any_way() {
    let (dir, mut json) = good();
    fs::create_dir(dir.path().join("images")).unwrap();
    fs::rename(dir.path().join("0.png"), dir.path().join("images/0.png")).unwrap();
    let original = dir.path().join("1.png").display().to_string();
    for (first, second) in [
        ("./images/0.png", "images/../1.png"),
        ("images/../images/0.png", "./1.png"),
        ("images/0", original.as_str()),
    ] {
        json["frames"][0]["file_path"] = json!(first);
        json["frames"][1]["file_path"] = json!(second);
        assert_eq!(read(dir.path(), &json, Reach::Inside).unwrap().frames.len(), 2);
    }
}

#[cfg(unix)]
#[test]
fn links_out_of_the_folder_are_not_followed() {
    use std::os::unix::fs::symlink;
    let (dir, json) = good();
    let folder = dir.path().join("set");
    fs::create_dir(&folder).unwrap();
    for i in 0..2 {
        symlink(dir.path().join(format!("{i}.png")), folder.join(format!("{i}.png"))).unwrap();
    }
    refused(&folder, &json, &["frame 0", "set/0.png", "which is"]);
    assert_eq!(read(&folder, &json, Reach::Anywhere).unwrap().frames.len(), 2);
    // a folder that is reached by a link is the folder itself
    let alias = dir.path().join("alias");
    symlink(dir.path(), &alias).unwrap();
    assert_eq!(read(&alias, &json, Reach::Inside).unwrap().frames.len(), 2);
}

#[test]
fn permission_to_read_outside_is_not_serialised() {
    let anywhere = CaptureOptions {
        reach: Reach::Anywhere,
        ..CaptureOptions::default()
    };
    let text = serde_json::to_string(&anywhere).unwrap();
    assert!(!text.contains("reach"), "{text}");
    let again: CaptureOptions = serde_json::from_str(&text).unwrap();
    assert_eq!(again.reach, Reach::Inside);
    assert!(serde_json::from_str::<CaptureOptions>(r#"{"reach": "Anywhere"}"#).is_err());
}
