//! Files that were damaged or made to do harm: an error or a sound clip, and little memory.
//!
//! The allocator counts for the whole process, so everything happens in one test.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use m4_import::{ImportOptions, SourceFormat};
use m4_math::CounterRng;
use m4_scene::Silent;
use peak_alloc::PeakAlloc;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// Damaged copies of each file.
const COPIES: u64 = 120;
/// Memory that reading may take beyond what an intact source takes, bytes: this, and so many times the file.
const FREE: usize = 4 << 20;
const TIMES: usize = 64;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures").join(name)
}

fn copy(from: &Path, to: &Path) {
    if from.is_dir() {
        std::fs::create_dir_all(to).unwrap();
        for entry in std::fs::read_dir(from).unwrap() {
            let entry = entry.unwrap();
            copy(&entry.path(), &to.join(entry.file_name()));
        }
    } else {
        std::fs::copy(from, to).unwrap();
    }
}

/// Copy `k` of a file: cut off, bits turned, a large number written over eight bytes, a piece repeated, or random text.
fn damaged(whole: &[u8], k: u64) -> Vec<u8> {
    let at = |lane: u64, below: usize| CounterRng::new(7, 16 * k + lane, 0).below(below.max(1));
    let mut bytes = whole.to_vec();
    let place = at(0, bytes.len());
    match k % 5 {
        0 => bytes.truncate(place),
        1 => {
            for lane in 1..=1 + at(1, 4) as u64 {
                let i = at(lane + 1, bytes.len());
                if let Some(b) = bytes.get_mut(i) {
                    *b ^= 1 << at(lane + 6, 8);
                }
            }
        }
        2 => {
            let large = [0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f];
            let n = 8.min(bytes.len() - place.min(bytes.len()));
            bytes.splice(place..place + n, large);
        }
        3 => {
            let end = (place + 1 + at(2, 200)).min(bytes.len());
            let piece = bytes[place.min(end)..end].to_vec();
            bytes.splice(place..place, piece);
        }
        _ => {
            let texts: [&[u8]; 6] = [b"1e308", b"-", b"NaN", b"99999999999999999999", b"[[[[", b"\xff\xfe"];
            let text = texts[at(3, texts.len())];
            let end = (place + text.len()).min(bytes.len());
            bytes.splice(place..end, text.iter().copied());
        }
    }
    bytes
}

/// Deep lists, and counts that no file can hold.
fn made(whole: &[u8], name: &str) -> Vec<Vec<u8>> {
    let mut all = vec![vec![], vec![0; 64], b"PK\x03\x04".to_vec(), vec![0xff; 4096]];
    if name.ends_with(".json") {
        all.push(vec![b'['; 1 << 20]);
        all.push([b"{\"frames\":".repeat(100_000), b"}".repeat(100_000)].concat());
        all.push([&b"{\"frames\": [{\"transform_matrix\": "[..], &b"[".repeat(50_000)].concat());
        all.push(b"{\"frames\": [{}]}".to_vec());
        all.push(b"{\"frames\": []}".to_vec());
    }
    if name.ends_with(".png") {
        // a header of 32,768 x 32,768 pixels with its checksum
        let mut huge = whole.to_vec();
        huge[16..24].copy_from_slice(&[0, 0, 0x80, 0, 0, 0, 0x80, 0]);
        let sum = crc(&huge[12..29]);
        huge[29..33].copy_from_slice(&sum.to_be_bytes());
        all.push(huge);
    }
    if name.ends_with(".exr") {
        // a window of 30,001 x 30,001 pixels
        let at = whole.windows(10).position(|w| w == b"dataWindow").unwrap() + 11 + 6 + 4;
        let mut huge = whole.to_vec();
        huge[at + 8..at + 16].copy_from_slice(&[30_000i32.to_le_bytes(), 30_000i32.to_le_bytes()].concat());
        all.push(huge);
    }
    if name.ends_with(".bin") {
        all.push([&u64::MAX.to_le_bytes()[..], &whole[8..]].concat());
        all.push([&(1u64 << 40).to_le_bytes()[..], &whole[8..]].concat());
    }
    all
}

/// The checksum of a chunk of PNG.
fn crc(bytes: &[u8]) -> u32 {
    let step = |c: u32, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 };
    !bytes.iter().fold(!0, |c, b| (0..8).fold(c ^ u32::from(*b), step))
}

/// A clip with a depth map in a file of OpenEXR; its folder.
fn exr_source(dir: &Path) -> String {
    let here = dir.join("exr");
    copy(&fixture("import/instant4d"), &here);
    copy(&fixture("import/clip"), &dir.join("clip"));
    let list = std::fs::read_to_string(here.join("transforms.json")).unwrap();
    std::fs::write(here.join("transforms.json"), list.replace("depth_2.npy", "depth_2.exr")).unwrap();
    let zip = std::fs::File::open(fixture("import/vipe/depth/dog.zip")).unwrap();
    let mut zip = zip::ZipArchive::new(zip).unwrap();
    let mut member = zip.by_name("00002.exr").unwrap();
    let mut bytes = Vec::new();
    member.read_to_end(&mut bytes).unwrap();
    std::fs::write(here.join("depth_2.exr"), bytes).unwrap();
    here.to_string_lossy().into_owned()
}

