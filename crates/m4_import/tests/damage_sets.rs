//! Clips of data sets, telephones and trackers that were damaged or made to do harm: an error or a sound capture, and little memory.
//!
//! The allocator counts for the whole process, so everything happens in one test.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use m4_import::formats::davis;
use m4_import::{ImportOptions, SourceFormat, read};
use m4_io::video::VideoOptions;
use m4_math::CounterRng;
use m4_scene::{Capture, Silent};
use peak_alloc::PeakAlloc;
use std::fs::File;
use std::io::{Cursor, Read as _, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// Damaged clips a parser.
const CLIPS: u64 = 120;
/// Memory that reading may take, bytes: this, and so many times the clip.
const FREE: usize = 16 << 20;
const TIMES: usize = 64;

/// The captures of a clip.
type Read = fn(&Path) -> Result<Vec<Capture>, String>;

/// One parser: where its clip lies, which of its files are damaged, and how it is read.
struct Case {
    name: &'static str,
    /// Below `fixtures/import`.
    clip: &'static str,
    /// Parts of names of files; all files where it is empty.
    files: &'static [&'static str],
    read: Read,
}

fn of(path: &Path, format: SourceFormat, options: &ImportOptions) -> Result<Vec<Capture>, String> {
    let clip = read(path, format, options, &Silent).map_err(|e| e.to_string())?;
    Ok(std::iter::once(clip.train).chain(clip.test).collect())
}

fn plain(path: &Path, format: SourceFormat) -> Result<Vec<Capture>, String> {
    of(path, format, &ImportOptions::default())
}

/// A sound clip with side files out of `path`.
fn beside(path: &Path, change: fn(&mut ImportOptions, &Path)) -> Result<Vec<Capture>, String> {
    let mut options = ImportOptions {
        depth_unit: Some(0.0005),
        ..ImportOptions::default()
    };
    change(&mut options, path);
    of(&fixtures().join("record3d/clip.r3d"), SourceFormat::Record3d, &options)
}

fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/import")
}

fn cases() -> Vec<Case> {
    let case = |name, clip, files, read| Case {
        name,
        clip,
        files,
        read,
    };
    vec![
        case("dycheck", "dycheck", &[], |p| plain(p, SourceFormat::Dycheck)),
        case("dycheck lists", "dycheck", &[".json"], |p| {
            plain(p, SourceFormat::Dycheck)
        }),
        case("dycheck depth", "dycheck", &[".npy"], |p| {
            plain(p, SourceFormat::Dycheck)
        }),
        case("nvidia", "nvidia", &[], |p| plain(p, SourceFormat::Nvidia)),
        case("poses_bounds", "nvidia", &["poses_bounds"], |p| {
            plain(p, SourceFormat::Nvidia)
        }),
        case("davis", "davis", &[], |p| {
            let folder = p.join("JPEGImages/480p/ball");
            let clip = davis::read_clip(&folder, &VideoOptions::default(), &Silent);
            clip.map(|_| Vec::new()).map_err(|e| e.to_string())
        }),
        case("record3d", "record3d", &["clip"], |p| {
            plain(&p.join("clip.r3d"), SourceFormat::Record3d)
        }),
        case("record3d unpacked", "record3d unpacked", &["metadata", "jpg"], |p| {
            plain(p, SourceFormat::Record3d)
        }),
        case("record3d depth", "record3d unpacked", &[".depth", ".conf"], |p| {
            plain(p, SourceFormat::Record3d)
        }),
        case("record3d large depth", "record3d large", &[".depth"], |p| {
            plain(p, SourceFormat::Record3d)
        }),
        case("polycam", "polycam", &["corrected", "depth", "confidence"], |p| {
            plain(p, SourceFormat::Polycam)
        }),
        case("polycam cameras", "polycam", &["corrected_cameras"], |p| {
            plain(p, SourceFormat::Polycam)
        }),
        case("stray", "stray", &[], |p| plain(p, SourceFormat::StrayScanner)),
        case("stray lists", "stray", &[".csv"], |p| {
            plain(p, SourceFormat::StrayScanner)
        }),
        case("exr", "side", &["depth_exr"], |p| {
            beside(p, |o, p| o.depth = Some(p.join("depth_exr")))
        }),
        case("pfm", "side", &["depth_pfm"], |p| {
            beside(p, |o, p| o.depth = Some(p.join("depth_pfm")))
        }),
        case("depth png", "side", &["depth_png"], |p| {
            beside(p, |o, p| o.depth = Some(p.join("depth_png")))
        }),
        case("npy", "side", &["depth_npy"], |p| {
            beside(p, |o, p| o.depth = Some(p.join("depth_npy")))
        }),
        case("depth npz", "side", &["depth.npz"], |p| {
            beside(p, |o, p| o.depth = Some(p.join("depth.npz")))
        }),
        case("masks", "side", &["masks_palette", "masks_png"], |p| {
            beside(p, |o, p| o.masks = Some(p.join("masks_palette")))?;
            beside(p, |o, p| o.masks = Some(p.join("masks_png")))
        }),
        case("masks npz", "side", &["masks.npz"], |p| {
            beside(p, |o, p| o.masks = Some(p.join("masks.npz")))
        }),
        case("tracks in space", "side", &["tapip3d.npz", "world.npz"], |p| {
            beside(p, |o, p| o.tracks = Some(p.join("tapip3d.npz")))?;
            beside(p, |o, p| o.tracks = Some(p.join("world.npz")))
        }),
        case("tracks in pixels", "side", &["cotracker.npz", "spatracker.npz"], |p| {
            beside(p, |o, p| o.tracks = Some(p.join("cotracker.npz")))?;
            beside(p, |o, p| o.tracks = Some(p.join("spatracker.npz")))
        }),
    ]
}

