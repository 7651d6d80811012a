//! What a frame says of a carried point: it shows it, hides it, or contradicts it.

use crate::init::motion::Observed;
use m4_core::{RgbImage, nalgebra::Vector3};

/// A point is shown where the image has its colour within this many widths (measured, as the next
/// two: docs/decisions/0022), or in the nearest pixel.
const NEAR_WIDTHS: f32 = 0.003;
/// The centre of the nearest pixel is within this many pixels.
const NEAREST_PX: f32 = 0.71;
/// Largest mean difference of the colours of one point, 0..1.
const SAME_COLOUR: f32 = 0.04;
/// Depths of one surface differ by less than this share, or by this many times the noise of depth.
const DEPTH_STEP: (f32, f32) = (0.015, 3.0);

/// What a frame says of a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Evidence {
    /// The place is there, in this colour, 0..1.
    Shown([f32; 3]),
    /// Something is before it, its depth is unknown, or it is outside the image.
    Hidden,
    /// Something else is there.
    Contradicted,
}

/// A frame that is asked about places.
pub(super) struct Shown<'a> {
    pub observed: &'a Observed,
    rgb: &'a RgbImage,
    /// Depths that differ by more than this share are not of one surface.
    pub depth_step: f32,
}

impl<'a> Shown<'a> {
    /// `depth_noise` is the standard deviation of depth, as a share of it.
    pub fn new(observed: &'a Observed, rgb: &'a RgbImage, depth_noise: f32) -> Self {
        Self {
            observed,
            rgb,
            depth_step: DEPTH_STEP.0.max(DEPTH_STEP.1 * depth_noise),
        }
    }

    /// Pixels, columns and rows.
    pub fn size(&self) -> (usize, usize) {
        self.rgb.size()
    }

    /// What the frame says of a place of colour `rgb` (0..1).
    pub fn evidence(&self, p: &Vector3<f32>, rgb: [f32; 3]) -> Evidence {
        let Some(projected) = self.observed.project(p) else {
            return Evidence::Hidden;
        };
        let z = projected.point[2];
        let Some(depth) = self.observed.depth(projected.at) else {
            return Evidence::Hidden;
        };
        let (width, height) = self.size();
        let radius = (NEAR_WIDTHS * width as f32).max(NEAREST_PX);
        let mut nearest: Option<(f32, [f32; 3])> = None;
        for (x, y) in around(projected.at, radius, (width, height)) {
            let Some(d) = self.observed.dynamic_depth((x, y)) else {
                continue;
            };
            if (d - z).abs() > self.depth_step * z {
                continue;
            }
            let colour = self.rgb[(x, y)].map(|c| f32::from(c) / 255.0);
            let difference = (0..3).map(|k| (colour[k] - rgb[k]).abs()).sum::<f32>() / 3.0;
            if nearest.is_none_or(|(least, _)| difference < least) {
                nearest = Some((difference, colour));
            }
        }
        match nearest {
            Some((difference, colour)) if difference <= SAME_COLOUR => Evidence::Shown(colour),
            _ if depth < z * (1.0 - self.depth_step) => Evidence::Hidden,
            _ => Evidence::Contradicted,
        }
    }
}

/// Pixels of an image of `size` whose centres are within `radius` of a place.
pub(super) fn around(
    [u, v]: [f32; 2],
    radius: f32,
    (width, height): (usize, usize),
) -> impl Iterator<Item = (usize, usize)> {
    let range = |at: f32, n: usize| {
        let first = (at - radius).ceil().max(0.0) as usize;
        first..((at + radius).floor() + 1.0).clamp(0.0, n as f32) as usize
    };
    let columns = range(u, width);
    range(v, height).flat_map(move |y| {
        columns
            .clone()
            .filter(move |&x| (x as f32 - u).hypot(y as f32 - v) <= radius)
            .map(move |x| (x, y))
    })
}

#[cfg(test)]
mod tests {
    use super::{Evidence, Shown, around};
    use crate::init::motion::Observed;
    use m4_core::{Camera, CaptureFrame, CompactMask, Intrinsics, Plane, Se3, nalgebra::Vector3};

    const SIZE: (usize, usize) = (100, 60);

