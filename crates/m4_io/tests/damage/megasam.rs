//! Damaged and malformed files of MegaSaM: an error or a valid capture, and little memory.

use crate::fixtures;
use crate::memory::{alone, measured};
use m4_core::{CounterRng, Silent};
use m4_io::megasam::{MegasamOptions, read};
use std::fs;
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};

/// Damaged files a layout.
const FILES: usize = 400;
/// Memory that reading a file of some kilobytes may take, bytes: 1032 times what is packed, and some of it twice.
const MOST: usize = 64 << 20;

const NAMES: [&str; 5] = ["images", "disps", "poses", "intrinsics", "motion_prob"];

fn fixture(name: &str) -> PathBuf {
    fixtures::fixture("megasam").join(name)
}

/// True if it was refused.
fn refused(path: &Path, what: &str) -> bool {
    let (ended, peak) = measured(|| read(path, &MegasamOptions::default(), &Silent));
    assert!(peak < MOST, "{what}: {peak} bytes");
    let read = ended.unwrap_or_else(|| panic!("{what}: it panicked"));
    if let Ok(capture) = &read {
        let sound = |f: &m4_core::CaptureFrame| f.camera.c2w.matrix().iter().all(|v| v.is_finite());
        assert!(capture.frames.iter().all(sound), "{what}");
    }
    read.is_err()
}

fn npy(descr: &str, shape: &str, numbers: &[u8]) -> Vec<u8> {
    let text = format!("{{'descr': '{descr}', 'fortran_order': True, 'shape': {shape}, }}\n");
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend((text.len() as u16).to_le_bytes());
    out.extend(text.as_bytes());
    out.extend(numbers);
    out
}

fn archive(members: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in members {
        zip.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default())
            .unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

#[test]
fn no_damage_makes_it_panic_or_take_much_memory() {
    let _alone = alone();
    let mut rng = CounterRng::new(7, 1, 0);
    let dir = tempfile::tempdir().unwrap();

    for name in ["outputs/dog_droid.npz", "outputs_cvd/dog_sgd_cvd_hr.npz"] {
        let path = dir.path().join(Path::new(name).file_name().unwrap());
        let whole = fs::read(fixture(name)).unwrap();
        let mut count = 0;
        for k in 0..FILES {
            let mut bytes = whole.clone();
            match k % 4 {
                0 => bytes.truncate(rng.below(whole.len())),
                1 => bytes[rng.below(whole.len())] ^= 1 << rng.below(8),
                // the directory at the end, which tells sizes and places
                2 => bytes[whole.len() - 1 - rng.below(300)] = rng.below(256) as u8,
                _ => {
                    let at = rng.below(whole.len() - 8);
                    bytes[at..at + 8].fill(0xff);
                }
            }
            fs::write(&path, &bytes).unwrap();
            count += usize::from(refused(&path, &format!("{name} {k}")));
        }
        println!("{name}: {count} of {FILES} refused");
        assert!(2 * count > FILES, "{name}: {count} of {FILES}");
    }

    let folder = dir.path().join("dog");
    fs::create_dir_all(&folder).unwrap();
    let mut count = 0;
    for k in 0..FILES {
        for name in NAMES.map(|n| format!("{n}.npy")) {
            fs::copy(fixture("reconstructions/dog").join(&name), folder.join(&name)).unwrap();
        }
        let path = folder.join(format!("{}.npy", NAMES[k % 5]));
        let mut bytes = fs::read(&path).unwrap();
        match k / 5 % 4 {
            0 => bytes.truncate(rng.below(bytes.len())),
            1 => bytes[rng.below(128)] = b"0123456789(),' \xff"[rng.below(16)],
            2 => {
                let shape = bytes.windows(8).position(|w| w == b"'shape':").unwrap();
                bytes[shape + 10 + rng.below(2)] = b'9';
            }
            _ => {
                let at = 128 + rng.below(bytes.len() - 132);
                bytes[at..at + 4].fill(0xff);
            }
        }
        fs::write(&path, &bytes).unwrap();
        count += usize::from(refused(&folder, &format!("folder {k}")));
    }
    println!("folder: {count} of {FILES} refused");
    assert!(2 * count > FILES, "folder: {count} of {FILES}");

    // shapes that promise what the file does not hold, packed and not, in both orders
    let path = dir.path().join("bomb_droid.npz");
    for shape in [
        "(4000000000, 4000000000, 4000000000, 3)",
        "(1000, 2000, 2000, 3)",
        "(4294967296, 0, 4294967296, 3)",
        "(0, 0, 0, 3)",
        "(18446744073709551615, 1, 1, 3)",
        "(3, 16, 24, 3)",
        "(3,)",
        "()",
    ] {
        for descr in ["|u1", "<f8"] {
            let images = npy(descr, shape, &[0; 100]);
            fs::write(&path, archive(&[("images", images)])).unwrap();
            assert!(refused(&path, shape), "{descr} {shape}");
        }
    }
}
