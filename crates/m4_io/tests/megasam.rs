//! Files of MegaSaM: those of numpy are read, those written are read by numpy and by ourselves, damage is refused.

use m4_io::ErrorKind;
use m4_io::capture::{self, CaptureOptions, Split};
use m4_io::megasam::{Layout, MegasamFault, MegasamOptions, ReadMegasamError, detect, read, write};
use m4_math::nalgebra::{Vector3, Vector6};
use m4_math::{Se3, exp_so3};
use m4_scene::{Camera, Capture, CaptureFrame, CompactMask, DepthMap, Intrinsics, Plane, Progress, Silent};
use m4_testkit::{Need, skip};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;

fn fixture(name: &str) -> PathBuf {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/megasam")).join(name)
}

/// Keeps warnings.
#[derive(Default)]
struct Heard(Mutex<Vec<String>>);

impl Progress for Heard {
    fn update(&self, _: &str, _: usize, _: usize, _: &str) {}
    fn warn(&self, message: &str) {
        self.0.lock().unwrap().push(message.into());
    }
    fn cancelled(&self) -> bool {
        false
    }
}

impl Heard {
    fn text(self) -> String {
        self.0.into_inner().unwrap().join("\n")
    }
}

fn read_ok(path: &Path) -> Capture {
    read(path, &MegasamOptions::default(), &Silent).unwrap()
}

fn max_difference(a: &Se3<f64>, b: &Se3<f64>) -> f64 {
    (a.matrix() - b.matrix()).amax()
}

/// What `oracles/megasam_files.py` says of the three fixtures.
fn check_fixture(capture: &Capture, depth_within: f32, farthest: f32) {
    assert_eq!(
        (capture.frames.len(), capture.time_frames, capture.metric),
        (3, 3, false)
    );
    assert_eq!(capture.duration_s, Some(2.0 / 30.0));
    for (i, frame) in capture.frames.iter().enumerate() {
        let t = i as f64;
        assert_eq!((frame.t, frame.rgb.size()), (t, (24, 16)));
        let k = Intrinsics {
            width: 24,
            height: 16,
            fx: 20.0,
            fy: 21.0,
            cx: 12.0,
            cy: 8.5,
        };
        assert_eq!(frame.camera.intrinsics, k);
        let c2w = Se3 {
            rotation: exp_so3(&Vector3::new(0.0, 0.1 * t, 0.0)),
            translation: Vector3::new(0.2 * t, -0.05 * t, 0.1 * t),
        };
        assert!(max_difference(&frame.camera.c2w, &c2w) < 1e-6, "frame {i}");
        let map = frame.depth.as_ref().unwrap();
        let mask = frame.mask.as_ref().unwrap();
        for y in 0..16 {
            for x in 0..24 {
                assert_eq!(
                    frame.rgb[(x, y)],
                    [(9 * x) as u8, (13 * y) as u8, (x + y + 40 * i) as u8]
                );
                let expected = match (i, x, y) {
                    (_, 0..5, 0) => 0.0,
                    (1, 3, 3) => farthest,
                    _ => 0.4 + 0.01 * x as f32 + 0.02 * y as f32 + 0.05 * i as f32,
                };
                let z = map.at(x, y);
                assert!(
                    (z - expected).abs() <= depth_within * expected,
                    "frame {i} ({x}, {y}): {z}, {expected}"
                );
            }
        }
        // the middle of the block that moves, and of the one above it
        assert!(mask.at(8 * i + 4, 13) && !mask.at(8 * i + 4, 3));
        assert!((20..64).contains(&mask.count()), "{}", mask.count());
    }
}

#[test]
fn files_of_numpy_are_read() {
    // MegaSaM adds 1e-6 to depth before it takes the inverse, and does not take it off again
    check_fixture(&read_ok(&fixture("outputs/dog_droid.npz")), 4e-6, 250.0);
    check_fixture(&read_ok(&fixture("outputs_cvd/dog_sgd_cvd_hr.npz")), 5e-4, 100.0);
    check_fixture(&read_ok(&fixture("reconstructions/dog")), 2e-5, 250.0);
}

