//! Clips of a static camera.

use m4_core::{Camera, Capture, CaptureFrame, Intrinsics, Plane, RgbImage, Se3};

/// A clip of `n` frames of a static camera: frame `i` shows `rgb(i)` at time `i`.
pub fn clip(n: usize, rgb: impl Fn(usize) -> RgbImage) -> Capture {
    let frame = |i: usize| {
        let rgb = rgb(i);
        let intrinsics = Intrinsics::centred(rgb.width(), rgb.height(), 0.5 * rgb.width() as f64);
        CaptureFrame {
            name: format!("{i:05}"),
            camera: Camera {
                intrinsics,
                c2w: Se3::identity(),
            },
            t: i as f64,
            rgb,
            depth: None,
            mask: None,
            motion: None,
            instances: None,
            camera_index: None,
            distance_sigma: None,
        }
    };
    Capture {
        frames: (0..n).map(frame).collect(),
        time_frames: n,
        duration_s: None,
        metric: false,
        tracks: None,
    }
}

/// The same with frames in which every value is `i`.
pub fn plain_clip(n: usize, (width, height): (usize, usize)) -> Capture {
    clip(n, |i| Plane::filled(width, height, [i as u8; 3]))
}