/// All files below a folder, in order of names.
fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            files.extend(files_below(&path));
        } else {
            files.push(path);
        }
    }
    files
}

/// One way of doing harm to a file.
fn damage(bytes: &mut Vec<u8>, rng: &mut CounterRng) -> &'static str {
    let n = bytes.len();
    // half of the harm goes to the start, where the counts are
    let place = |rng: &mut CounterRng| {
        let within = if rng.below(2) == 0 { n.min(512) } else { n };
        rng.below(within)
    };
    match rng.below(9) {
        0 => {
            for _ in 0..=rng.below(4) {
                let at = place(rng);
                bytes[at] ^= 1 << rng.below(8);
            }
            "flipped bits"
        }
        1 => {
            let at = place(rng);
            bytes[at] = rng.next_u64() as u8;
            "another byte"
        }
        2 => {
            bytes.truncate(rng.below(n));
            "a cut"
        }
        3 => {
            // a count that is far too large, of either byte order
            let (at, width) = (place(rng), [2, 4, 8][rng.below(3)]);
            let value = [u64::MAX, 1 << 31, 0x7fff_ffff, 1 << 20, 60_000, 1 << 40][rng.below(6)];
            let value = if rng.below(2) == 0 {
                value.to_le_bytes()
            } else {
                value.rotate_right(8 * width as u32).to_be_bytes()
            };
            let width = width.min(n - at);
            bytes[at..at + width].copy_from_slice(&value[..width]);
            "an inflated count"
        }
        4 => {
            let digits: Vec<usize> = (0..n.min(4096)).filter(|&i| bytes[i].is_ascii_digit()).collect();
            if !digits.is_empty() {
                let at = digits[rng.below(digits.len())];
                let more = [
                    &b"9999999999"[..],
                    b"99",
                    b"e300",
                    b"-",
                    b"0.5",
                    b"99999999999999999999",
                ][rng.below(6)];
                bytes.splice(at..at, more.iter().copied());
            }
            "more digits"
        }
        5 => {
            let (from, len, to) = (place(rng), rng.below(64), place(rng));
            let piece = bytes[from..(from + len).min(n)].to_vec();
            bytes.splice(to..to, piece);
            "a piece twice"
        }
        6 => {
            let (from, len) = (place(rng), 1 + rng.below(64));
            bytes.drain(from..(from + len).min(n));
            "a piece missing"
        }
        7 => {
            let at = place(rng);
            let deep = [&b"["[..], b"{\"a\":"][rng.below(2)];
            bytes.splice(at..at, deep.iter().copied().cycle().take(deep.len() * 50_000));
            "depth without end"
        }
        _ => {
            let at = place(rng);
            let end = (at + rng.below(16)).min(n);
            for byte in &mut bytes[at..end] {
                *byte = rng.next_u64() as u8;
            }
            "noise"
        }
    }
}

/// Harm to an array of an archive, which is then sound itself.
fn damage_within(bytes: &mut Vec<u8>, rng: &mut CounterRng) -> String {
    let mut archive = ZipArchive::new(Cursor::new(bytes.as_slice())).unwrap();
    let mut arrays: Vec<(String, Vec<u8>)> = Vec::new();
    for i in 0..archive.len() {
        let mut member = archive.by_index(i).unwrap();
        let name = member.name().unwrap().into_owned();
        // of arrays that are not read damage is not seen
        if !["query_points.npy", "intrinsics.npy", "video.npy"].contains(&name.as_str()) {
            let mut array = Vec::new();
            member.read_to_end(&mut array).unwrap();
            arrays.push((name, array));
        }
    }
    let which = rng.below(arrays.len());
    let what = format!("{} within {}", damage(&mut arrays[which].1, rng), arrays[which].0);
    let mut to = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default()
        .compression_method([CompressionMethod::Stored, CompressionMethod::Deflated][rng.below(2)]);
    for (name, array) in arrays {
        to.start_file(name, options).unwrap();
        to.write_all(&array).unwrap();
    }
    *bytes = to.finish().unwrap().into_inner();
    what
}

