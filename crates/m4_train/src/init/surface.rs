//! Merges what several frames say of one surface: estimated depth of each frame puts it at a place
//! of its own, and voxels would keep every layer, so that a limited number of splats covers less.

use crate::init::{
    cloud::{Cloud, Pixels},
    config::{InitError, stopped},
};
use m4_core::{Camera, Capture, Progress, nalgebra::Vector3};
use rayon::prelude::*;

/// Depths that differ by less than this share are of one surface.
const SAME: f32 = 0.03;
/// No point.
const NONE: u32 = u32::MAX;

/// Points of surfaces, each the mean of what the frames that see it say. A frame counts by how
/// many of its pixels an area of the surface has, one over the square of its depth: a nearer
/// frame shows place and colour in more detail.
#[derive(Debug, Default)]
pub(crate) struct Surface {
    /// Mean position and colour.
    pub cloud: Cloud,
    /// Sum of the weights of the points that each is the mean of.
    pub weight: Vec<f64>,
}

/// What is added up of a point.
struct Sum {
    xyz: Vector3<f64>,
    rgb: Vector3<f64>,
    weight: f64,
}

impl Sum {
    fn mean(&self) -> Vector3<f64> {
        self.xyz / self.weight
    }
}

/// Merges the points of `pixels`, frame by frame from the middle outwards: a point at the depth of
/// one that is known at its pixel or beside is averaged into that one; the others become points.
/// Fails with [`InitError::Stopped`].
pub(crate) fn surface(
    capture: &Capture,
    pixels: &[Pixels],
    progress: &dyn Progress,
) -> Result<Surface, InitError> {
    let mut sums: Vec<Sum> = Vec::new();
    for at in outwards(pixels.len()) {
        stopped(progress)?;
        add(
            &FrameCamera::of(capture, &pixels[at]),
            &pixels[at].cloud(capture),
            &pixels[at],
            &mut sums,
        );
    }
    let mut out = Surface::default();
    for sum in &sums {
        out.cloud.xyz.push(sum.mean().map(|v| v as f32).into());
        out.cloud
            .rgb
            .push((sum.rgb / sum.weight).map(|v| v.round() as u8).into());
        out.weight.push(sum.weight);
    }
    Ok(out)
}

/// The indices below `n`, the middle first, then one on each side in turn.
fn outwards(n: usize) -> impl Iterator<Item = usize> {
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by_key(|&i| i.abs_diff(n / 2));
    order.into_iter()
}

fn add(view: &FrameCamera, cloud: &Cloud, pixels: &Pixels, sums: &mut Vec<Sum>) {
    let index = view.index(sums);
    let at: Vec<(usize, usize)> = pixels.mask.set_pixels().collect();
    let depth = |p: &[f32; 3]| view.camera.project(&Vector3::from(p.map(f64::from))).1 as f32;
    let neighbours: Vec<(u32, f32)> = at
        .par_iter()
        .zip(&cloud.xyz)
        .map(|(&at, p)| {
            let z = depth(p);
            (index.near(at, z), z)
        })
        .collect();
    for (((neighbour, z), p), rgb) in neighbours.into_iter().zip(&cloud.xyz).zip(&cloud.rgb) {
        let weight = f64::from(z).powi(-2);
        let (xyz, rgb) = (
            Vector3::from(p.map(f64::from)) * weight,
            Vector3::from(rgb.map(f64::from)) * weight,
        );
        match sums.get_mut(neighbour as usize) {
            None => sums.push(Sum { xyz, rgb, weight }),
            Some(sum) => {
                sum.xyz += xyz;
                sum.rgb += rgb;
                sum.weight += weight;
            }
        }
    }
}

/// A frame that points are taken from.
struct FrameCamera {
    camera: Camera,
    size: (usize, usize),
}

impl FrameCamera {
    fn of(capture: &Capture, pixels: &Pixels) -> Self {
        let size = pixels.mask.size();
        Self {
            camera: capture.frames[pixels.frame].camera.resized(size.0, size.1),
            size,
        }
    }

    /// The pixel that a place is seen in, and its z-depth; `None` outside of the image.
    fn pixel(&self, place: &Vector3<f64>) -> Option<(usize, f32)> {
        let ((w, h), ([u, v], z)) = (self.size, self.camera.project(place));
        let inside = z > 0.0 && u > -0.5 && v > -0.5 && u < w as f64 - 0.5 && v < h as f64 - 0.5;
        inside.then(|| ((v + 0.5) as usize * w + (u + 0.5) as usize, z as f32))
    }

    /// The points inside the image, by pixel; those that others hide, too.
    fn index(&self, sums: &[Sum]) -> PixelIndex {
        let at: Vec<Option<(usize, f32)>> =
            sums.par_iter().map(|sum| self.pixel(&sum.mean())).collect();
        let mut start = vec![0u32; self.size.0 * self.size.1 + 1];
        at.iter()
            .flatten()
            .for_each(|(pixel, _)| start[pixel + 1] += 1);
        (1..start.len()).for_each(|p| start[p] += start[p - 1]);
        let mut points = vec![(NONE, 0.0); *start.last().unwrap_or(&0) as usize];
        let mut next = start.clone();
        for (k, (pixel, z)) in (0..).zip(at).filter_map(|(k, at)| Some((k, at?))) {
            points[next[pixel] as usize] = (k, z);
            next[pixel] += 1;
        }
        PixelIndex {
            size: self.size,
            start,
            points,
        }
    }
}

