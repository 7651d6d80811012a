//! What the clips of the fixtures are, by the files of the oracles alone, and how results are
//! compared with them.

use crate::dataset::fixture;
use m4_core::nalgebra::Matrix4;
use m4_core::{Capture, CaptureFrame, RgbImage, Se3, Silent};
use m4_io::ReadError;
use m4_io::dataset::{ImportOptions, Imported, SourceFormat, detect, read};
use m4_io::npy::{Array, Npz};
use m4_io::reach::Reach;
use serde::Deserialize;
use std::path::Path;

pub const FRAMES: usize = 5;
pub const SIZE: (usize, usize) = (48, 36);

#[derive(Deserialize)]
struct Clip {
    intrinsics: [f64; 4],
    c2w: Vec<[[f64; 4]; 4]>,
}

/// The clip.
pub struct Truth {
    pub intrinsics: [f64; 4],
    pub c2w: Vec<Se3<f64>>,
    /// `[frame][y * width + x]`.
    pub depth: Vec<Vec<f64>>,
    pub moving: Vec<Vec<bool>>,
    pub images: Vec<RgbImage>,
}

/// Options with the images of the clip.
pub fn with_images() -> ImportOptions {
    ImportOptions {
        images: Some(fixture("import/clip/images")),
        ..ImportOptions::default()
    }
}

/// Options for lists whose images are those of the clip beside them.
pub fn beside() -> ImportOptions {
    ImportOptions {
        reach: Reach::Anywhere,
        ..ImportOptions::default()
    }
}

pub fn read_fixture(
    name: &str,
    format: SourceFormat,
    options: &ImportOptions,
) -> Result<Imported, ReadError> {
    read(&fixture(name), format, options, &Silent)
}

fn npy(name: &str) -> Vec<Vec<f64>> {
    let file = std::fs::File::open(fixture(name)).unwrap();
    let bytes = file.metadata().unwrap().len();
    let mut array = Array::open("truth", file, bytes, 1 << 20).unwrap();
    assert_eq!(array.shape, [FRAMES, SIZE.1, SIZE.0]);
    let frame = |_| array.next_f64(SIZE.0 * SIZE.1).unwrap();
    (0..FRAMES).map(frame).collect()
}

impl Truth {
    pub fn read() -> Self {
        let clip: Clip =
            serde_json::from_slice(&std::fs::read(fixture("import/clip/clip.json")).unwrap())
                .unwrap();
        let matrix = |m: &[[f64; 4]; 4]| Se3::from_matrix(&Matrix4::from_fn(|i, j| m[i][j]));
        let image = |i| {
            m4_io::image::read_rgb(&fixture(&format!("import/clip/images/{i:05}.png"))).unwrap()
        };
        Self {
            intrinsics: clip.intrinsics,
            c2w: clip.c2w.iter().map(matrix).collect(),
            depth: npy("import/clip/depth.npy"),
            moving: npy("import/clip/moving.npy")
                .iter()
                .map(|m| m.iter().map(|v| *v != 0.0).collect())
                .collect(),
            images: (0..FRAMES).map(image).collect(),
        }
    }

    /// Compares all but depth and masks; images may be off by `colours` (largest, mean).
    pub fn same_cameras(&self, capture: &Capture, colours: (u8, f64)) {
        assert_eq!(capture.frames.len(), FRAMES);
        for (i, frame) in capture.frames.iter().enumerate() {
            self.same_camera(i, frame);
            self.same_image(i, &frame.rgb, colours);
        }
    }

    pub fn same_camera(&self, i: usize, frame: &CaptureFrame) {
        let k = frame.camera.intrinsics;
        assert_eq!((k.width, k.height), SIZE);
        let off = [k.fx, k.fy, k.cx, k.cy]
            .into_iter()
            .zip(self.intrinsics)
            .map(|(a, b)| (a - b).abs());
        assert!(off.fold(0.0, f64::max) < 1e-6, "frame {i}: {k:?}");
        self.same_pose(i, frame);
    }

