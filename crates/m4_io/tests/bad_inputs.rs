//! Bad inputs: every message names the file, what is wrong, and what to do; nothing panics.

use crate::common::pinwheel;
use m4_core::{CounterRng, Plane, Progress, Silent};
use m4_io::ErrorKind;
use m4_io::capture::{self, CaptureOptions, Split};
use m4_io::image::{read_depth, read_rgb, write_depth, write_mask, write_rgb};
use m4_io::scene::safetensors;
use m4_io::trajectory;
use m4_io::video::{self, VideoOptions};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

fn options() -> VideoOptions {
    VideoOptions {
        size: Some(64),
        ffmpeg: PathBuf::from("/nonexistent/ffmpeg"),
        ..VideoOptions::default()
    }
}

/// The message of a clip that cannot be read; it names the file.
fn video_error(path: &Path, options: &VideoOptions, kind: ErrorKind) -> String {
    let error = video::read(path, options, &Silent).unwrap_err();
    assert_eq!(error.kind(), kind, "{error}");
    let text = error.to_string();
    let name = path.file_name().unwrap().to_string_lossy();
    assert!(text.contains(&*name), "{text}");
    text
}

fn file(bytes: &[u8]) -> (TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("clip.mp4");
    std::fs::write(&path, bytes).unwrap();
    (dir, path)
}

fn says(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in: {text}");
    }
}

// --- video ---------------------------------------------------------------------------------------

#[test]
fn a_clip_that_is_missing() {
    says(
        &video_error(Path::new("/nowhere/clip.mp4"), &options(), ErrorKind::NotFound),
        &["cannot read"],
    );
}

#[test]
fn a_clip_without_bytes() {
    let (_dir, path) = file(b"");
    says(
        &video_error(&path, &options(), ErrorKind::BadData),
        &["0 bytes", "copy it again"],
    );
}

#[test]
fn text_zeros_and_single_images_are_not_clips() {
    let (_dir, path) = file(b"this is no video, whatever its name says\n");
    says(
        &video_error(&path, &options(), ErrorKind::Unavailable),
        &["of no kind that is known", "install ffmpeg"],
    );
    let (_dir, path) = file(&[0; 5000]);
    says(&video_error(&path, &options(), ErrorKind::BadData), &["zeros"]);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("one.png");
    write_rgb(&path, &Plane::filled(8, 8, [1; 3])).unwrap();
    says(
        &video_error(&path, &options(), ErrorKind::BadData),
        &["single image", "folder"],
    );
}

#[test]
fn a_clip_that_needs_ffmpeg_where_there_is_none() {
    let (_dir, path) = file(&[0x1a, 0x45, 0xdf, 0xa3, 0, 0, 0, 0, 0, 0]);
    let text = video_error(&path, &options(), ErrorKind::Unavailable);
    says(&text, &["Matroska", "install ffmpeg", "libx264"]);
}

#[test]
fn a_recording_that_was_cut_off() {
    // Index at the end, as cameras write it: move `moov` behind `mdat`, then cut.
    let bytes = std::fs::read(pinwheel()).unwrap();
    let at = |kind: &[u8]| bytes.windows(4).position(|w| w == kind).unwrap() - 4;
    let len = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let (moov, mdat) = (at(b"moov"), at(b"mdat"));
    let mut late = bytes[..moov].to_vec();
    late.extend(&bytes[mdat..mdat + len(mdat)]);
    let (_dir, path) = file(&late);
    says(
        &video_error(&path, &options(), ErrorKind::BadData),
        &["incomplete", "moov", "untrunc"],
    );
    late.truncate(late.len() / 2);
    let (_dir, path) = file(&late);
    says(
        &video_error(&path, &options(), ErrorKind::BadData),
        &["ends inside box \"mdat\"", "moov"],
    );
    let (_dir, path) = file(&bytes[..moov + 300]);
    says(
        &video_error(&path, &options(), ErrorKind::BadData),
        &["index", "more than the file has"],
    );
}