#[test]
fn options_say_what_the_files_do_not() {
    let path = fixture("outputs/dog_droid.npz");
    let heard = Heard::default();
    let options = MegasamOptions {
        fps: Some(10.0),
        tau_motion: 0.5,
        ..MegasamOptions::default()
    };
    let capture = read(&path, &options, &heard).unwrap();
    assert_eq!(capture.duration_s, Some(0.2));
    let wide: usize = capture.frames.iter().map(|f| f.mask.as_ref().unwrap().count()).sum();
    let narrow = read_ok(&path)
        .frames
        .iter()
        .map(|f| f.mask.as_ref().unwrap().count())
        .sum();
    assert!(wide > narrow);
    assert_eq!(heard.text(), "", "nothing was assumed");

    let heard = Heard::default();
    read(&path, &MegasamOptions::default(), &heard).unwrap();
    assert!(heard.text().contains("30 were assumed"));

    for (options, says) in [
        (
            MegasamOptions {
                fps: Some(0.0),
                ..options.clone()
            },
            "fps = 0",
        ),
        (
            MegasamOptions {
                fps: Some(f64::NAN),
                ..options.clone()
            },
            "fps = NaN",
        ),
        (
            MegasamOptions {
                tau_motion: 1.5,
                ..options.clone()
            },
            "tau_motion = 1.5",
        ),
        (
            MegasamOptions {
                max_memory_bytes: 4000,
                ..options.clone()
            },
            "max_memory_bytes",
        ),
        (
            MegasamOptions {
                motion: Some("/nowhere/motion_prob.npy".into()),
                ..options
            },
            "/nowhere/motion_prob.npy",
        ),
    ] {
        let error = read(&path, &options, &Silent).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
}

/// Writes a map of motion for the fixture's clip.
fn motion(path: &Path, frames: usize, value: f32) {
    let text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({frames}, 2, 3), }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes.extend(value.to_le_bytes().repeat(frames * 6));
    fs::write(path, bytes).unwrap();
}

#[test]
fn the_motion_map_is_found_and_looked_at() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("dog_droid.npz");
    fs::copy(fixture("outputs/dog_droid.npz"), &path).unwrap();
    let heard = Heard::default();
    let alone = read(&path, &MegasamOptions::default(), &heard).unwrap();
    assert!(alone.frames.iter().all(|f| f.mask.is_none()));
    assert!(heard.text().contains("no map of motion was found"));

    let beside = dir.path().join("motion_prob.npy");
    motion(&beside, 3, 1.0);
    let still = read_ok(&path);
    assert!(
        still.frames.iter().all(|f| f.mask.as_ref().unwrap().count() == 0),
        "1 stands still"
    );

    // one by the name of the clip comes first; it says that everything moves, which is not believed
    let named = dir.path().join("reconstructions/dog");
    fs::create_dir_all(&named).unwrap();
    motion(&named.join("motion_prob.npy"), 3, 0.1);
    let heard = Heard::default();
    read(&path, &MegasamOptions::default(), &heard).unwrap();
    let text = heard.text();
    assert!(
        text.contains("100 % of the pixels count as moving") && text.contains("1 - motion_prob"),
        "{text}"
    );

    for (frames, value, says) in [
        (4, 1.0, "another clip"),
        (3, 7.0, "holds 7"),
        (3, f32::NAN, "holds NaN"),
    ] {
        motion(&named.join("motion_prob.npy"), frames, value);
        let error = read(&path, &MegasamOptions::default(), &Silent)
            .unwrap_err()
            .to_string();
        assert!(error.contains(says) && error.contains("motion_prob"), "{error}");
    }
}

/// A capture of four frames of 48 x 32 pixels with a square that moves.
fn made() -> Capture {
    let (w, h) = (48, 32);
    let frame = |i: usize| {
        let s = i as f64;
        let depth: DepthMap = Plane::from_fn(w, h, |x, y| match (x, y) {
            (0..3, 0) => 0.0,
            _ => 0.3 + 0.013 * x as f32 + 0.0071 * y as f32,
        });
        CaptureFrame {
            name: format!("{i}"),
            camera: Camera {
                intrinsics: Intrinsics {
                    cx: 23.25,
                    ..Intrinsics::centred(w, h, 40.5)
                },
                c2w: Se3::identity().retract(&Vector6::new(0.1 * s, -0.02, 0.3 * s, 0.2 * s, 0.7, -0.4 * s)),
            },
            t: s,
            rgb: Plane::from_fn(w, h, |x, y| [(5 * x) as u8, (7 * y) as u8, (x * y + 60 * i) as u8]),
            depth: Some(depth.into()),
            mask: Some(CompactMask::from_fn(w, h, |x, y| {
                (8 + 4 * i..32 + 4 * i).contains(&x) && (8..24).contains(&y)
            })),
            motion: None,
            instances: None,
            camera_index: None,
        }
    };
    Capture {
        frames: (0..4).map(frame).collect(),
        time_frames: 4,
        duration_s: Some(0.1),
        metric: true,
        tracks: None,
    }
}