    pub fn same_pose(&self, i: usize, frame: &CaptureFrame) {
        let off = (frame.camera.c2w.matrix() - self.c2w[i].matrix()).amax();
        assert!(off < 1e-6, "frame {i}: {off:e}");
    }

    pub fn same_image(&self, i: usize, image: &RgbImage, (largest, mean): (u8, f64)) {
        assert_eq!(image.size(), SIZE);
        let pairs = image
            .data()
            .iter()
            .flatten()
            .zip(self.images[i].data().iter().flatten());
        let off: Vec<u8> = pairs.map(|(a, b)| a.abs_diff(*b)).collect();
        let worst = off.iter().copied().max().unwrap();
        let average = off.iter().map(|v| f64::from(*v)).sum::<f64>() / off.len() as f64;
        assert!(
            worst <= largest && average <= mean,
            "frame {i}: {worst}, {average}"
        );
    }

    /// Depth within `within` of itself or `least`; unknown where the clip has none.
    pub fn same_depth(&self, capture: &Capture, within: f64, least: f64) {
        for (i, frame) in capture.frames.iter().enumerate() {
            let depth = frame.depth.as_ref().unwrap();
            assert_eq!(depth.size(), SIZE, "frame {i}");
            for (z, want) in depth.every(1).zip(&self.depth[i]) {
                let z = f64::from(z);
                assert_eq!(z == 0.0, *want == 0.0);
                assert!(
                    (z - want).abs() <= (within * want).max(least),
                    "frame {i}: {z} and {want}"
                );
            }
        }
    }

    pub fn same_masks(&self, capture: &Capture) {
        for (i, frame) in capture.frames.iter().enumerate() {
            let mask = frame.mask.as_ref().unwrap();
            assert_eq!(mask.size(), SIZE);
            let all = (0..SIZE.0 * SIZE.1).map(|p| mask.at(p % SIZE.0, p / SIZE.0));
            assert!(all.eq(self.moving[i].iter().copied()), "frame {i}");
            assert_eq!(mask.count(), 80);
        }
    }
}

/// Colour of the ray `(x, y, 1)` in frame `i`, as the oracle has it.
pub fn colour(i: usize, x: f64, y: f64) -> [f64; 3] {
    let i = i as f64;
    [
        127.0 + 100.0 * (3.0 * x + 0.3 * i).sin(),
        127.0 + 100.0 * (4.0 * y - 0.2 * i).cos(),
        127.0 + 90.0 * (2.0 * x + 3.0 * y + 0.5 * i).sin(),
    ]
}

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
pub fn import(
    path: &Path,
    format: SourceFormat,
    options: &ImportOptions,
) -> Result<Imported, ReadError> {
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
        let off: Vec<f64> = frame
            .rgb
            .data()
            .iter()
            .flatten()
            .zip(want)
            .map(|(&got, want)| (f64::from(got) - want).abs())
            .collect();
        let worst = off.iter().copied().fold(0.0, f64::max);
        let average = off.iter().sum::<f64>() / off.len() as f64;
        assert!(
            worst <= most && average <= mean,
            "{}: {worst} {average}",
            frame.name
        );
    }
}

/// Depth of frame `i` is `want`, `[height][width]`, to `within`; 0 where `has_depth` says no.
pub fn assert_depth(
    capture: &Capture,
    i: usize,
    want: &[f64],
    within: f64,
    has_depth: impl Fn(usize, usize) -> bool,
) {
    let depth = capture.frames[i].depth.as_ref().unwrap();
    let (w, h) = depth.size();
    assert_eq!(w * h, want.len());
    for y in 0..h {
        for x in 0..w {
            let (got, want) = (f64::from(depth.at(x, y)), want[y * w + x]);
            if has_depth(x, y) {
                assert!(
                    (got - want).abs() <= within && got > 1.0,
                    "{i}: {x} {y}: {got} {want}"
                );
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