    /// A red dynamic square at depth 2 before a grey static wall at depth 4; nothing is known of
    /// the right edge.
    fn frame() -> CaptureFrame {
        let square = |x: usize, y: usize| (40..60).contains(&x) && (20..40).contains(&y);
        CaptureFrame {
            name: String::new(),
            camera: Camera {
                intrinsics: Intrinsics::centred(SIZE.0, SIZE.1, 100.0),
                c2w: Se3::identity(),
            },
            t: 0.0,
            rgb: Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
                if square(x, y) {
                    [200, 20, 20]
                } else {
                    [128; 3]
                }
            }),
            depth: Some(
                Plane::from_fn(SIZE.0, SIZE.1, |x, y| match x {
                    95.. => 0.0,
                    _ if square(x, y) => 2.0,
                    _ => 4.0,
                })
                .into(),
            ),
            mask: Some(CompactMask::from_fn(SIZE.0, SIZE.1, square)),
            motion: None,
            instances: None,
            camera_index: None,
            distance_sigma: None,
        }
    }

    #[test]
    fn a_frame_shows_hides_and_contradicts() {
        let frame = frame();
        let observed = Observed::new(&frame).unwrap();
        let shown = Shown::new(&observed, &frame.rgb, 0.004);
        let at = |x: f64, y: f64, z: f64| {
            let p = frame.camera.unproject(x, y, z);
            Vector3::new(p.x as f32, p.y as f32, p.z as f32)
        };
        let red = [0.78, 0.08, 0.08];
        let told = |x, y, z, rgb| shown.evidence(&at(x, y, z), rgb);
        assert!(matches!(told(50.0, 30.0, 2.0, red), Evidence::Shown(rgb) if rgb[0] > 0.7));
        assert_eq!(
            told(50.0, 30.0, 2.0, [0.1, 0.8, 0.1]),
            Evidence::Contradicted,
            "another colour"
        );
        assert_eq!(
            told(50.0, 30.0, 3.0, red),
            Evidence::Hidden,
            "behind the square"
        );
        assert_eq!(
            told(50.0, 30.0, 1.5, red),
            Evidence::Contradicted,
            "before the square"
        );
        assert_eq!(
            told(20.0, 30.0, 2.0, red),
            Evidence::Contradicted,
            "before the wall"
        );
        assert_eq!(
            told(20.0, 30.0, 4.0, [0.5; 3]),
            Evidence::Contradicted,
            "on the wall, which is static"
        );
        assert_eq!(
            told(97.0, 30.0, 2.0, red),
            Evidence::Hidden,
            "depth is unknown"
        );
        assert_eq!(
            told(150.0, 30.0, 2.0, red),
            Evidence::Hidden,
            "outside the image"
        );
        assert_eq!(
            shown.evidence(&Vector3::new(0.0, 0.0, -1.0), red),
            Evidence::Hidden,
            "behind the camera"
        );
    }

    #[test]
    fn noisy_depth_widens_what_agrees() {
        let frame = frame();
        let observed = Observed::new(&frame).unwrap();
        let p = frame.camera.unproject(50.0, 30.0, 1.95);
        let p = Vector3::new(p.x as f32, p.y as f32, p.z as f32);
        let red = [0.78, 0.08, 0.08];
        assert_eq!(
            Shown::new(&observed, &frame.rgb, 0.004).evidence(&p, red),
            Evidence::Contradicted
        );
        assert!(matches!(
            Shown::new(&observed, &frame.rgb, 0.02).evidence(&p, red),
            Evidence::Shown(_)
        ));
    }

    #[test]
    fn pixels_around_a_place_are_inside_the_image() {
        let all = |at, radius| around(at, radius, (4, 3)).collect::<Vec<_>>();
        assert_eq!(all([1.0, 1.0], 0.5), [(1, 1)]);
        assert_eq!(all([0.0, 0.0], 1.0), [(0, 0), (1, 0), (0, 1)]);
        assert_eq!(all([-3.0, 0.0], 1.0), []);
        assert_eq!(all([9.0, 9.0], 1.0), []);
        assert_eq!(all([f32::NAN, 1.0], 1.0), []);
    }
}
