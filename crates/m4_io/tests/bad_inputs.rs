//! Bad clips, images and scene files: every message names the file, what is wrong, and what to do;
//! nothing panics.

use crate::common::{pinwheel, says, temporary, without_ffmpeg};
use m4_core::{Plane, Silent};
use m4_io::ErrorKind;
use m4_io::image::{read_depth, read_rgb, write_depth, write_mask, write_rgb};
use m4_io::scene::safetensors;
use m4_io::video::{self, VideoOptions};
use m4_testkit::StopAtPoll;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

fn options() -> VideoOptions {
    VideoOptions {
        size: Some(64),
        ..without_ffmpeg()
    }
}

/// The clip cannot be read; the message names the file and has these words.
#[track_caller]
fn refused(path: &Path, options: &VideoOptions, kind: ErrorKind, words: &[&str]) {
    let error = video::read(path, options, &Silent).unwrap_err();
    assert_eq!(error.kind(), kind, "{error}");
    let name = path.file_name().unwrap().to_string_lossy();
    says(&error, &[&[&*name][..], words].concat());
}

fn file(bytes: &[u8]) -> (TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("clip.mp4");
    std::fs::write(&path, bytes).unwrap();
    (dir, path)
}

fn example() -> Vec<u8> {
    std::fs::read(pinwheel()).unwrap()
}

/// Where the name of the first box of a kind is.
fn at(bytes: &[u8], kind: &[u8]) -> usize {
    bytes.windows(4).position(|w| w == kind).unwrap()
}

/// The example with `value` at `offset` behind the name of the first box of a kind.
fn with(kind: &[u8], offset: usize, value: &[u8]) -> Vec<u8> {
    let mut bytes = example();
    let start = at(&bytes, kind) + offset;
    bytes[start..start + value.len()].copy_from_slice(value);
    bytes
}

// --- video ---------------------------------------------------------------------------------------

#[test]
fn damaged_and_foreign_files_are_refused_as_clips() {
    use ErrorKind::{BadData, NotFound, Unavailable};
    refused(
        Path::new("/nowhere/clip.mp4"),
        &options(),
        NotFound,
        &["cannot read"],
    );
    // Index at the end, as cameras write it: move `moov` behind `mdat`, then cut.
    let bytes = example();
    let (moov, mdat) = (at(&bytes, b"moov") - 4, at(&bytes, b"mdat") - 4);
    let len = u32::from_be_bytes(bytes[mdat..mdat + 4].try_into().unwrap()) as usize;
    let late = [&bytes[..moov], &bytes[mdat..mdat + len]].concat();
    let many = 0xffff_fff0u32.to_be_bytes();
    let matroska = [0x1a, 0x45, 0xdf, 0xa3, 0, 0, 0, 0, 0, 0];
    let mut one_size = with(b"stsz", 8, &1u32.to_be_bytes());
    let count = at(&one_size, b"stsz") + 12;
    one_size[count..count + 4].fill(0xff);
    let mut png = Vec::new();
    png.extend(b"\x89PNG\r\n\x1a\n and so on");
    let cases: [(&[u8], ErrorKind, &[&str]); 16] = [
        (b"", BadData, &["0 bytes", "copy it again"]),
        (&[0; 5000], BadData, &["zeros"]),
        (&png, BadData, &["single image", "folder"]),
        (
            &matroska,
            Unavailable,
            &["another kind than MP4", "install ffmpeg", "libx264"],
        ),
        (&late, BadData, &["incomplete", "moov", "untrunc"]),
        (
            &late[..late.len() / 2],
            BadData,
            &["ends inside box \"mdat\"", "moov"],
        ),
        (
            &bytes[..moov + 300],
            BadData,
            &["index", "more than the file has"],
        ),
        (
            &with(b"vide", 0, b"soun"),
            BadData,
            &["no video track", "sound"],
        ),
        (
            &with(b"stsz", 12, &[0; 4]),
            BadData,
            &["video track is empty"],
        ),
        (&with(b"stsz", 12, &many), BadData, &["entries", "stsz"]),
        (&with(b"stts", 8, &many), BadData, &["entries", "stts"]),
        (&with(b"ctts", 8, &many), BadData, &["entries", "ctts"]),
        (&with(b"stsc", 8, &many), BadData, &["entries", "stsc"]),
        (&with(b"stco", 8, &many), BadData, &["entries", "stco"]),
        (&with(b"elst", 8, &many), BadData, &["entries", "elst"]),
        // Constant sample size: 4 billion samples of one byte.
        (
            &one_size,
            BadData,
            &["4294967295 samples", "more than the file has"],
        ),
    ];
    for (bytes, kind, words) in cases {
        let (_dir, path) = file(bytes);
        refused(&path, &options(), kind, words);
    }
}

