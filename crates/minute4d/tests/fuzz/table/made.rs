//! Valid files written by our own writers.

use m4_core::{
    Camera, Capture, CaptureFrame, CompactDepth, CompactIds, CompactMask, Intrinsics, Plane, Scene, Se3, Silent,
    SplatLayout, Tracks,
};
use m4_io::capture::{self, Split};
use m4_testkit::{SceneSpec, random_scene};
use std::path::Path;
use std::{fmt, fs};

/// What `write` writes into a temporary folder under that name.
pub fn written<T, E: fmt::Display>(name: &str, write: impl FnOnce(&Path) -> Result<T, E>) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap_or_else(|e| panic!("no temporary folder: {e}"));
    let path = folder.path().join(name);
    if let Err(e) = write(&path) {
        panic!("cannot write the valid {name}: {e}");
    }
    fs::read(&path).unwrap_or_else(|e| panic!("cannot read the valid {name}: {e}"))
}

/// Few splats, of harmonics of that degree.
pub fn scene(sh_degree: usize) -> Scene {
    random_scene(&SceneSpec {
        layout: SplatLayout { isotropic: false, sh_degree, time_degree: 0 },
        n_static: 3,
        n_dynamic: 4,
        time_frames: 5,
        ..SceneSpec::default()
    })
}

/// Two posed frames of 12 x 8 pixels with all that a capture can have.
pub fn clip() -> Capture {
    let frame = |i: usize| CaptureFrame {
        name: format!("{i}.png"),
        camera: Camera { intrinsics: Intrinsics::centred(12, 8, 14.0), c2w: Se3::identity() },
        t: i as f64,
        rgb: Plane::from_fn(12, 8, |x, y| [x as u8 * 9, y as u8 * 7, i as u8]),
        depth: Some(CompactDepth::from(Plane::from_fn(12, 8, |x, y| 1.0 + (x + y) as f32 * 0.1))),
        mask: Some(CompactMask::from_fn(12, 8, |x, y| x > y)),
        motion: Some(Plane::from_fn(12, 8, |x, _| x as u8 * 20)),
        instances: Some(CompactIds::from(&Plane::from_fn(12, 8, |x, _| u16::from(x > 5)))),
        camera_index: None,
    };
    let xyz = (0..6).map(|i| [i as f32 * 0.2, 0.1, 2.0]).collect();
    let tracks = Tracks::new(2, 3, xyz, vec![true; 6]).and_then(|t| t.with_colours(vec![[9, 8, 7]; 3]));
    Capture {
        frames: (0..2).map(frame).collect(),
        time_frames: 2,
        duration_s: Some(0.5),
        metric: true,
        tracks: Some(tracks.unwrap_or_else(|e| panic!("tracks: {e}"))),
    }
}

/// The tracks of [`clip`].
pub fn tracks() -> Tracks {
    clip().tracks.unwrap_or_else(|| panic!("the clip has tracks"))
}

/// Writes [`clip`] as a capture: the training split, and the same as held-out views.
pub fn capture_into(folder: &Path) {
    let test = Capture { tracks: None, ..clip() };
    for (capture, split) in [(clip(), Split::Train), (test, Split::Test)] {
        capture::write(folder, &capture, split, &Silent).unwrap_or_else(|e| panic!("a capture: {e}"));
    }
}

/// A small image as a PNG file (of `name.png`) or a JPEG file.
pub fn image(name: &str) -> Vec<u8> {
    let image = Plane::from_fn(24, 18, |x, y| [x as u8 * 9, y as u8 * 11, (x * y) as u8]);
    written(name, |path| m4_io::image::write_rgb(path, &image))
}