#[test]
fn damage_is_an_error_or_a_sound_clip() {
    let pictures = Some(fixture("import/clip/images"));
    let with = |given: bool| ImportOptions {
        pictures: pictures.clone().filter(|_| given),
        ..ImportOptions::default()
    };
    use SourceFormat::{Colmap, Da3, Kitti, Megasam, Monst3r, Nerfstudio, Tum, Vggt, Vipe};
    // the source, the file that is damaged, how many of its copies must be refused at least
    let cases: [(&str, SourceFormat, bool, &str, usize); 27] = [
        ("import/colmap_text", Colmap, true, "sparse/0/cameras.txt", 40),
        ("import/colmap_text", Colmap, true, "sparse/0/images.txt", 40),
        ("import/colmap_binary", Colmap, true, "sparse/0/cameras.bin", 40),
        ("import/colmap_binary", Colmap, true, "sparse/0/images.bin", 40),
        ("import/colmap_opencv", Colmap, false, "sparse/0/cameras.txt", 40),
        ("import/nerfstudio", Nerfstudio, false, "transforms.json", 40),
        ("import/nerfstudio", Nerfstudio, false, "depth/2.png", 40),
        ("import/nerfstudio", Nerfstudio, false, "masks/2.png", 40),
        ("import/vipe", Vipe, false, "pose/dog.npz", 40),
        ("import/vipe", Vipe, false, "intrinsics/dog.npz", 40),
        ("import/vipe", Vipe, false, "intrinsics/dog_camera.txt", 20),
        ("import/vipe", Vipe, false, "depth/dog.zip", 40),
        ("import/vipe", Vipe, false, "mask/dog.zip", 40),
        ("import/vipe", Vipe, false, "mask/dog.txt", 20),
        ("import/vipe", Vipe, false, "rgb/dog.mp4", 20),
        ("import/da3", Da3, false, "exports/npz/results.npz", 40),
        ("import/da3_streaming", Da3, false, "camera_poses.txt", 40),
        ("import/da3_streaming", Da3, false, "results_output/frame_2.npz", 40),
        ("import/vggt/predictions.npz", Vggt, false, "", 40),
        ("import/monst3r", Monst3r, false, "pred_traj.txt", 40),
        ("import/monst3r", Monst3r, false, "pred_intrinsics.txt", 40),
        ("import/monst3r", Monst3r, false, "frame_0001.npy", 20),
        ("import/tum", Tum, false, "groundtruth.txt", 20),
        ("import/tum", Tum, false, "rgb.txt", 10),
        ("import/kitti", Kitti, false, "poses.txt", 40),
        ("import/kitti", Kitti, false, "calib.txt", 5),
        ("megasam/outputs/dog_droid.npz", Megasam, false, "", 40),
    ];
    let dir = tempfile::tempdir().unwrap();
    let exr = exr_source(dir.path());
    let cases = cases
        .into_iter()
        .chain([(exr.as_str(), Nerfstudio, false, "depth_2.exr", 20)]);
    std::panic::set_hook(Box::new(|_| {}));
    let mut failures = Vec::new();
    for (n, (source, format, given, file, least)) in cases.enumerate() {
        let here = dir.path().join(format!("{n}"));
        let here = if file.is_empty() {
            here.with_extension("npz")
        } else {
            here
        };
        copy(&fixture(source), &here);
        let victim = if file.is_empty() { here.clone() } else { here.join(file) };
        let options = with(given);
        MEMORY.reset_peak_usage();
        let before = MEMORY.current_usage();
        m4_import::read(&here, format, &options, &Silent).unwrap();
        let sound = MEMORY.peak_usage() - before;
        let whole = std::fs::read(&victim).unwrap();
        let copies = (0..COPIES).map(|k| damaged(&whole, k));
        let mut refused = 0;
        for (k, bytes) in copies.chain(made(&whole, file)).enumerate() {
            std::fs::write(&victim, &bytes).unwrap();
            MEMORY.reset_peak_usage();
            let before = MEMORY.current_usage();
            let read = catch_unwind(AssertUnwindSafe(|| {
                let _ = m4_import::detect(&here);
                m4_import::read(&here, format, &options, &Silent)
            }));
            let taken = MEMORY.peak_usage().saturating_sub(before);
            match read {
                Err(_) => failures.push(format!("{source} {file}, copy {k}: panic")),
                Ok(Err(e)) => {
                    refused += 1;
                    assert!(
                        e.to_string().contains(&*dir.path().to_string_lossy()),
                        "{source} {file}: {e}"
                    );
                }
                Ok(Ok(imported)) => {
                    for frame in &imported.train.frames {
                        let k = frame.camera.intrinsics;
                        assert!(k.fx > 0.0 && k.fy > 0.0 && frame.camera.c2w.matrix().iter().all(|v| v.is_finite()));
                        assert_eq!(frame.rgb.size(), (k.width, k.height));
                    }
                }
            }
            if taken > sound + FREE + TIMES * bytes.len() {
                failures.push(format!("{source} {file}, copy {k}: {} MiB of memory", taken >> 20));
            }
        }
        if refused < least {
            failures.push(format!("{source} {file}: only {refused} were refused"));
        }
        std::fs::write(&victim, whole).unwrap();
    }
    let _ = std::panic::take_hook();
    assert!(failures.is_empty(), "{failures:#?}");
}