#[test]
fn a_clip_whose_end_is_missing_is_read_as_far_as_it_goes() {
    let bytes = example();
    let (_dir, path) = file(&bytes[..bytes.len() * 2 / 3]);
    let got = video::read(&path, &options(), &Silent).unwrap();
    assert!((50..90).contains(&got.frames.len()), "{}", got.frames.len());
    says(
        &got.warnings.join("; "),
        &["of 96 frames are damaged or missing", "the first at"],
    );
    let strict = VideoOptions {
        strict: true,
        ..options()
    };
    refused(
        &path,
        &strict,
        ErrorKind::BadData,
        &["of 96 frames", "strict"],
    );
}

#[test]
fn impossible_options_are_refused() {
    use ErrorKind::{BadData, BadOption, Unsupported};
    type Set = fn(&mut VideoOptions);
    let cases: [(Set, ErrorKind, &[&str]); 6] = [
        (
            |o| o.max_frames = Some(0),
            BadOption,
            &["max_frames", "at least 1"],
        ),
        (|o| o.size = Some(3), BadOption, &["size is 3", "16"]),
        (
            |o| (o.start_s, o.end_s) = (Some(2.0), Some(1.0)),
            BadOption,
            &["start_s", "before the end"],
        ),
        (|o| o.end_s = Some(f64::NAN), BadOption, &["end_s is NaN"]),
        (
            |o| o.start_s = Some(60.0),
            BadData,
            &["lasts 3.96 s", "60.00 s"],
        ),
        (
            |o| (o.size, o.max_memory_bytes) = (None, 10 << 20),
            Unsupported,
            &[
                "96 frames",
                "480 x 360",
                "47 MiB",
                "10 MiB",
                "max_frames",
                "size",
                "max_memory_bytes",
            ],
        ),
    ];
    for (set, kind, words) in cases {
        let mut options = options();
        set(&mut options);
        refused(&pinwheel(), &options, kind, words);
    }
    let fits = VideoOptions {
        size: None,
        max_memory_bytes: 10 << 20,
        max_frames: Some(8),
        ..options()
    };
    assert!(video::read(&pinwheel(), &fits, &Silent).is_ok());
}

#[test]
fn reading_can_be_cancelled() {
    let error = video::read(&pinwheel(), &options(), &StopAtPoll::after(0)).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Cancelled);
}

// --- folders of images and single images ------------------------------------------------------

#[test]
fn folders_without_images_or_of_several_sizes_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("frames");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join("readme.txt"), "nothing").unwrap();
    refused(
        &folder,
        &options(),
        ErrorKind::BadData,
        &["no image", ".jpg"],
    );
    for (i, (w, h)) in [(20, 10), (20, 10), (10, 20)].into_iter().enumerate() {
        write_rgb(
            &folder.join(format!("{i}.png")),
            &Plane::filled(w, h, [9; 3]),
        )
        .unwrap();
    }
    refused(
        &folder,
        &options(),
        ErrorKind::BadData,
        &["2.png", "10 x 20", "20 x 10"],
    );
}

