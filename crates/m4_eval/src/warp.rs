//! Views of a capture by reprojected depth, without training: what its geometry is worth.
//!
//! ```text
//! static pixels of at most 16 frames  --+
//! dynamic pixels of the nearest frame --+--> 2x2 pixels in the view, nearest in front --> holes filled from their rim
//! ```
//!
//! Scores follow those of trained scenes to about 1 dB and take seconds (docs/evaluation.md).

use m4_core::nalgebra::Vector3;
use m4_core::{Camera, Capture, CaptureFrame, RgbImage, covering};

/// Most frames that static pixels are taken from.
const STATIC_FRAMES: usize = 16;
/// Points nearer than this share of the median depth of the static points are left out.
const NEAR_SHARE: f32 = 0.01;

/// A point of the world and its colour.
type Point = (Vector3<f32>, [u8; 3]);

/// A capture as coloured points.
pub struct Warp<'a> {
    capture: &'a Capture,
    fixed: Vec<Point>,
    near: f32,
}

impl<'a> Warp<'a> {
    /// Unprojects the static pixels of training frames; frames without depth add none.
    #[must_use]
    pub fn new(capture: &'a Capture) -> Self {
        let frames: Vec<&CaptureFrame> = training(capture).collect();
        let fixed: Vec<Point> = frames
            .iter()
            .step_by(frames.len().div_ceil(STATIC_FRAMES).max(1))
            .flat_map(|f| points(f, false))
            .collect();
        let mut depths: Vec<f32> = frames
            .iter()
            .take(1)
            .filter_map(|f| f.depth.as_ref())
            .flat_map(|d| d.every(7))
            .filter(|z| *z > 0.0)
            .collect();
        let near = NEAR_SHARE * m4_core::median(&mut depths).unwrap_or(0.0);
        Self {
            capture,
            fixed,
            near,
        }
    }

    /// The image of a camera in the world of the capture, at `share` (0 to 1) of the clip.
    #[must_use]
    pub fn view(&self, camera: &Camera, share: f64) -> RgbImage {
        let dynamic = nearest(self.capture, share)
            .map(|f| points(f, true))
            .unwrap_or_default();
        draw(camera, self.fixed.iter().chain(&dynamic), self.near)
    }

    /// As [`Warp::view`], without dynamic content.
    #[must_use]
    pub fn background(&self, camera: &Camera) -> RgbImage {
        draw(camera, self.fixed.iter(), self.near)
    }
}

fn training(capture: &Capture) -> impl Iterator<Item = &CaptureFrame> {
    capture.frames.iter().filter(|f| f.camera_index.is_none())
}

/// The training frame nearest to `share` (0 to 1) of the clip.
#[must_use]
pub fn nearest(capture: &Capture, share: f64) -> Option<&CaptureFrame> {
    let t = share * (capture.time_frames.max(2) - 1) as f64;
    training(capture).min_by(|a, b| (a.t - t).abs().total_cmp(&(b.t - t).abs()))
}

/// The pixels of a frame inside its mask or outside it, in the world.
fn points(frame: &CaptureFrame, dynamic: bool) -> Vec<Point> {
    let Some(depth) = &frame.depth else {
        return Vec::new();
    };
    let (w, h) = depth.size();
    let camera = frame.camera.resized(w, h);
    let pixel = |i: usize| {
        let (x, y) = (i % w, i / w);
        let inside = frame
            .mask
            .as_ref()
            .is_some_and(|m| m.covers((x, y), (w, h)));
        let z = depth.at(x, y);
        (inside == dynamic && z.is_finite() && z > 0.0).then(|| {
            (
                camera.unproject(x as f64, y as f64, f64::from(z)).cast(),
                frame.rgb[covering((x, y), (w, h), frame.rgb.size())],
            )
        })
    };
    (0..w * h).filter_map(pixel).collect()
}

