//! What the tests of this crate share.

use m4_core::{RgbImage, Video};
use m4_io::video::VideoOptions;
use m4_testkit::{Need, skip};
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// The example clip: 96 frames, 480x360, 24 per second, H.264 High with B-frames.
pub fn pinwheel() -> PathBuf {
    PathBuf::from(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../examples/pinwheel.mp4"
    ))
}

/// Reads frames in the size of the file, and nothing by ffmpeg.
pub fn without_ffmpeg() -> VideoOptions {
    VideoOptions {
        size: None,
        ffmpeg: PathBuf::from("/nonexistent/ffmpeg"),
        ..VideoOptions::default()
    }
}

/// True when ffmpeg can be started; else the test is listed as skipped.
#[track_caller]
pub fn have_ffmpeg() -> bool {
    let available = Command::new("ffmpeg")
        .arg("-version")
        .output()
        .is_ok_and(|o| o.status.success());
    if !available {
        skip(Need::Ffmpeg, "ffmpeg is not on the PATH");
    }
    available
}

/// True when ffmpeg can be started and has the encoder `name`; else the test, or that part of it,
/// is listed as skipped. What is made with an encoder that is there has to succeed.
#[track_caller]
pub fn have_encoder(name: &str) -> bool {
    if !have_ffmpeg() {
        return false;
    }
    let listed = Command::new("ffmpeg")
        .args(["-v", "error", "-encoders"])
        .output();
    let available = listed.is_ok_and(|o| {
        let text = String::from_utf8_lossy(&o.stdout);
        text.lines()
            .any(|line| line.split_whitespace().nth(1) == Some(name))
    });
    if !available {
        skip(
            Need::Ffmpeg,
            &format!("this build of ffmpeg has no encoder {name}"),
        );
    }
    available
}

/// Runs ffmpeg with arguments separated by spaces, then `output`; false where this build of ffmpeg
/// cannot, and the test, or that part of it, is listed as skipped.
#[track_caller]
pub fn ffmpeg(arguments: &str, output: &Path) -> bool {
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "error", "-nostdin", "-y", "-threads", "1"]);
    command.args(arguments.split_whitespace()).arg(output);
    match command.output() {
        Ok(o) if o.status.success() => true,
        Ok(o) => {
            let message = String::from_utf8_lossy(&o.stderr);
            skip(Need::Ffmpeg, &format!("ffmpeg {arguments}: {message}"));
            false
        }
        Err(e) => {
            skip(Need::Ffmpeg, &format!("ffmpeg cannot be started: {e}"));
            false
        }
    }
}

/// Peak signal-to-noise ratio of two images of one size, dB.
pub fn psnr(a: &RgbImage, b: &RgbImage) -> f64 {
    assert_eq!(a.size(), b.size());
    let square = |(a, b): (&u8, &u8)| (f64::from(*a) - f64::from(*b)).powi(2);
    let pairs = a.data().as_flattened().iter().zip(b.data().as_flattened());
    let mse = pairs.map(square).sum::<f64>() / (3 * a.data().len()) as f64;
    10.0 * (255.0 * 255.0 / mse.max(1e-9)).log10()
}

/// Frame times, seconds.
pub fn times(video: &Video) -> Vec<f64> {
    video.frames.iter().map(|f| f.time_s).collect()
}

/// A script in a folder of its own.
#[cfg(unix)]
pub fn script(dir: &Path, name: &str, body: &str) -> PathBuf {
    use std::os::unix::fs::PermissionsExt;
    let path = dir.join(name);
    // Written under another name by a shell of its own: a file that some thread has open for
    // writing while another one forks cannot be started.
    let write = format!(
        "cat > '{0}.new' && chmod 755 '{0}.new' && mv '{0}.new' '{0}'",
        path.display()
    );
    let mut shell = Command::new("sh")
        .args(["-c", &write])
        .stdin(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let text = format!("#!/bin/sh\n{body}\n");
    std::io::Write::write_all(&mut shell.stdin.take().unwrap(), text.as_bytes()).unwrap();
    assert!(shell.wait().unwrap().success());
    assert_eq!(
        std::fs::metadata(&path).unwrap().permissions().mode() & 0o777,
        0o755
    );
    path
}

/// What ffprobe says of a clip of three images of 4 x 2 pixels.
#[cfg(unix)]
pub const PROBED: &str = r#"echo '{"packets":[{"pts_time":"0","flags":"K_"},{"pts_time":"1","flags":"__"},{"pts_time":"2","flags":"__"}],
"streams":[{"codec_name":"ffv1","width":4,"height":2,"pix_fmt":"yuv420p"}]}'"#;

/// These images, as ffmpeg sends them.
#[cfg(unix)]
pub fn sent(seconds: std::ops::Range<u32>) -> String {
    let image = |s| {
        format!(
            "echo '[Parsed_showinfo_0 @ 0x5] [info] n: {s} pts: {s} pts_time:{s} fmt:yuv420p sar:1/1 s:4x2 i:P' >&2
             printf 'abcdefghijklabcdefghijkl'\n"
        )
    };
    seconds.map(image).collect()
}

/// A clip for ffmpeg, and options that name scripts as `ffprobe` and `ffmpeg`.
#[cfg(unix)]
pub fn fake_ffmpeg(dir: &Path, probe: &str, decode: &str) -> (PathBuf, VideoOptions) {
    let clip = dir.join("clip.mkv");
    std::fs::write(&clip, [0x1a, 0x45, 0xdf, 0xa3, 0, 0, 0, 0]).unwrap();
    script(dir, "ffprobe", probe);
    (
        clip,
        VideoOptions {
            ffmpeg: script(dir, "ffmpeg", decode),
            size: None,
            ..VideoOptions::default()
        },
    )
}

/// All of `words` are in the message.
#[track_caller]
pub fn says(message: &dyn std::fmt::Display, words: &[&str]) {
    let text = message.to_string();
    for word in words {
        assert!(text.contains(word), "{word:?} is not in: {text}");
    }
}

/// A temporary folder, and the path of a file in it.
pub fn temporary(name: &str) -> (TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    (dir, path)
}

/// `fixtures/NAME`.
pub fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../fixtures")
        .join(name)
}

/// Copies a file, or a folder with all that is in it, to where a test may change it.
pub fn copy(from: &Path, to: &Path) {
    if from.is_file() {
        std::fs::copy(from, to).unwrap();
        return;
    }
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        copy(&entry.path(), &to.join(entry.file_name()));
    }
}

/// A `.npy` file of an array in C order.
pub fn npy(descr: &str, shape: &str, bytes: &[u8]) -> Vec<u8> {
    let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend((text.len() as u16).to_le_bytes());
    out.extend(text.as_bytes());
    out.extend(bytes);
    out
}