#[test]
fn damaged_images_of_a_folder_are_left_out_as_damaged_frames_of_a_video() {
    let dir = tempfile::tempdir().unwrap();
    let clip = |i: usize| dir.path().join(format!("{i}.jpg"));
    let image = Plane::from_fn(64, 48, |x, y| [(x * 3) as u8, (y * 5) as u8, (x * y) as u8]);
    (0..5).for_each(|i| write_rgb(&clip(i), &image).unwrap());
    let whole = std::fs::read(clip(1)).unwrap();
    // a third of the bytes; a hole; no header; nothing
    let mut hole = whole.clone();
    let middle = whole.len() / 2;
    hole[middle..middle + 600].fill(0);
    for broken in [&whole[..whole.len() / 3], &hole, b"\xff\xd8\xff\xe0", b""] {
        std::fs::write(clip(1), broken).unwrap();
        let got = video::read(dir.path(), &options(), &Silent).unwrap();
        let times: Vec<f64> = got
            .frames
            .iter()
            .map(|f| (f.time_s * 30.0).round())
            .collect();
        assert_eq!(times, [0.0, 2.0, 3.0, 4.0]);
        let [warning] = &got.warnings[..] else {
            panic!("{:?}", got.warnings)
        };
        assert!(
            warning.starts_with("1 of 5 frames are damaged") && warning.contains("1.jpg"),
            "{warning}"
        );
        let strict = VideoOptions {
            strict: true,
            ..options()
        };
        refused(
            dir.path(),
            &strict,
            ErrorKind::BadData,
            &["1 of 5 frames", "1.jpg", "strict"],
        );
        assert!(read_rgb(&clip(1)).is_err());
    }
    (0..5).for_each(|i| std::fs::write(clip(i), &whole[..whole.len() / 2]).unwrap());
    refused(
        dir.path(),
        &options(),
        ErrorKind::BadData,
        &["no frame that can be decoded", "0.jpg"],
    );
}

#[test]
fn every_damaged_png_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("d.png");
    write_depth(&path, &Plane::from_fn(20, 15, |x, y| (x * y) as f32), 0.001).unwrap();
    let whole = std::fs::read(&path).unwrap();
    let data = whole.windows(4).position(|w| w == b"IDAT").unwrap();
    for at in data..whole.len() - 12 {
        let mut broken = whole.clone();
        broken[at] ^= 0x10;
        std::fs::write(&path, &broken).unwrap();
        assert!(read_depth(&path, 0.001).is_err(), "byte {at}");
    }
    for cut in 8..whole.len() {
        std::fs::write(&path, &whole[..cut]).unwrap();
        assert!(read_depth(&path, 0.001).is_err(), "{cut}");
    }
}

#[test]
fn malformed_images_are_refused() {
    let (_dir, path) = temporary("a.png");
    let error = read_rgb(&path).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::NotFound);
    std::fs::write(&path, "GIF89a and so on").unwrap();
    let error = read_rgb(&path).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsupported);
    says(&error, &["a.png", "not a PNG or JPEG", "convert"]);
    write_rgb(&path, &Plane::filled(40, 30, [1, 2, 3])).unwrap();
    let original = std::fs::read(&path).unwrap();
    for cut in 8..original.len() - 12 {
        std::fs::write(&path, &original[..cut]).unwrap();
        says(&read_rgb(&path).unwrap_err(), &["a.png", "damaged"]);
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
        &read_depth(&path, 0.001).unwrap_err(),
        &["d.png", "16 bits", "Rgb8"],
    );
    write_mask(&path, &Plane::filled(4, 4, 255)).unwrap();
    says(&read_depth(&path, 0.001).unwrap_err(), &["16 bits", "L8"]);
    let error =
        write_depth(&dir.path().join("d.jpg"), &Plane::filled(4, 4, 1.0), 0.001).unwrap_err();
    says(&error, &["d.jpg", "JPEG"]);
}

// --- scenes -----------------------------------------------------------------------------

#[test]
fn malformed_scene_files_are_refused() {
    let (_dir, path) = temporary("scene.safetensors");
    assert_eq!(
        safetensors::read(&path).unwrap_err().kind(),
        ErrorKind::NotFound
    );
    let text = |bytes: &[u8], words: &[&str]| {
        std::fs::write(&path, bytes).unwrap();
        let error = safetensors::read(&path).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::BadData);
        says(&error, words);
    };
    text(b"", &["not a scene file", "0 bytes"]);
    text(
        b"ply\nformat binary",
        &["scene.safetensors", "does not start like"],
    );
    text(
        b"\xff\xff\xff\xff\xff\xff\xff\x7f{}",
        &["damaged", "header says 9223372036854775807 bytes"],
    );
    text(
        b"\x02\0\0\0\0\0\0\0{}",
        &["minute4d_scene", "scene.safetensors of a run"],
    );
    let json = br#"{"a":{"dtype":"F32","shape":[4000000000],"data_offsets":[0,16000000000]}}"#;
    let mut bytes = (json.len() as u64).to_le_bytes().to_vec();
    bytes.extend(json);
    text(&bytes, &["damaged"]);
}