#[test]
fn a_clip_whose_end_is_missing_is_read_as_far_as_it_goes() {
    let bytes = std::fs::read(pinwheel()).unwrap();
    let (_dir, path) = file(&bytes[..bytes.len() * 2 / 3]);
    let got = video::read(&path, &options(), &Silent).unwrap();
    assert!((50..90).contains(&got.frames.len()), "{}", got.frames.len());
    let warning = got.warnings.join("; ");
    says(&warning, &["of 96 frames are damaged or missing", "the first at"]);
    let strict = VideoOptions {
        strict: true,
        ..options()
    };
    says(
        &video_error(&path, &strict, ErrorKind::BadData),
        &["of 96 frames", "strict"],
    );
}

#[test]
fn audio_only_clips_are_refused() {
    let mut bytes = std::fs::read(pinwheel()).unwrap();
    let at = bytes.windows(4).position(|w| w == b"vide").unwrap();
    bytes[at..at + 4].copy_from_slice(b"soun");
    let (_dir, path) = file(&bytes);
    says(
        &video_error(&path, &options(), ErrorKind::BadData),
        &["no video track", "sound"],
    );
}

#[test]
fn a_clip_without_frames() {
    let mut bytes = std::fs::read(pinwheel()).unwrap();
    let at = bytes.windows(4).position(|w| w == b"stsz").unwrap();
    bytes[at + 12..at + 16].fill(0);
    let (_dir, path) = file(&bytes);
    says(
        &video_error(&path, &options(), ErrorKind::BadData),
        &["video track is empty"],
    );
}

#[test]
fn counts_beyond_the_file_size_are_refused() {
    for (kind, offset) in [
        (b"stsz", 12),
        (b"stts", 8),
        (b"ctts", 8),
        (b"stsc", 8),
        (b"stco", 8),
        (b"elst", 8),
    ] {
        let mut bytes = std::fs::read(pinwheel()).unwrap();
        let at = bytes.windows(4).position(|w| w == kind).unwrap();
        bytes[at + offset..at + offset + 4].copy_from_slice(&0xffff_fff0u32.to_be_bytes());
        let (_dir, path) = file(&bytes);
        let text = video_error(&path, &options(), ErrorKind::BadData);
        says(&text, &["entries", std::str::from_utf8(kind).unwrap()]);
    }
    // Constant sample size: 4 billion samples of one byte.
    let mut bytes = std::fs::read(pinwheel()).unwrap();
    let at = bytes.windows(4).position(|w| w == b"stsz").unwrap();
    bytes[at + 8..at + 12].copy_from_slice(&1u32.to_be_bytes());
    bytes[at + 12..at + 16].copy_from_slice(&u32::MAX.to_be_bytes());
    let (_dir, path) = file(&bytes);
    says(
        &video_error(&path, &options(), ErrorKind::BadData),
        &["4294967295 samples", "more than the file has"],
    );
}

#[test]
fn impossible_options_are_refused() {
    let read = |options: VideoOptions| video::read(&pinwheel(), &options, &Silent).unwrap_err();
    let text = read(VideoOptions {
        max_frames: Some(0),
        ..options()
    })
    .to_string();
    says(&text, &["max_frames", "at least 1"]);
    says(
        &read(VideoOptions {
            size: Some(3),
            ..options()
        })
        .to_string(),
        &["size is 3", "16"],
    );
    let text = read(VideoOptions {
        start_s: Some(2.0),
        end_s: Some(1.0),
        ..options()
    })
    .to_string();
    says(&text, &["start_s", "before the end"]);
    says(
        &read(VideoOptions {
            end_s: Some(f64::NAN),
            ..options()
        })
        .to_string(),
        &["end_s is NaN"],
    );
    let error = read(VideoOptions {
        start_s: Some(60.0),
        ..options()
    });
    says(&error.to_string(), &["pinwheel.mp4", "lasts 3.96 s", "60.00 s"]);
}

#[test]
fn a_clip_that_does_not_fit_in_memory() {
    let small = VideoOptions {
        size: None,
        max_memory_bytes: 10 << 20,
        ..options()
    };
    let error = video::read(&pinwheel(), &small, &Silent).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsupported);
    says(
        &error.to_string(),
        &[
            "96 frames",
            "480 x 360",
            "47 MiB",
            "10 MiB",
            "max_frames",
            "size",
            "max_memory_bytes",
        ],
    );
    assert!(
        video::read(
            &pinwheel(),
            &VideoOptions {
                max_frames: Some(8),
                ..small
            },
            &Silent
        )
        .is_ok()
    );
}