/// The points of each pixel.
struct PixelIndex {
    size: (usize, usize),
    /// Where the points of a pixel start, row by row.
    start: Vec<u32>,
    /// Points and their z-depths.
    points: Vec<(u32, f32)>,
}

impl PixelIndex {
    /// The point in a pixel or beside it whose depth is nearest to `z`, if it is of the same
    /// surface.
    fn near(&self, (x, y): (usize, usize), z: f32) -> u32 {
        let (w, h) = self.size;
        let (mut best, mut least) = (NONE, SAME * z);
        for row in y.saturating_sub(1)..(y + 2).min(h) {
            let (first, end) = (row * w + x.saturating_sub(1), row * w + (x + 2).min(w));
            for &(point, depth) in
                &self.points[self.start[first] as usize..self.start[end] as usize]
            {
                let difference = (depth - z).abs();
                if difference < least {
                    (best, least) = (point, difference);
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::surface;
    use crate::init::cloud::Pixels;
    use m4_core::{
        Camera, Capture, CaptureFrame, CompactMask, Intrinsics, Plane, Se3, Silent,
        nalgebra::Vector3,
    };

    const SIZE: (usize, usize) = (64, 48);
    const WALL: f32 = 4.0;

    /// A wall from a camera that goes past, whose depth `wrong(frame, x)` changes.
    fn points(wrong: impl Fn(usize, usize) -> f32) -> super::Surface {
        points_from(|i| Vector3::new(0.02 * i as f64, 0.0, 0.0), wrong)
    }

    /// The same from cameras at places of their own.
    fn points_from(
        place: impl Fn(usize) -> Vector3<f64>,
        wrong: impl Fn(usize, usize) -> f32,
    ) -> super::Surface {
        let (w, h) = SIZE;
        let frame = |i: usize| CaptureFrame {
            name: format!("{i:03}"),
            camera: Camera {
                intrinsics: Intrinsics::centred(w, h, 60.0),
                c2w: Se3 {
                    translation: place(i),
                    ..Se3::identity()
                },
            },
            t: i as f64,
            rgb: Plane::filled(w, h, [100 + 10 * i as u8; 3]),
            depth: Some(
                Plane::from_fn(w, h, |x, _| (WALL - place(i).z as f32) * wrong(i, x)).into(),
            ),
            mask: None,
            motion: None,
            instances: None,
            camera_index: None,
            distance_sigma: None,
        };
        let frames: Vec<CaptureFrame> = (0..7).map(frame).collect();
        let capture = Capture {
            frames,
            time_frames: 7,
            duration_s: None,
            metric: true,
            tracks: None,
        };
        let all = |frame| Pixels {
            frame,
            mask: CompactMask::from_fn(w, h, |_, _| true),
        };
        surface(&capture, &(0..7).map(all).collect::<Vec<_>>(), &Silent).unwrap()
    }

    #[test]
    fn frames_that_differ_a_little_make_one_surface_in_the_middle_of_theirs() {
        let surface = points(|i, _| [0.99, 1.01, 0.995, 1.0, 1.005, 0.99, 1.01][i]);
        let one_frame = SIZE.0 * SIZE.1;
        assert!(
            (one_frame * 9 / 10..one_frame * 5 / 4).contains(&surface.cloud.xyz.len()),
            "{}",
            surface.cloud.xyz.len()
        );
        let many = surface
            .weight
            .iter()
            .zip(&surface.cloud.xyz)
            .filter(|(w, _)| **w * f64::from(WALL).powi(2) >= 5.9);
        let errors: Vec<f32> = many.map(|(_, p)| (p[2] - WALL).abs() / WALL).collect();
        let mean = errors.iter().sum::<f32>() / errors.len() as f32;
        // each frame alone is 0.0064 off on average
        assert!(
            errors.len() > one_frame / 2 && mean < 0.003,
            "{mean} of {}",
            errors.len()
        );
        assert!(
            surface.cloud.rgb.iter().any(|c| c[0] == 130),
            "the mean colour of all frames"
        );
    }

    #[test]
    fn a_frame_counts_by_the_square_of_its_nearness() {
        // 6 frames at the distance WALL, and the last (colour 160) at half of it
        let surface = points_from(
            |i| Vector3::new(0.0, 0.0, if i == 6 { 0.5 * f64::from(WALL) } else { 0.0 }),
            |_, _| 1.0,
        );
        let pixels = (SIZE.0 * SIZE.1) as f64;
        let weight: f64 = surface.weight.iter().sum();
        let all = pixels * 10.0 / f64::from(WALL).powi(2);
        assert!((weight / all - 1.0).abs() < 1e-6, "{weight} for {all}");
        let colours = surface.weight.iter().zip(&surface.cloud.rgb);
        let mean = colours.map(|(w, c)| w * f64::from(c[0])).sum::<f64>() / weight;
        let want = f64::from(100 + 110 + 120 + 130 + 140 + 150) / 10.0 + 0.4 * 160.0;
        assert!((mean - want).abs() < 0.5, "{mean} for {want}");
    }

    #[test]
    fn surfaces_apart_stay_apart() {
        let surface = points(|_, x| if (20..30).contains(&x) { 0.8 } else { 1.0 });
        let at = |z: f32| {
            surface
                .cloud
                .xyz
                .iter()
                .filter(|p| (p[2] - z).abs() < 1e-3 * WALL)
                .count()
        };
        let (near, far) = (at(0.8 * WALL), at(WALL));
        assert!(near >= 10 * SIZE.1 && far >= 50 * SIZE.1, "{near}, {far}");
        assert_eq!(near + far, surface.cloud.xyz.len());
    }
}