fn draw<'a>(camera: &Camera, points: impl Iterator<Item = &'a Point>, near: f32) -> RgbImage {
    let k = &camera.intrinsics;
    let (w, h) = (k.width, k.height);
    let (fx, fy, cx, cy) = (
        k.fx as f32,
        k.fy as f32,
        k.cx as f32 - 0.5,
        k.cy as f32 - 0.5,
    );
    let w2c = camera.w2c();
    let (rotation, translation) = (w2c.rotation.cast::<f32>(), w2c.translation.cast::<f32>());
    let mut image = RgbImage::filled(w, h, [0; 3]);
    let mut depth = vec![f32::INFINITY; w * h];
    for (at, colour) in points {
        let p = rotation * at + translation;
        if p.z.is_nan() || p.z <= near {
            continue;
        }
        let (x, y) = ((fx * p.x / p.z + cx).floor(), (fy * p.y / p.z + cy).floor());
        if !(x >= -1.0 && y >= -1.0 && x < w as f32 && y < h as f32) {
            continue;
        }
        for (x, y) in [(x, y), (x + 1.0, y), (x, y + 1.0), (x + 1.0, y + 1.0)] {
            if x >= 0.0 && y >= 0.0 && x < w as f32 && y < h as f32 {
                let i = y as usize * w + x as usize;
                if p.z < depth[i] {
                    (depth[i], image.data_mut()[i]) = (p.z, *colour);
                }
            }
        }
    }
    fill(&mut image, depth.iter().map(|z| z.is_finite()).collect());
    image
}

/// Gives each pixel that nothing was drawn to the colour of a nearest one, by rounds over the eight
/// neighbours.
fn fill(image: &mut RgbImage, mut drawn: Vec<bool>) {
    let (w, h) = image.size();
    let mut rim: Vec<usize> = (0..w * h).filter(|&i| drawn[i]).collect();
    while !rim.is_empty() {
        let mut next = Vec::new();
        for i in rim {
            let (x, y, colour) = (i % w, i / w, image.data()[i]);
            for v in y.saturating_sub(1)..(y + 2).min(h) {
                for u in x.saturating_sub(1)..(x + 2).min(w) {
                    let j = v * w + u;
                    if !drawn[j] {
                        (drawn[j], image.data_mut()[j]) = (true, colour);
                        next.push(j);
                    }
                }
            }
        }
        rim = next;
    }
}

#[cfg(test)]
mod tests {
    use super::Warp;
    use m4_core::{Camera, Capture, CaptureFrame, CompactMask, Intrinsics, Plane, Se3};

    const W: usize = 48;

    /// A wall at a depth of 4 with columns of one colour each, and at `t` a square at a depth of 2
    /// in the middle.
    fn frame(t: usize) -> CaptureFrame {
        let inside = |x: usize, y: usize| x.abs_diff(24) < 5 && y.abs_diff(16) < 5;
        CaptureFrame {
            name: format!("{t}"),
            camera: Camera {
                intrinsics: Intrinsics::centred(W, 32, 48.0),
                c2w: Se3::identity(),
            },
            t: t as f64,
            rgb: Plane::from_fn(W, 32, |x, y| {
                if inside(x, y) {
                    [0, 0, 250 - 50 * t as u8]
                } else {
                    [5 * x as u8, 0, 0]
                }
            }),
            depth: Some(Plane::from_fn(W, 32, |x, y| if inside(x, y) { 2.0 } else { 4.0 }).into()),
            mask: Some(CompactMask::from_fn(W, 32, inside)),
            motion: None,
            instances: None,
            camera_index: None,
            distance_sigma: None,
        }
    }

    #[test]
    fn parallax_is_that_of_the_depth_and_dynamic_pixels_are_of_the_moment() {
        let capture = Capture {
            frames: (0..3).map(frame).collect(),
            time_frames: 3,
            duration_s: None,
            metric: true,
            tracks: None,
        };
        let warp = Warp::new(&capture);
        let mut camera = capture.frames[0].camera;
        // 48 px * 0.25 / 4 = 3 px for the wall, 6 px for the square
        camera.c2w.translation.x = 0.25;
        let view = warp.view(&camera, 1.0);
        // a point covers the pixels on both sides of it
        assert!(
            [30, 35].contains(&view[(4, 3)][0]) && view[(18, 16)] == [0, 0, 150],
            "{:?}",
            view.row(16)
        );
        assert_eq!(warp.view(&camera, 0.0)[(18, 16)], [0, 0, 250]);
        // the rim that no frame saw has the colour beside it
        assert_eq!(view[(47, 3)], view[(45, 3)]);
    }
}