#[test]
fn reading_can_be_cancelled() {
    struct Stop;
    impl Progress for Stop {
        fn update(&self, _: &str, _: usize, _: usize, _: &str) {}
        fn warn(&self, _: &str) {}
        fn cancelled(&self) -> bool {
            true
        }
    }
    let error = video::read(&pinwheel(), &options(), &Stop).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Cancelled);
}

/// Any bytes give a clip or an error, never a panic.
fn survives(bytes: &[u8], what: &str) -> bool {
    let (_dir, path) = file(bytes);
    let options = VideoOptions {
        max_frames: Some(2),
        end_s: Some(0.4),
        ..options()
    };
    let result = std::panic::catch_unwind(|| video::read(&path, &options, &Silent).is_ok());
    result.unwrap_or_else(|_| panic!("panicked: {what}"))
}

#[test]
fn flipped_and_missing_bytes_never_panic() {
    let original = std::fs::read(pinwheel()).unwrap();
    let mdat = original.windows(4).position(|w| w == b"mdat").unwrap();
    let mut rng = CounterRng::new(11, 0, 0);
    let (mut read, mut refused) = (0, 0);
    let mut note = |ok: bool| if ok { read += 1 } else { refused += 1 };
    // Every third byte of the index, set to extremes; then random places of the frames.
    for at in (0..mdat).step_by(7) {
        let mut bytes = original.clone();
        bytes[at] = if at % 2 == 0 {
            0xff
        } else {
            bytes[at] ^ (1 << rng.below(8))
        };
        note(survives(&bytes, &format!("byte {at}")));
    }
    for i in 0..60 {
        let mut bytes = original.clone();
        for _ in 0..1 + i {
            let at = mdat + rng.below(200_000);
            bytes[at] = rng.next_u64() as u8;
        }
        note(survives(&bytes, &format!("{i} bytes of the frames")));
    }
    for i in 0..40 {
        note(survives(
            &original[..mdat * i / 20],
            &format!("cut at {}", mdat * i / 20),
        ));
    }
    eprintln!("{read} read, {refused} refused");
    assert!(read > 100 && refused > 100, "{read} read, {refused} refused");
}

// --- folders of images and single images ------------------------------------------------------

#[test]
fn folders_without_images_or_of_several_sizes_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("frames");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join("readme.txt"), "nothing").unwrap();
    says(
        &video_error(&folder, &options(), ErrorKind::BadData),
        &["no image", ".jpg"],
    );
    for (i, (w, h)) in [(20, 10), (20, 10), (10, 20)].into_iter().enumerate() {
        write_rgb(&folder.join(format!("{i}.png")), &Plane::filled(w, h, [9; 3])).unwrap();
    }
    let error = video::read(&folder, &options(), &Silent).unwrap_err().to_string();
    says(&error, &["2.png", "10 x 20", "20 x 10"]);
    std::fs::write(folder.join("2.png"), b"\x89PNG\r\n\x1a\nbroken").unwrap();
    let error = video::read(&folder, &options(), &Silent).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::BadData);
    says(&error.to_string(), &["2.png", "damaged"]);
}

#[test]
fn malformed_images_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.png");
    let error = read_rgb(&path).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::NotFound);
    std::fs::write(&path, "GIF89a and so on").unwrap();
    let error = read_rgb(&path).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsupported);
    says(&error.to_string(), &["a.png", "not a PNG or JPEG", "convert"]);
    write_rgb(&path, &Plane::filled(40, 30, [1, 2, 3])).unwrap();
    let original = std::fs::read(&path).unwrap();
    for cut in 8..original.len() - 12 {
        std::fs::write(&path, &original[..cut]).unwrap();
        says(&read_rgb(&path).unwrap_err().to_string(), &["a.png", "damaged"]);
    }
    // A header that promises 4 billion pixels per side.
    let mut huge = original.clone();
    huge[16..24].fill(0x7f);
    std::fs::write(&path, &huge).unwrap();
    assert!(read_rgb(&path).is_err());
}

