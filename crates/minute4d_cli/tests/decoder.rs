//! Video is decoded by a process of its own, whose end ends nothing else.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

#[cfg(target_os = "linux")]
use crate::common::Ended;
use crate::common::Scratch;
use minute4d::core::Plane;
use minute4d::io::video::Mp4Writer;
use std::process::Stdio;

#[test]
fn limits_are_settings() {
    let dir = Scratch::new();
    let ended = dir.succeed("geometry --print-config --set video.decoder.memory_mb=900");
    let (_, section) = ended.stdout.split_once("[video.decoder]").unwrap();
    for line in ["memory_mb = 900", "cpu_seconds = 0", "idle_seconds = 120"] {
        assert!(section.contains(line), "{line} is not in {section}");
    }
    let words = ["video.decoder.memory", "memory_mb"];
    dir.refused("geometry --print-config --set video.decoder.memory=1", 78, &words);
}

#[cfg(target_os = "linux")]
#[test]
fn decoder_over_its_limits_is_killed_and_reported() {
    let dir = Scratch::new();
    let clip = dir.path("large.mp4");
    let mut writer = Mp4Writer::create(&clip, 3840, 2160, 24.0).unwrap();
    for i in 0..2 {
        let image = Plane::from_fn(3840, 2160, |x, y| [(x + i) as u8, y as u8, (x ^ y) as u8]);
        writer.push(&image).unwrap();
    }
    writer.finish().unwrap();
    // Our own process has all the memory that it wants. What a refusal of memory looks like depends on how much of it the program
    // itself takes.
    let words = ["large.mp4", "decoder failed", "video.decoder.memory_mb"];
    dir.refused("geometry large.mp4 -o out --set video.decoder.memory_mb=64", 69, &words);
    let words = ["decoder.idle_seconds"];
    dir.refused("geometry large.mp4 -o out --set video.decoder.idle_seconds=0", 78, &words);
}

#[test]
fn decode_command_is_hidden_and_fails_without_a_parent() {
    let dir = Scratch::new();
    for line in ["__decode-h264", "__decode-h264 1000000000 20"] {
        let output = dir.command(line).stdin(Stdio::null()).output().unwrap();
        assert_eq!(output.status.code(), Some(1));
        assert!(output.stdout.is_empty() && !output.stderr.is_empty());
    }
    let help = dir.succeed("--help");
    assert!(!help.stdout.contains("__decode"), "{}", help.stdout);
}

/// A folder with an `ffprobe` and an `ffmpeg` that record their environment and limits, and a clip for them.
#[cfg(target_os = "linux")]
fn note_takers(dir: &Scratch) {
    let notes = |name: &str| {
        let copy = |what: &str| format!("cat /proc/$$/{what} >'{}'\n", dir.at(&format!("{name}.{what}")));
        ["environ", "status", "limits"].map(copy).concat()
    };
    let probe = r#"echo '{"packets":[{"pts_time":"0","flags":"K_"}],
"streams":[{"codec_name":"ffv1","width":4,"height":2,"pix_fmt":"yuv420p"}]}'"#;
    let decode = "echo '[Parsed_showinfo_0 @ 0x5] [info] n: 0 pts: 0 pts_time:0 fmt:yuv420p sar:1/1 s:4x2 i:P' >&2
printf 'abcdefghijklabcdefghijkl'";
    for (name, rest) in [("ffprobe", probe), ("ffmpeg", decode)] {
        dir.install(name, &format!("{}{rest}", notes(name)));
    }
    std::fs::write(dir.path("clip.mkv"), [0x1a, 0x45, 0xdf, 0xa3, 0, 0, 0, 0]).unwrap();
}

#[cfg(target_os = "linux")]
#[test]
fn ffmpeg_gets_no_secrets_and_no_privileges() {
    let dir = Scratch::new();
    note_takers(&dir);
    let path = format!("{}:{}", dir.at("bin"), std::env::var("PATH").unwrap());
    let mut command = dir.command("inspect clip.mkv");
    command
        .env("PATH", path)
        .env("AWS_SECRET_ACCESS_KEY", "s3cr3t-1")
        .env("MY_PASSWORD", "s3cr3t-2")
        .env("HOME", "/home/s3cr3t-3");
    let ended = Ended::of(command.output().unwrap());
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    for name in ["ffprobe", "ffmpeg"] {
        let note = |what: &str| std::fs::read(dir.path(&format!("{name}.{what}"))).unwrap();
        let environ = String::from_utf8(note("environ")).unwrap();
        assert!(environ.contains("PATH=") && !environ.contains("s3cr3t"), "{environ:?}");
        let status = String::from_utf8(note("status")).unwrap();
        assert!(status.contains("NoNewPrivs:\t1"), "{status}");
        let limits = String::from_utf8(note("limits")).unwrap();
        let limit = |name: &str| {
            let line = limits.lines().find(|line| line.starts_with(name)).unwrap();
            line[name.len()..].split_whitespace().next().unwrap().to_owned()
        };
        assert_eq!(limit("Max open files"), "256");
        assert_eq!(limit("Max file size"), "1048576");
        assert!(limit("Max processes").parse::<u64>().is_ok(), "{limits}");
    }
}