fn iou(a: &CompactMask, b: &CompactMask) -> f64 {
    let both = a.set_pixels().filter(|&(x, y)| b.at(x, y)).count();
    both as f64 / (a.count() + b.count() - both) as f64
}

/// Largest relative difference of known depth; unknown must be so on both sides.
fn depth_difference(a: &CaptureFrame, b: &CaptureFrame) -> f32 {
    let (a, b) = (a.depth.as_ref().unwrap(), b.depth.as_ref().unwrap());
    assert_eq!(a.size(), b.size());
    let pairs = a.every(1).zip(b.every(1));
    pairs.fold(0.0, |most, (a, b)| {
        assert_eq!(a == 0.0, b == 0.0);
        if a == 0.0 {
            most
        } else {
            f32::max(most, (a - b).abs() / a)
        }
    })
}

#[test]
fn what_is_written_comes_back() {
    let dir = tempfile::tempdir().unwrap();
    let capture = made();
    for (name, layout, depth_within) in [
        ("dog_droid.npz", Layout::Droid, 0.0),
        ("dog_sgd_cvd_hr.npz", Layout::Cvd, 5e-4),
        ("reconstructions/dog", Layout::Reconstruction, 2e-5),
    ] {
        let path = dir.path().join(name);
        let written = write(&path, &capture, layout, &Silent).unwrap();
        assert_eq!(detect(&path), Some(layout));
        assert!(
            written.bytes > 1000 && written.dropped.iter().any(|d| d.contains("metre")),
            "{written:?}"
        );
        let masks_dropped = written.dropped.iter().any(|d| d.contains("masks"));
        assert_eq!(masks_dropped, layout != Layout::Reconstruction);
        let back = read(
            &path,
            &MegasamOptions {
                tau_motion: 0.5,
                ..MegasamOptions::default()
            },
            &Silent,
        )
        .unwrap();
        assert_eq!(back.frames.len(), 4);
        for (a, b) in capture.frames.iter().zip(&back.frames) {
            assert_eq!(a.rgb, b.rgb);
            assert_eq!(a.camera.intrinsics, b.camera.intrinsics, "all of its numbers are f32");
            assert!(max_difference(&a.camera.c2w, &b.camera.c2w) < 1e-6);
            assert!(
                depth_difference(a, b) <= depth_within,
                "{name}: {}",
                depth_difference(a, b)
            );
            // the corners of the square are rounded by the resizing
            if layout == Layout::Reconstruction {
                let share = iou(a.mask.as_ref().unwrap(), b.mask.as_ref().unwrap());
                assert!(share > 0.85, "{share}");
            }
        }
        let again = fs::read(&path).ok();
        write(&path, &capture, layout, &Silent).unwrap();
        assert_eq!(fs::read(&path).ok(), again, "the same capture gives the same bytes");
    }
    // the archives have no masks, and the folder of that name beside them has
    let with_masks = read_ok(&dir.path().join("dog_droid.npz"));
    assert!(with_masks.frames.iter().all(|f| f.mask.is_some()));
    let left: Vec<_> = fs::read_dir(dir.path())
        .unwrap()
        .map(|f| f.unwrap().file_name())
        .collect();
    assert_eq!(left.len(), 3, "nothing else was left: {left:?}");
}

#[test]
fn what_is_read_goes_through_a_capture() {
    let dir = tempfile::tempdir().unwrap();
    let read_back = read_ok(&fixture("reconstructions/dog"));
    capture::write(dir.path(), &read_back, Split::Train, &Silent).unwrap();
    let again = capture::read(dir.path(), Split::Train, &CaptureOptions::default(), &Silent).unwrap();
    for (a, b) in read_back.frames.iter().zip(&again.frames) {
        assert_eq!((&a.rgb, &a.mask), (&b.rgb, &b.mask));
        assert!(max_difference(&a.camera.c2w, &b.camera.c2w) < 1e-12);
    }
    assert_eq!(again.duration_s, Some(2.0 / 30.0));
}