#[test]
fn depth_maps_must_be_16_bit_greyscale() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("d.png");
    write_rgb(&path, &Plane::filled(4, 4, [1; 3])).unwrap();
    says(
        &read_depth(&path, 0.001).unwrap_err().to_string(),
        &["d.png", "16 bits", "Rgb8"],
    );
    write_mask(&path, &Plane::filled(4, 4, 255)).unwrap();
    says(&read_depth(&path, 0.001).unwrap_err().to_string(), &["16 bits", "L8"]);
    let error = write_depth(&dir.path().join("d.jpg"), &Plane::filled(4, 4, 1.0), 0.001).unwrap_err();
    says(&error.to_string(), &["d.jpg", "JPEG"]);
}

// --- captures -------------------------------------------------------------------------------------

/// A capture of two frames, as JSON to spoil.
pub fn good() -> (TempDir, Value) {
    let dir = tempfile::tempdir().unwrap();
    for i in 0..2 {
        write_rgb(&dir.path().join(format!("{i}.png")), &Plane::filled(20, 10, [i; 3])).unwrap();
    }
    let frame = |i: i32| {
        json!({"file_path": format!("{i}.png"), "time": i,
               "transform_matrix": [[1, 0, 0, i], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]})
    };
    (
        dir,
        json!({"fl_x": 30.0, "w": 20, "h": 10, "frames": [frame(0), frame(1)]}),
    )
}

/// The message after `spoil` changed the JSON.
fn capture_error(spoil: impl FnOnce(&mut Value), kind: ErrorKind) -> String {
    let (dir, mut json) = good();
    spoil(&mut json);
    let path = dir.path().join("transforms_train.json");
    std::fs::write(&path, json.to_string()).unwrap();
    let error = capture::read(dir.path(), Split::Train, &CaptureOptions::default(), &Silent).unwrap_err();
    assert_eq!(error.kind(), kind, "{error}");
    let text = error.to_string();
    says(&text, &["transforms_train.json"]);
    text
}

#[test]
fn valid_capture_is_read() {
    let (dir, json) = good();
    std::fs::write(dir.path().join("transforms_train.json"), json.to_string()).unwrap();
    let got = capture::read(dir.path(), Split::Train, &CaptureOptions::default(), &Silent).unwrap();
    assert_eq!(got.frames.len(), 2);
}

type Spoil = fn(&mut Value);

#[test]
fn faults_of_frames_and_keys_are_named() {
    use ErrorKind::{BadData, NotFound, Unsupported};
    let cases: [(Spoil, ErrorKind, &[&str]); 20] = [
        (
            |j| drop(j["frames"][1].as_object_mut().unwrap().remove("transform_matrix")),
            BadData,
            &["frame 1", "1.png", "transform_matrix is missing"],
        ),
        (
            |j| j["frames"][1]["transform_matrix"][0][0] = json!(-1),
            BadData,
            &["frame 1", "determinant -1.0"],
        ),
        (
            |j| j["frames"][0]["transform_matrix"][0][0] = json!(1.5),
            BadData,
            &["frame 0", "determinant 1.5"],
        ),
        (
            |j| drop(j["frames"][0]["transform_matrix"].as_array_mut().unwrap().drain(1..)),
            BadData,
            &["frame 0", "1 rows of 4", "4 rows of 4"],
        ),
        (
            |j| j["frames"][1]["transform_matrix"][2][1] = json!(null),
            BadData,
            &["frame 1", "null"],
        ),
        (
            |j| j["frames"][1]["transform_matrix"][3] = json!([4, 5, 6, 1]),
            BadData,
            &["frame 1", "[4.0, 5.0, 6.0, 1.0]", "transposed"],
        ),
        (|j| j["fl_x"] = json!(-5.0), BadData, &["frame 0", "-5", "above 0"]),
        (
            |j| drop(j.as_object_mut().unwrap().remove("fl_x")),
            BadData,
            &["frame 0", "fl_x", "missing"],
        ),
        (|j| j["cx"] = json!(900.0), BadData, &["(900, 5)", "20 x 10"]),
        (|j| j["camera_model"] = json!("FOV"), Unsupported, &["FOV"]),
        (
            |j| j["depth_unit_scale_factor"] = json!(0),
            BadData,
            &["depth_unit_scale_factor", "it is 0"],
        ),
        (|j| j["duration_s"] = json!(-1), BadData, &["duration_s", "it is -1"]),
        (|j| j["frames"] = json!([]), BadData, &["no frames"]),
        (
            |j| j["frames"][1]["time"] = json!(1.5),
            BadData,
            &["frame 1", "time = 1.5", "0 (first"],
        ),
        (
            |j| j["frames"][1]["time"] = json!("soon"),
            BadData,
            &["frame 1", "soon"],
        ),
        (
            |j| drop(j["frames"][1].as_object_mut().unwrap().remove("time")),
            BadData,
            &["1 of 2 frames have a time"],
        ),
        (
            |j| j["frames"][0]["file_path"] = json!("gone.png"),
            NotFound,
            &["frame 0", "gone.png"],
        ),
        (|j| j["w"] = json!(40), BadData, &["0.png", "w = 40", "has 20"]),
        (
            |j| j["frames"][1]["depth_file_path"] = json!("0.png"),
            BadData,
            &["frame 1", "0.png", "16 bits"],
        ),
        (
            |j| j["frames"][1]["mask_path"] = json!("mask/1.png"),
            NotFound,
            &["frame 1", "1.png"],
        ),
    ];
    for (spoil, kind, words) in cases {
        says(&capture_error(spoil, kind), words);
    }
}

