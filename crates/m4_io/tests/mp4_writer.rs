//! MP4 files that are written: they play elsewhere, read back here, and are whole or not there.

use crate::common::{
    have_ffmpeg, pinwheel, psnr, says, temporary, times, without_ffmpeg as options,
};
use m4_core::{Plane, Silent, Video};
use m4_io::ErrorKind;
use m4_io::video::{Mp4Writer, VideoOptions, read};
use std::path::Path;
use std::process::Command;

fn example(frames: usize) -> Video {
    let options = VideoOptions {
        end_s: Some((frames - 1) as f64 / 24.0),
        ..options()
    };
    read(&pinwheel(), &options, &Silent).unwrap()
}

fn write(video: &Video, path: &Path, fps: f64) {
    let (w, h) = video.frames[0].rgb.size();
    let mut writer = Mp4Writer::create(path, w, h, fps).unwrap();
    for frame in &video.frames {
        writer.push(frame.rgb.clone()).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn a_written_clip_reads_back_and_plays_in_ffmpeg() {
    let dir = tempfile::tempdir().unwrap();
    let video = example(60);
    let path = dir.path().join("out/clip.mp4");
    write(&video, &path, 24.0);
    let size = std::fs::metadata(&path).unwrap().len();
    assert!(size < 2_500_000, "{size} bytes for 60 frames");
    assert_eq!(
        std::fs::read_dir(path.parent().unwrap()).unwrap().count(),
        1
    );
    let back = read(&path, &options(), &Silent).unwrap();
    assert!(back.warnings.is_empty(), "{:?}", back.warnings);
    assert_eq!(back.frames.len(), 60);
    for (i, (a, b)) in back.frames.iter().zip(&video.frames).enumerate() {
        assert!((a.time_s - i as f64 / 24.0).abs() < 1e-4);
        assert!(
            psnr(&a.rgb, &b.rgb) > 33.0,
            "frame {i}: {:.1} dB",
            psnr(&a.rgb, &b.rgb)
        );
    }
    if !have_ffmpeg() {
        return;
    }
    let entries =
        "stream=codec_name,profile,pix_fmt,color_space,color_range,avg_frame_rate,nb_read_frames";
    let arguments = [
        "-v",
        "error",
        "-count_frames",
        "-show_entries",
        entries,
        "-of",
        "default=nw=1",
    ];
    let output = Command::new("ffprobe")
        .args(arguments)
        .arg(&path)
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        output.stderr.is_empty(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    for line in [
        "codec_name=h264",
        "profile=High",
        "pix_fmt=yuv420p",
        "color_space=bt709",
        "color_range=tv",
        "avg_frame_rate=24/1",
        "nb_read_frames=60",
    ] {
        assert!(message.contains(line), "{line} is not in:\n{message}");
    }
    let strict = ["-v", "error", "-xerror", "-err_detect", "explode", "-i"];
    let output = Command::new("ffmpeg")
        .args(strict)
        .arg(&path)
        .args(["-f", "null", "-"])
        .output()
        .unwrap();
    assert!(
        output.status.success() && output.stderr.is_empty(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

#[test]
fn the_same_frames_give_the_same_bytes_for_any_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    // two pieces and a half
    let video = example(30);
    let bytes = [1, 3].map(|threads| {
        let path = dir.path().join("clip.mp4");
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| write(&video, &path, 12.0));
        std::fs::read(&path).unwrap()
    });
    assert!(bytes[0] == bytes[1]);
}

#[test]
fn mp4_pads_odd_sides_and_accepts_one_frame() {
    let (_dir, path) = temporary("odd.mp4");
    let image = Plane::from_fn(101, 77, |x, y| [(x * 2) as u8, (y * 3) as u8, 128]);
    let mut writer = Mp4Writer::create(&path, 101, 77, 12.5).unwrap();
    writer.push(image.clone()).unwrap();
    writer.finish().unwrap();
    let back = read(&path, &options(), &Silent).unwrap();
    assert_eq!(
        (
            back.frames.len(),
            back.frames[0].rgb.size(),
            times(&back)[0]
        ),
        (1, (102, 78), 0.0)
    );
    for (x, y) in [(10, 10), (50, 40), (100, 76)] {
        let off = back.frames[0].rgb[(x, y)]
            .iter()
            .zip(image[(x, y)])
            .map(|(a, b)| a.abs_diff(b))
            .max();
        assert!(off <= Some(8), "({x}, {y})");
    }
}

#[test]
fn invalid_mp4_frames_are_refused_and_leave_no_file() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("clip.mp4");
    for (w, h, fps, says) in [
        (8, 8, 24.0, "16 x 16"),
        (8000, 100, 24.0, "3840"),
        (64, 64, 0.0, "frames per second"),
        (64, 64, f64::NAN, "frames per second"),
    ] {
        let error = Mp4Writer::create(&path, w, h, fps).unwrap_err();
        assert!(
            error.to_string().contains(says) && error.kind() == ErrorKind::Unsupported,
            "{error}"
        );
    }
    says(
        &Mp4Writer::create(&path, 64, 48, 24.0)
            .unwrap()
            .finish()
            .unwrap_err(),
        &["no frames"],
    );
    let mut writer = Mp4Writer::create(&path, 64, 48, 24.0).unwrap();
    let error = writer.push(Plane::filled(48, 64, [0; 3])).unwrap_err();
    assert!(
        error.to_string().contains("48 x 64") && error.to_string().contains("64 x 48"),
        "{error}"
    );
    drop(writer);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    let error = Mp4Writer::create(dir.path(), 64, 48, 24.0).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::CannotWrite);
}
