//! Damaged and malformed scene files: an error or a valid scene, and little memory.

use crate::memory::{alone, measured};
use m4_core::{CounterRng, Scene, SplatLayout};
use m4_io::scene::{fourdgs, ply};
use m4_testkit::{SceneSpec, harm, random_scene};
use std::path::Path;

/// Damaged files per format.
const FILES: u64 = 400;
/// Memory that reading may take, bytes: this, and this many times the file.
const FREE: usize = 64 << 20;
const TIMES: usize = 64;

fn scene(sh_degree: usize) -> Scene {
    random_scene(&SceneSpec {
        layout: SplatLayout {
            isotropic: false,
            sh_degree,
            time_degree: 0,
        },
        n_static: 60,
        n_dynamic: 80,
        time_frames: 11,
        ..SceneSpec::default()
    })
}

type Parse = fn(&[u8]) -> Result<Scene, String>;

/// Sound files of every format that is read from bytes.
fn formats(folder: &Path) -> Vec<(&'static str, Vec<Vec<u8>>, Parse)> {
    let path = folder.join("file");
    let bytes = || std::fs::read(&path).unwrap();
    let (mut clips, mut instants) = (Vec::new(), Vec::new());
    for sh_degree in [0, 2] {
        let scene = scene(sh_degree);
        clips.push(fourdgs::encode(&scene, &fourdgs::FourdgsConfig::default()).unwrap().0);
        ply::write(&path, &scene, 5.0).unwrap();
        instants.push(bytes());
    }
    instants.push(text_of(&instants[0]));
    vec![
        ("4dgs", clips, |b| {
            let read = fourdgs::parse(Path::new("file"), b).map_err(|e| e.to_string())?;
            Ok(read.scene)
        }),
        ("ply", instants, |b| {
            let read = ply::parse(Path::new("file"), b).map_err(|e| e.to_string())?;
            Ok(read.scene)
        }),
    ]
}

/// A binary PLY file of 32-bit numbers as text.
fn text_of(binary: &[u8]) -> Vec<u8> {
    let end = b"end_header\n";
    let at = binary.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let head = std::str::from_utf8(&binary[..at]).unwrap();
    let mut text = head.replace("binary_little_endian", "ascii");
    for word in binary[at..].as_chunks::<4>().0 {
        text.push_str(&format!("{} ", f32::from_le_bytes(*word)));
    }
    text.into_bytes()
}

/// Parses within the memory allowed.
fn parse_bounded(name: &str, parse: Parse, bytes: &[u8], what: &str) -> Result<Scene, String> {
    let (outcome, used) = measured(|| parse(bytes));
    assert!(
        used <= FREE + TIMES * bytes.len(),
        "{name} with {what}: {used} bytes of memory for a file of {}",
        bytes.len()
    );
    outcome.unwrap_or_else(|| panic!("{name} with {what}: a panic"))
}

#[test]
fn damaged_files_give_an_error_or_a_valid_scene() {
    let _alone = alone();
    let dir = tempfile::tempdir().unwrap();
    for (name, files, parse) in formats(dir.path()) {
        for bytes in &files {
            let sound = parse_bounded(name, parse, bytes, "no damage").unwrap();
            assert!(sound.splats.n() > 60, "{name}");
        }
        let (mut refused, mut read) = (0, 0);
        for i in 0..FILES {
            let mut rng = CounterRng::new(7, 0xc0_44_09_7e, i);
            let mut bytes = files[rng.below(files.len())].clone();
            let mut what = harm(&mut bytes, &mut rng);
            if rng.below(4) == 0 && !bytes.is_empty() {
                what = harm(&mut bytes, &mut rng);
            }
            match parse_bounded(name, parse, &bytes, &format!("{what}, file {i}")) {
                Err(reason) => {
                    assert!(reason.contains("file") && reason.len() < 1000, "{name} {i}: {reason}");
                    refused += 1;
                }
                Ok(scene) => {
                    assert!(scene.splats.is_finite(), "{name} with {what}, file {i}: not finite");
                    assert!(scene.near.is_finite() && scene.background.iter().all(|v| v.is_finite()));
                    assert!((1..=100_000).contains(&scene.time_frames), "{name} {i}");
                    assert!(scene.duration_s.is_none_or(f64::is_finite));
                    for frame in &scene.source {
                        assert!(frame.t.is_finite() && frame.camera.intrinsics.fx > 0.0);
                        assert!(frame.camera.c2w.matrix().iter().all(|v| v.is_finite()));
                    }
                    read += 1;
                }
            }
        }
        println!("{name}: {refused} refused, {read} read");
        assert!(
            refused > FILES / 5,
            "{name}: only {refused} of {FILES} refused: does the damage reach the reader?"
        );
    }
}