#[test]
fn malformed_or_missing_lists_of_frames_are_refused() {
    let (dir, json) = good();
    let path = dir.path().join("transforms_train.json");
    std::fs::write(&path, json.to_string().replace("30.0", "NaN")).unwrap();
    let read = || capture::read(&path, Split::Train, &CaptureOptions::default(), &Silent).unwrap_err();
    says(&read().to_string(), &["line 1", "neither NaN nor Infinity"]);
    std::fs::write(&path, &json.to_string()[..200]).unwrap();
    says(&read().to_string(), &["not the JSON that was expected", "EOF"]);
    std::fs::remove_file(&path).unwrap();
    let error = capture::read(dir.path(), Split::Train, &CaptureOptions::default(), &Silent).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::NotFound);
    says(&error.to_string(), &["transforms_train.json", "a capture is a folder"]);
}

#[test]
fn test_views_without_a_training_split() {
    let (dir, json) = good();
    std::fs::write(dir.path().join("transforms_test.json"), json.to_string()).unwrap();
    let error = capture::read(dir.path(), Split::Test, &CaptureOptions::default(), &Silent).unwrap_err();
    says(
        &error.to_string(),
        &["transforms_test.json", "transforms_train.json", "time_frames"],
    );
}

#[test]
fn a_capture_that_does_not_fit_in_memory() {
    let (dir, json) = good();
    std::fs::write(dir.path().join("transforms_train.json"), json.to_string()).unwrap();
    let small = CaptureOptions {
        max_memory_bytes: 1000,
        ..CaptureOptions::default()
    };
    let error = capture::read(dir.path(), Split::Train, &small, &Silent).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsupported);
    says(&error.to_string(), &["2 frames", "max_memory_bytes"]);
}

// --- scenes and paths -----------------------------------------------------------------------------

#[test]
fn malformed_scene_files_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.safetensors");
    assert_eq!(safetensors::read(&path).unwrap_err().kind(), ErrorKind::NotFound);
    let text = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        let error = safetensors::read(&path).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::BadData);
        error.to_string()
    };
    says(&text(b""), &["not a scene file", "0 bytes"]);
    says(
        &text(b"ply\nformat binary"),
        &["scene.safetensors", "does not start like"],
    );
    says(
        &text(b"\xff\xff\xff\xff\xff\xff\xff\x7f{}"),
        &["damaged", "header says 9223372036854775807 bytes"],
    );
    says(
        &text(b"\x02\0\0\0\0\0\0\0{}"),
        &["minute4d_scene", "scene.safetensors of a run"],
    );
    let json = br#"{"a":{"dtype":"F32","shape":[4000000000],"data_offsets":[0,16000000000]}}"#;
    let mut bytes = (json.len() as u64).to_le_bytes().to_vec();
    bytes.extend(json);
    says(&text(&bytes), &["damaged"]);
}

#[test]
fn a_camera_path_that_is_missing() {
    let error = trajectory::read(Path::new("/nowhere/path.json"), 10).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::NotFound);
    says(&error.to_string(), &["/nowhere/path.json"]);
}
