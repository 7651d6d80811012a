//! Damaged and malformed data sets: an error or a valid capture, and little memory.

use crate::cases::{self, Case};
use crate::fixtures::{copy, fixture};
use crate::memory::{alone, measured};
use crate::mutate;
use m4_core::Capture;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use zip::ZipArchive;

/// Damaged copies a parser.
const COPIES: u64 = 120;
/// Memory that reading may take beyond what the sound source takes, bytes: this, and this many times the damaged file.
const FREE: usize = 4 << 20;
const TIMES: usize = 64;

/// All files below a folder or the file itself, in order of names.
fn files_below(path: &Path) -> Vec<PathBuf> {
    if path.is_file() {
        return vec![path.to_path_buf()];
    }
    let mut entries: Vec<PathBuf> = std::fs::read_dir(path).unwrap().map(|e| e.unwrap().path()).collect();
    entries.sort();
    entries.iter().flat_map(|entry| files_below(entry)).collect()
}

/// Copies a source below `dir`; sources that are no fixtures are made of some.
fn prepared(source: &str, dir: &Path) -> PathBuf {
    let here = dir.join(Path::new(source).file_name().unwrap());
    let archive = |name: &str| ZipArchive::new(File::open(fixture(name)).unwrap()).unwrap();
    match source {
        "record3d unpacked" => archive("import/record3d/clip.r3d").extract(&here).unwrap(),
        "record3d large" => archive("import/record3d/large.r3d").extract(&here).unwrap(),
        // a clip with a depth map in a file of OpenEXR
        "exr" => {
            copy(&fixture("import/instant4d"), &here);
            copy(&fixture("import/clip"), &dir.join("clip"));
            let list = std::fs::read_to_string(here.join("transforms.json")).unwrap();
            assert!(list.contains("depth_2.npy"));
            std::fs::write(here.join("transforms.json"), list.replace("depth_2.npy", "depth_2.exr")).unwrap();
            let mut bytes = Vec::new();
            let mut depth = archive("import/vipe/depth/dog.zip");
            depth.by_name("00002.exr").unwrap().read_to_end(&mut bytes).unwrap();
            std::fs::write(here.join("depth_2.exr"), bytes).unwrap();
        }
        fixed => copy(&fixture(fixed), &here),
    }
    here
}

/// Writes a file again: one that is emptied and written again is sent to the disk at once by some file systems.
fn replace(file: &Path, bytes: &[u8]) {
    std::fs::remove_file(file).unwrap();
    std::fs::write(file, bytes).unwrap();
}

/// What is wrong with a capture that was read, if something is.
fn fault_of(capture: &Capture) -> Option<&'static str> {
    let last = capture.time_frames as f64 - 1.0;
    let frame_fault = |frame: &m4_core::CaptureFrame| {
        let k = &frame.camera.intrinsics;
        let c2w = frame.camera.c2w.matrix();
        let rigid = c2w.iter().all(|v| v.is_finite()) && (c2w.determinant() - 1.0).abs() < 1e-2;
        let depth = frame.depth.as_ref();
        [
            (frame.rgb.size() == (k.width, k.height), "the size of an image"),
            (
                k.fx > 0.0 && k.fy > 0.0 && k.cx.is_finite() && k.cy.is_finite(),
                "a lens",
            ),
            (rigid, "a pose"),
            ((0.0..=last).contains(&frame.t), "a time"),
            (
                depth.is_none_or(|d| d.every(1).all(|z| z.is_finite() && z >= 0.0)),
                "depth",
            ),
        ]
        .into_iter()
        .find_map(|(sound, what)| (!sound).then_some(what))
    };
    if capture.frames.is_empty() || !capture.duration_s.is_none_or(f64::is_finite) {
        return Some("no frames, or their duration");
    }
    let tracks_fit = capture.tracks.as_ref().is_none_or(|tracks| {
        tracks.frames() == capture.frames.len() && tracks.xyz().as_flattened().iter().all(|v| !v.is_infinite())
    });
    if !tracks_fit {
        return Some("tracks");
    }
    capture.frames.iter().find_map(frame_fault)
}

/// Damages the files of one case in turn; what it came to, and what went wrong.
fn run(case: &Case) -> (String, Vec<String>) {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let here = prepared(case.source, dir);
    let mut files = files_below(&here);
    let name = |file: &Path| file.strip_prefix(&here).unwrap().to_string_lossy().into_owned();
    files.retain(|file| case.files.is_empty() || case.files.iter().any(|part| name(file).contains(part)));
    let (sound, taken_sound) = measured(|| (case.read)(&here));
    let sound = sound.unwrap().unwrap();
    assert_eq!(sound.iter().find_map(fault_of), None, "{}", case.source);
    let about = |what: &str| format!("{} {:?}, {what}", case.source, case.files);
    let (mut failures, mut refused, mut read, mut most) = (Vec::new(), 0, 0, 0);
    let mut check = |file: &Path, bytes: &[u8], what: &str| {
        replace(file, bytes);
        let (outcome, taken) = measured(|| (case.read)(&here));
        let mut fail = |why: String| failures.push(about(&format!("{what} in {}: {why}", name(file))));
        most = most.max(taken);
        if taken > taken_sound + FREE + TIMES * bytes.len() {
            fail(format!("{} KiB of memory", taken >> 10));
        }
        match outcome {
            None => fail("a panic".into()),
            Some(Err(reason)) => {
                // it names the source or a file of it
                if reason.len() >= 2000 || !(reason.contains(&*dir.to_string_lossy()) || reason.contains("clip.r3d")) {
                    fail(reason.chars().take(200).collect());
                }
                refused += 1;
            }
            Some(Ok(captures)) => {
                if let Some(fault) = captures.iter().find_map(fault_of) {
                    fail(format!("{fault} is not sound"));
                }
                read += 1;
            }
        }
    };
    for i in 0..COPIES {
        let file = &files[i as usize % files.len()];
        let whole = std::fs::read(file).unwrap();
        let (bytes, what) = mutate::damaged(&whole, file.extension().is_some_and(|e| e == "npz"), i);
        check(file, &bytes, &format!("copy {i}: {what}"));
        replace(file, &whole);
    }
    let whole = std::fs::read(&files[0]).unwrap();
    for (bytes, what) in mutate::made(&whole, &files[0].file_name().unwrap().to_string_lossy()) {
        check(&files[0], &bytes, what);
    }
    if refused < case.refused {
        failures.push(about(&format!(
            "only {refused} were refused: does the damage reach the reader?"
        )));
    }
    let summary = about(&format!("{refused} refused, {read} read, {} KiB at most", most >> 10));
    (summary, failures)
}

#[test]
fn damaged_sources_give_an_error_or_a_valid_capture() {
    let _alone = alone();
    // reading takes a few hundred microseconds: waiting for other threads would be most of it
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let mut failures = Vec::new();
    for (summary, wrong) in one.install(|| cases::all().iter().map(run).collect::<Vec<_>>()) {
        println!("{summary}");
        failures.extend(wrong);
    }
    assert!(failures.is_empty(), "{failures:#?}");
}
