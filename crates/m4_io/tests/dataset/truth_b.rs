//! What every fixture means, and how results are compared with it.

use crate::dataset::support::fixture;
use m4_core::{Capture, CaptureFrame, Silent};
use m4_io::ReadError;
use m4_io::dataset::{ImportOptions, Imported, SourceFormat, detect, read};
use m4_io::npy::Npz;
use std::path::Path;

pub const W: usize = 48;
pub const H: usize = 36;

/// An array of the truth, `[count]` numbers.
pub fn array(file: &str, name: &str) -> Vec<f64> {
    let mut npz = Npz::open(&fixture(&format!("import/{file}"))).unwrap();
    let mut array = npz.array(name, 1 << 24).unwrap().unwrap();
    array.next_f64(array.shape.iter().product()).unwrap()
}

pub fn truth(name: &str) -> Vec<f64> {
    array("clip/truth.npz", name)
}

/// Detects and reads.
pub fn import(path: &Path, format: SourceFormat, options: &ImportOptions) -> Result<Imported, ReadError> {
    assert_eq!(detect(path), Some(format), "{}", path.display());
    read(path, format, options, &Silent)
}

/// Poses are those of the truth `key`.
pub fn assert_poses(capture: &Capture, key: &str) {
    let want = truth(key);
    assert_eq!(capture.frames.len() * 16, want.len());
    for (frame, want) in capture.frames.iter().zip(want.as_chunks::<16>().0) {
        let got = frame.camera.c2w.matrix();
        for (i, want) in want.iter().enumerate() {
            let off = (got[(i / 4, i % 4)] - want).abs();
            assert!(off < 1e-6, "{} {i}: {off}", frame.name);
        }
    }
}

/// The lens is `[fx, fy, cx, cy]` of images of `W` x `H`.
pub fn assert_lens(frame: &CaptureFrame, want: [f64; 4]) {
    let k = &frame.camera.intrinsics;
    assert_eq!((k.width, k.height), (W, H));
    for (got, want) in [k.fx, k.fy, k.cx, k.cy].into_iter().zip(want) {
        assert!((got - want).abs() < 1e-6, "{k:?}");
    }
}

/// The lens of the truth.
pub fn assert_true_lens(capture: &Capture) {
    let k = truth("k");
    for (frame, k) in capture.frames.iter().zip(k.as_chunks::<9>().0) {
        assert_lens(frame, [k[0], k[4], k[2], k[5]]);
    }
}

/// Images of `want`, `[frames][H][W][3]`, to `most` steps at worst and `mean` on average.
pub fn assert_images(capture: &Capture, want: &[f64], most: f64, mean: f64) {
    assert_eq!(capture.frames.len() * W * H * 3, want.len());
    for (frame, want) in capture.frames.iter().zip(want.chunks_exact(W * H * 3)) {
        let off: Vec<f64> =
            frame.rgb.data().iter().flatten().zip(want).map(|(&got, want)| (f64::from(got) - want).abs()).collect();
        let worst = off.iter().copied().fold(0.0, f64::max);
        let average = off.iter().sum::<f64>() / off.len() as f64;
        assert!(worst <= most && average <= mean, "{}: {worst} {average}", frame.name);
    }
}

/// Depth of frame `i` is `want`, `[height][width]`, to `within`; 0 where `known` says no.
pub fn assert_depth(capture: &Capture, i: usize, want: &[f64], within: f64, known: impl Fn(usize, usize) -> bool) {
    let depth = capture.frames[i].depth.as_ref().unwrap();
    let (w, h) = depth.size();
    assert_eq!(w * h, want.len());
    for y in 0..h {
        for x in 0..w {
            let (got, want) = (f64::from(depth.at(x, y)), want[y * w + x]);
            if known(x, y) {
                assert!((got - want).abs() <= within && got > 1.0, "{i}: {x} {y}: {got} {want}");
            } else {
                assert_eq!(got, 0.0, "{i}: {x} {y}");
            }
        }
    }
}

/// Depth of a sensor: `small` but where its confidence is 0.
pub fn assert_sensed(capture: &Capture, within: f64, also_unknown: impl Fn(usize, usize) -> bool) {
    let (small, confidence) = (truth("small"), truth("confidence"));
    let n = 24 * 18;
    for i in 0..capture.frames.len() {
        let confidence = &confidence[i * n..(i + 1) * n];
        assert!(confidence.contains(&0.0));
        assert_depth(capture, i, &small[i * n..(i + 1) * n], within, |x, y| {
            confidence[y * 24 + x] > 0.0 && !also_unknown(x, y)
        });
    }
}

/// Times of the frames.
pub fn times(capture: &Capture) -> Vec<f64> {
    capture.frames.iter().map(|f| f.t).collect()
}

pub fn assert_near(got: &[f64], want: &[f64], within: f64) {
    assert_eq!(got.len(), want.len(), "{got:?}");
    for (g, w) in got.iter().zip(want) {
        assert!((g - w).abs() <= within, "{got:?} {want:?}");
    }
}