#[test]
fn captures_that_do_not_fit_are_refused_and_losses_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("x.npz");
    let refused = |capture: &Capture, layout, says: &str| {
        let error = write(&path, capture, layout, &Silent).unwrap_err();
        assert!(error.to_string().contains(says), "{error}");
        assert_eq!(error.kind(), ErrorKind::BadData);
        assert!(!path.exists() && fs::read_dir(dir.path()).unwrap().count() == 0);
    };
    let mut other = made();
    other.frames[2].camera.intrinsics.fx = 50.0;
    refused(&other, Layout::Droid, "frame 2 has another lens");
    let mut other = made();
    other.frames[1].rgb = Plane::filled(8, 8, [0; 3]);
    refused(&other, Layout::Cvd, "frame 1 is 8 x 8");
    let mut other = made();
    other.frames.iter_mut().for_each(|f| f.depth = None);
    refused(&other, Layout::Reconstruction, "no depth");
    let mut other = made();
    other.frames[3].camera.c2w.translation.x = f64::NAN;
    refused(&other, Layout::Droid, "camera of frame 3");
    other.frames.clear();
    refused(&other, Layout::Droid, "no frames");

    // sides that are no multiples of 8 are cut, and what is far or near is counted
    let mut odd = made();
    let (w, h) = (21, 19);
    for frame in &mut odd.frames {
        frame.rgb = Plane::from_fn(w, h, |x, y| [x as u8, y as u8, 0]);
        frame.camera.intrinsics = Intrinsics::centred(w, h, 30.0);
        let map = Plane::from_vec(2, 1, vec![0.004, 300.0]).unwrap();
        frame.depth = Some(map.into());
        frame.mask = None;
    }
    let folder = dir.path().join("r");
    fs::create_dir_all(&folder).unwrap();
    motion(&folder.join("motion_prob.npy"), 4, 0.0);
    let written = write(&folder, &odd, Layout::Reconstruction, &Silent).unwrap();
    assert!(
        written
            .dropped
            .iter()
            .any(|d| d.contains("5 columns") && d.contains("3 rows")),
        "{written:?}"
    );
    assert!(
        !folder.join("motion_prob.npy").exists(),
        "the map of another capture is not left"
    );
    let back = read_ok(&folder);
    assert_eq!(back.frames[0].rgb.size(), (16, 16));
    assert_eq!(back.frames[0].rgb[(15, 15)], [15, 15, 0]);
    assert_eq!(
        back.frames[0].camera.intrinsics.cx, 10.5,
        "a cut at the right moves nothing"
    );
    let map = back.frames[0].depth.as_ref().unwrap();
    assert_eq!(map.at(0, 0), 0.0);
    assert!((map.at(15, 3) - 300.0).abs() < 0.5, "{}", map.at(15, 3));
    let written = write(&path, &odd, Layout::Cvd, &Silent).unwrap();
    let dropped = written.dropped.join("; ");
    assert!(
        dropped.contains("4 depths below 0.01") && dropped.contains("4 depths above 100"),
        "{dropped}"
    );

    let blocked = dir.path().join("file");
    fs::write(&blocked, b"").unwrap();
    let error = write(&blocked.join("x.npz"), &made(), Layout::Droid, &Silent).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::CannotWrite);
}

/// Python with numpy; says so where there is none.
#[track_caller]
fn python() -> Option<String> {
    let name = std::env::var("PYTHON").unwrap_or_else(|_| "python3".into());
    let there = Command::new(&name).args(["-c", "import numpy"]).output();
    if there.is_ok_and(|o| o.status.success()) {
        return Some(name);
    }
    skip(Need::Numpy, &format!("{name} has no numpy"));
    None
}

