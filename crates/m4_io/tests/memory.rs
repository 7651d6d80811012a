//! The peak of the memory of a process that reads a folder of images, each of which holds far more
//! pixels than bytes.
#![cfg(target_os = "linux")]

use flate2::write::ZlibEncoder;
use flate2::{Compression, Crc};
use m4_core::Silent;
use m4_io::video::{self, VideoOptions};
use std::io::Write;
use std::path::Path;
use std::process::Command;
use std::{env, fs};

const CLIP: &str = "MINUTE4D_TEST_CLIP";
const MIB: usize = 1 << 20;
/// What reading may take (docs/fuzzing.md): this, and this many times the files that are read at
/// once.
const FREE: usize = 64 * MIB;
const TIMES: usize = 64;
const THREADS: usize = 8;
/// The program itself, its threads, and what the allocator keeps.
const PROGRAM: usize = 64 * MIB;

/// A grey PNG file of one colour: a byte stands for a thousand pixels.
fn flat(width: usize, height: usize) -> Vec<u8> {
    let mut packed = ZlibEncoder::new(Vec::new(), Compression::best());
    let row = vec![0; width + 1];
    (0..height).for_each(|_| packed.write_all(&row).unwrap());
    let header = [
        &(width as u32).to_be_bytes()[..],
        &(height as u32).to_be_bytes(),
        &[8, 0, 0, 0, 0],
    ]
    .concat();
    let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
    for (name, body) in [
        (b"IHDR", header),
        (b"IDAT", packed.finish().unwrap()),
        (b"IEND", Vec::new()),
    ] {
        let mut sum = Crc::new();
        sum.update(name);
        sum.update(&body);
        file.extend((body.len() as u32).to_be_bytes());
        file.extend(name);
        file.extend(body);
        file.extend(sum.sum().to_be_bytes());
    }
    file
}

/// The process that reads: does nothing where it is not asked to.
#[test]
fn one_clip() {
    let Ok(folder) = env::var(CLIP) else { return };
    let options = VideoOptions {
        size: Some(64),
        ..VideoOptions::default()
    };
    let read = video::read(Path::new(&folder), &options, &Silent);
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let peak = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))
        .unwrap();
    let kib = peak.trim().trim_end_matches(" kB");
    println!(
        "\npeak {kib}\n{}",
        read.map_or_else(
            |e| e.to_string(),
            |clip| format!("{} frames", clip.frames.len())
        )
    );
}

#[test]
fn images_that_are_read_in_parallel_stay_within_the_memory_of_their_files() {
    for (copies, (width, height), said) in [
        (3, (16_000, 16_000), "above the limit of"),
        (24, (3000, 2900), "24 frames"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let image = flat(width, height);
        (0..copies)
            .for_each(|i| fs::write(folder.path().join(format!("{i}.png")), &image).unwrap());
        let mut command = Command::new(env::current_exe().unwrap());
        command.args(["--exact", "memory::one_clip", "--nocapture"]);
        command
            .env(CLIP, folder.path())
            .env("RAYON_NUM_THREADS", THREADS.to_string());
        let output = String::from_utf8(command.output().unwrap().stdout).unwrap();
        assert!(output.contains(said), "{output}");
        let peak: usize = output
            .lines()
            .find_map(|line| line.strip_prefix("peak "))
            .unwrap()
            .parse()
            .unwrap();
        // of those that can be decoded each thread holds one in colour until it is shrunk
        let held = if said == "24 frames" {
            THREADS * 3 * width * height
        } else {
            0
        };
        let limit = PROGRAM + FREE + TIMES * image.len() * THREADS.min(copies) + held;
        assert!(
            peak * 1024 < limit,
            "{} MiB, above {} MiB",
            peak / 1024,
            limit / MIB
        );
    }
}