/// Reads within the memory allowed.
fn read_bounded(case: &Case, path: &Path, bytes: usize, what: &str, most: &mut usize) -> Result<Vec<Capture>, String> {
    let before = MEMORY.current_usage();
    MEMORY.reset_peak_usage();
    let outcome = catch_unwind(AssertUnwindSafe(|| (case.read)(path)));
    let used = MEMORY.peak_usage().saturating_sub(before);
    *most = used.max(*most);
    assert!(
        used <= FREE + TIMES * bytes,
        "{} with {what}: {used} bytes of memory for a clip of {bytes}",
        case.name
    );
    outcome.unwrap_or_else(|_| panic!("{} with {what}: a panic", case.name))
}

fn assert_sound(captures: &[Capture], what: &str) {
    for capture in captures {
        let last = capture.time_frames as f64 - 1.0;
        assert!(
            !capture.frames.is_empty() && capture.duration_s.is_none_or(f64::is_finite),
            "{what}"
        );
        for frame in &capture.frames {
            let k = &frame.camera.intrinsics;
            assert_eq!(frame.rgb.size(), (k.width, k.height), "{what}");
            assert!(
                k.fx > 0.0 && k.fy > 0.0 && k.cx.is_finite() && k.cy.is_finite(),
                "{what}"
            );
            let c2w = frame.camera.c2w.matrix();
            assert!(
                c2w.iter().all(|v| v.is_finite()) && (c2w.determinant() - 1.0).abs() < 1e-2,
                "{what}"
            );
            assert!((0.0..=last).contains(&frame.t), "{what}");
            if let Some(depth) = &frame.depth {
                assert!(depth.every(1).all(|z| z.is_finite() && z >= 0.0), "{what}");
            }
        }
        if let Some(tracks) = &capture.tracks {
            assert_eq!(tracks.frames(), capture.frames.len(), "{what}");
            assert!(tracks.xyz().as_flattened().iter().all(|v| !v.is_infinite()), "{what}");
        }
    }
}

#[test]
fn damage_is_an_error_or_a_sound_capture() {
    let dir = tempfile::tempdir().unwrap();
    for case in cases() {
        let root = dir.path().join(case.name);
        let archive = match case.clip {
            "record3d unpacked" => Some("clip.r3d"),
            "record3d large" => Some("large.r3d"),
            _ => None,
        };
        let from = match archive {
            None => fixtures().join(case.clip),
            Some(name) => {
                let folder = dir.path().join("from").join(case.name);
                let archive = File::open(fixtures().join("record3d").join(name)).unwrap();
                ZipArchive::new(archive).unwrap().extract(&folder).unwrap();
                folder
            }
        };
        let mut total = 0;
        for file in files_below(&from) {
            let to = root.join(file.strip_prefix(&from).unwrap());
            std::fs::create_dir_all(to.parent().unwrap()).unwrap();
            total += std::fs::copy(&file, to).unwrap() as usize;
        }
        let mut files = files_below(&root);
        files.retain(|f| {
            let name = f.strip_prefix(&root).unwrap().to_string_lossy().into_owned();
            name != "truth.npz" && (case.files.is_empty() || case.files.iter().any(|part| name.contains(part)))
        });
        let mut most = 0;
        let sound = read_bounded(&case, &root, total, "no damage", &mut most).unwrap();
        assert_sound(&sound, case.name);
        let (mut refused, mut taken) = (0, 0);
        for i in 0..CLIPS {
            let mut rng = CounterRng::new(11, 0x5e_75, i);
            let file = &files[rng.below(files.len())];
            let whole = std::fs::read(file).unwrap();
            let mut bytes = whole.clone();
            let within = file.extension().is_some_and(|e| e == "npz") && rng.below(3) > 0;
            let mut what = if within {
                damage_within(&mut bytes, &mut rng)
            } else {
                damage(&mut bytes, &mut rng).to_owned()
            };
            if !within && rng.below(4) == 0 && !bytes.is_empty() {
                what = format!("{what} and {}", damage(&mut bytes, &mut rng));
            }
            let what = format!("{what} in {}, clip {i}", file.strip_prefix(&root).unwrap().display());
            std::fs::write(file, &bytes).unwrap();
            match read_bounded(&case, &root, total + bytes.len(), &what, &mut most) {
                Err(reason) => {
                    let said = reason.len() < 2000 && reason.contains('/');
                    assert!(said, "{} with {what}: {reason}", case.name);
                    refused += 1;
                }
                Ok(captures) => {
                    assert_sound(&captures, &format!("{} with {what}", case.name));
                    taken += 1;
                }
            }
            std::fs::write(file, &whole).unwrap();
        }
        println!(
            "{}: {refused} refused, {taken} read, {} KiB at most",
            case.name,
            most >> 10
        );
        assert!(
            refused > CLIPS / 8,
            "{}: only {refused} of {CLIPS} refused: does the damage reach the reader?",
            case.name
        );
    }
}