#[test]
fn numpy_reads_what_is_written() {
    let Some(python) = python() else { return };
    let dir = tempfile::tempdir().unwrap();
    let capture = made();
    for (name, layout) in [
        ("a_droid.npz", Layout::Droid),
        ("a_cvd.npz", Layout::Cvd),
        ("a", Layout::Reconstruction),
    ] {
        write(&dir.path().join(name), &capture, layout, &Silent).unwrap();
    }
    let script = r#"
import sys, numpy as np
root = sys.argv[1]
d, c = np.load(root + "/a_droid.npz"), np.load(root + "/a_cvd.npz")
r = {k: np.load(f"{root}/a/{k}.npy") for k in ["images", "disps", "poses", "intrinsics", "motion_prob"]}
y, x = np.mgrid[:32, :48]
z = 0.3 + 0.013 * x + 0.0071 * y
z[0, :3] = 0
for i in range(4):
    rgb = np.stack([5 * x, 7 * y, x * y + 60 * i], -1).astype(np.uint8)
    assert (d["images"][i] == rgb).all() and (c["images"][i] == rgb).all()
    assert (r["images"][i][::-1].transpose(1, 2, 0) == rgb).all()
for a in (d, c):
    assert a["images"].dtype == np.uint8 and a["images"].shape == (4, 32, 48, 3)
    assert a["intrinsic"].dtype == np.float64 and a["cam_c2w"].dtype == np.float32
    assert (a["intrinsic"] == [[40.5, 0, 23.25], [0, 40.5, 16], [0, 0, 1]]).all()
    assert (a["cam_c2w"][:, 3] == [0, 0, 0, 1]).all() and a["cam_c2w"].shape == (4, 4, 4)
assert d["depths"].dtype == np.float32 and c["depths"].dtype == np.float16
assert np.abs(d["depths"] - z).max() < 2e-6
assert np.abs(c["depths"] - np.clip(z, 1e-3, 1e2)).max() < 5e-4 and c["depths"].min() == np.float16(1e-3)
assert np.abs(1 / r["disps"] - 1e-6 - z).max() < 1e-4 and r["disps"].shape == (4, 32, 48)
assert r["intrinsics"].shape == (4, 4) and (r["intrinsics"] == [40.5, 40.5, 23.25, 16]).all()
for c2w, p in zip(d["cam_c2w"], r["poses"]):
    qx, qy, qz, qw = p[3:]
    w2c = np.array([[1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw), p[0]],
                    [2 * (qx * qy + qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qx * qw), p[1]],
                    [2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx * qx + qy * qy), p[2]],
                    [0, 0, 0, 1]])
    assert np.abs(w2c @ c2w - np.eye(4)).max() < 1e-6
assert np.abs(d["cam_c2w"][3][:3, 3]).max() > 0.2
m = r["motion_prob"]
assert m.dtype == np.float32 and m.shape == (4, 4, 6)
assert (m[0] == [[1, 1, 1, 1, 1, 1], [1, 0, 0, 0, 1, 1], [1, 0, 0, 0, 1, 1], [1, 1, 1, 1, 1, 1]]).all()
assert (m[1][1] == [1, 0.5, 0, 0, 0.5, 1]).all()
"#;
    let ran = Command::new(python)
        .arg("-c")
        .arg(script)
        .arg(dir.path())
        .output()
        .unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
}

fn refused(path: &Path) -> ReadMegasamError {
    read(path, &MegasamOptions::default(), &Silent).unwrap_err()
}

#[test]
fn other_files_are_refused_with_a_reason() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("dog_droid.npz");
    fs::write(&path, b"no archive").unwrap();
    let error = refused(&path);
    assert!(matches!(error.fault, MegasamFault::Archive(_)) && error.kind() == ErrorKind::BadData);
    assert!(error.to_string().contains("dog_droid.npz"));
    fs::copy(fixture("../tracks/numpy.npz"), &path).unwrap();
    let text = refused(&path).to_string();
    assert!(text.contains("no array `images`") && text.contains("coords"), "{text}");
    assert_eq!(refused(Path::new("/nowhere/a_droid.npz")).kind(), ErrorKind::NotFound);

    let folder = dir.path().join("dog");
    fs::create_dir_all(&folder).unwrap();
    let again = || {
        for name in ["images", "disps", "poses", "intrinsics", "motion_prob"] {
            let file = format!("{name}.npy");
            fs::copy(fixture("reconstructions/dog").join(&file), folder.join(&file)).unwrap();
        }
    };
    for (name, other, says) in [
        ("images", "disps", "save it as uint8"),
        ("images", "poses", "save it as uint8"),
        ("disps", "images", "save it as float16"),
        ("disps", "poses", "shape [3, 7]"),
        ("poses", "intrinsics", "tx ty tz qx qy qz qw"),
        ("intrinsics", "poses", "fx fy cx cy"),
        ("motion_prob", "disps", "holds"),
        ("motion_prob", "poses", "another clip"),
    ] {
        again();
        fs::copy(folder.join(format!("{other}.npy")), folder.join(format!("{name}.npy"))).unwrap();
        let text = refused(&folder).to_string();
        assert!(text.contains(says) && text.contains(name), "{name} as {other}: {text}");
    }
    for name in ["images", "disps", "poses", "intrinsics"] {
        again();
        fs::remove_file(folder.join(format!("{name}.npy"))).unwrap();
        let text = refused(&folder).to_string();
        assert!(text.contains(&format!("no array `{name}`")), "{text}");
    }
}
