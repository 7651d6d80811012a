//! Video is decoded by a process of its own, whose end is an error of the clip.

use crate::common::{Scratch, program, refused, succeed};
use minute4d::io::video::Mp4Writer;
use minute4d::scene::Plane;
use std::process::Stdio;

#[test]
fn limits_are_settings() {
    let ended = succeed(&["geometry", "--print-config", "--set", "video.decoder.memory_mb=900"]);
    let (_, section) = ended.stdout.split_once("[video.decoder]").unwrap();
    for line in ["memory_mb = 900", "cpu_seconds = 0", "idle_seconds = 120"] {
        assert!(section.contains(line), "{line} is not in {section}");
    }
    let set = ["geometry", "--print-config", "--set", "video.decoder.memory=1"];
    refused(&set, 78, &["video.decoder.memory", "memory_mb"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_decoder_that_takes_too_much_is_an_error_of_the_clip() {
    let dir = Scratch::new();
    let clip = dir.path("large.mp4");
    let mut writer = Mp4Writer::create(&clip, 3840, 2160, 24.0).unwrap();
    for i in 0..2 {
        let picture = Plane::from_fn(3840, 2160, |x, y| [(x + i) as u8, y as u8, (x ^ y) as u8]);
        writer.push(&picture).unwrap();
    }
    writer.finish().unwrap();
    // Our own process has all the memory that it wants.
    let set = ["--set", "video.decoder.memory_mb=64"];
    let args = ["geometry", &dir.at("large.mp4"), "-o", &dir.at("out"), set[0], set[1]];
    // What a refusal of memory looks like depends on how much of it the program itself takes.
    refused(&args, 65, &["large.mp4", "decoder failed", "video.decoder.memory_mb"]);
    let set = ["--set", "video.decoder.idle_seconds=0"];
    let args = ["geometry", &dir.at("large.mp4"), "-o", &dir.at("out"), set[0], set[1]];
    refused(&args, 78, &["decoder.idle_seconds"]);
}

#[test]
fn the_hidden_command_decodes_for_nobody_else() {
    for arguments in [&["__decode-h264"][..], &["__decode-h264", "1000000000", "20"]] {
        let mut command = program();
        let output = command.args(arguments).stdin(Stdio::null()).output().unwrap();
        assert_eq!(output.status.code(), Some(1));
        assert!(output.stdout.is_empty() && !output.stderr.is_empty());
    }
    let help = succeed(&["--help"]);
    assert!(!help.stdout.contains("__decode"), "{}", help.stdout);
}
