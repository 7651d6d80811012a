//! The background sphere: a shell of large, distant splats, so that a view from the side shows a
//! plausible colour instead of black. What it shows behind surfaces is a guess, which training must
//! not use to explain them (docs/decisions/0020).

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use m4_core::{Capture, nalgebra::Vector3};
use std::num::NonZero;

/// Pixels and rows between two samples.
const STEP: usize = 8;
/// Frames that are looked at.
const FRAMES: usize = 24;
/// Known cells that an unseen one takes its colour from.
const SOURCES: NonZero<usize> = NonZero::new(8).unwrap();

/// Splats on a sphere.
#[derive(Debug, Clone, Default)]
pub(crate) struct Shell {
    /// World units.
    pub xyz: Vec<[f32; 3]>,
    /// 0..1.
    pub rgb: Vec<[f32; 3]>,
    /// Standard deviation of each, world units.
    pub sd: f32,
    /// Number of splats at the end in whose direction every pixel seen has a surface, or none was
    /// seen: they only fill gaps.
    pub filling: usize,
}

/// `count` splats, evenly over a sphere of `radius` around the cameras.
///
/// A cell's colour is the mean of what was seen in its direction: of pixels without a surface
/// (depth 0) where there were any, else of all. Directions never seen take the distance-weighted
/// mean of the nearest that were. Cells with pixels without a surface come first.
pub(crate) fn shell(capture: &Capture, count: usize, radius: f32) -> Shell {
    if count == 0 || capture.frames.is_empty() {
        return Shell::default();
    }
    let directions = fibonacci(count);
    let Ok(tree) = ImmutableKdTree::<f32, 3>::new_from_slice(&directions) else {
        return Shell::default();
    };
    // sums of colours and counts: pixels without a surface, and all pixels
    let mut empty = vec![[0.0f64; 4]; count];
    let mut any = vec![[0.0f64; 4]; count];
    let frames = capture
        .frames
        .iter()
        .step_by(capture.frames.len().div_ceil(FRAMES));
    for frame in frames {
        let (w, h) = frame.rgb.size();
        for y in (STEP / 2..h).step_by(STEP) {
            for x in (STEP / 2..w).step_by(STEP) {
                let d = frame.camera.unproject(x as f64, y as f64, 1.0) - frame.camera.centre();
                let d = d.normalize();
                let cell = tree
                    .query(&[d.x as f32, d.y as f32, d.z as f32])
                    .nearest_one::<SquaredEuclidean<f32>>()
                    .execute()
                    .item as usize;
                let colour = frame.rgb[(x, y)];
                let nothing = frame
                    .depth
                    .as_ref()
                    .is_some_and(|depth| depth.covering((x, y), (w, h)) <= 0.0);
                let add = |sums: &mut [[f64; 4]]| {
                    (0..3).for_each(|k| sums[cell][k] += f64::from(colour[k]) / 255.0);
                    sums[cell][3] += 1.0;
                };
                add(&mut any);
                if nothing {
                    add(&mut empty);
                }
            }
        }
    }
    let mean = |s: &[f64; 4]| (s[3] > 0.0).then(|| [0, 1, 2].map(|k| (s[k] / s[3]) as f32));
    let colours: Vec<Option<[f32; 3]>> = empty
        .iter()
        .zip(&any)
        .map(|(e, a)| mean(e).or(mean(a)))
        .collect();
    let centre: Vector3<f64> = capture
        .frames
        .iter()
        .map(|f| f.camera.centre())
        .sum::<Vector3<f64>>()
        / capture.frames.len() as f64;
    let rgb = spread(&directions, &colours);
    let (sky, filling): (Vec<usize>, Vec<usize>) =
        (0..count).partition(|&cell| empty[cell][3] > 0.0);
    let cells = || sky.iter().chain(&filling);
    Shell {
        rgb: cells().map(|&cell| rgb[cell]).collect(),
        xyz: cells()
            .map(|&cell| [0, 1, 2].map(|k| centre[k] as f32 + radius * directions[cell][k]))
            .collect(),
        filling: filling.len(),
        sd: 0.75 * radius * (4.0 * std::f32::consts::PI / count as f32).sqrt(),
    }
}

/// Colours for the cells that have none.
fn spread(directions: &[[f32; 3]], colours: &[Option<[f32; 3]>]) -> Vec<[f32; 3]> {
    let indices: Vec<usize> = (0..colours.len())
        .filter(|&i| colours[i].is_some())
        .collect();
    let at: Vec<[f32; 3]> = indices.iter().map(|&i| directions[i]).collect();
    let tree = match ImmutableKdTree::<f32, 3>::new_from_slice(&at) {
        Ok(tree) if !at.is_empty() => tree,
        _ => return vec![[0.5; 3]; directions.len()],
    };
    let fill = |d: &[f32; 3]| {
        let (mut sum, mut total) = ([0.0f32; 3], 0.0f32);
        for n in tree
            .query(d)
            .nearest_n::<SquaredEuclidean<f32>>(SOURCES)
            .execute()
        {
            let weight = 1.0 / n.distance.max(1e-6);
            let rgb = colours[indices[n.item as usize]].unwrap_or_default();
            (0..3).for_each(|k| sum[k] += weight * rgb[k]);
            total += weight;
        }
        sum.map(|v| v / total.max(1e-6))
    };
    directions
        .iter()
        .zip(colours)
        .map(|(d, colour)| colour.unwrap_or_else(|| fill(d)))
        .collect()
}

/// Directions evenly over the sphere (golden-angle spiral).
fn fibonacci(count: usize) -> Vec<[f32; 3]> {
    let golden = std::f64::consts::PI * (3.0 - 5.0f64.sqrt());
    (0..count)
        .map(|i| {
            let y = 1.0 - 2.0 * (i as f64 + 0.5) / count as f64;
            let (ring, angle) = ((1.0 - y * y).sqrt(), golden * i as f64);
            [
                (ring * angle.cos()) as f32,
                y as f32,
                (ring * angle.sin()) as f32,
            ]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::{fibonacci, shell};
    use m4_core::{Camera, Capture, CaptureFrame, Intrinsics, Plane, Se3};

    #[test]
    fn the_spiral_is_even() {
        let points = fibonacci(400);
        let mean: [f32; 3] = [0, 1, 2].map(|k| points.iter().map(|p| p[k]).sum::<f32>() / 400.0);
        assert!(mean.iter().all(|m| m.abs() < 0.01), "{mean:?}");
        assert!(
            points
                .iter()
                .all(|p| (p.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5)
        );
    }

    #[test]
    fn unseen_directions_take_the_colour_of_their_neighbours() {
        // left half red wall, right half blue sky
        let frame = CaptureFrame {
            name: "0".to_owned(),
            camera: Camera {
                intrinsics: Intrinsics::centred(64, 64, 40.0),
                c2w: Se3::identity(),
            },
            t: 0.0,
            rgb: Plane::from_fn(
                64,
                64,
                |x, _| if x < 32 { [255, 0, 0] } else { [0, 0, 255] },
            ),
            depth: Some(Plane::from_fn(64, 64, |x, _| if x < 32 { 2.0 } else { 0.0 }).into()),
            mask: None,
            motion: None,
            instances: None,
            camera_index: None,
            distance_sigma: None,
        };
        let capture = Capture {
            frames: vec![frame],
            time_frames: 1,
            duration_s: None,
            metric: true,
            tracks: None,
        };
        let shell = shell(&capture, 1000, 10.0);
        // within the view of the right half, and nowhere else, pixels without a surface were seen
        let sky = shell.xyz.len() - shell.filling;
        assert!((5..250).contains(&sky), "{sky} of 1000");
        assert!(shell.xyz[..sky].iter().all(|p| p[0] > -1.0 && p[2] > 0.0));
        assert_eq!(shell.filling, 1000 - sky);
        for (p, rgb) in shell.xyz.iter().zip(&shell.rgb) {
            assert!((p.iter().map(|v| v * v).sum::<f32>().sqrt() - 10.0).abs() < 1e-3);
            if p[0] < -5.0 && p[2] > 0.0 {
                assert!(rgb[0] > 0.9 && rgb[2] < 0.1, "{p:?} is {rgb:?}");
            }
            if p[0] > 5.0 && p[2] > 0.0 {
                assert!(rgb[2] > 0.9 && rgb[0] < 0.1, "{p:?} is {rgb:?}");
            }
        }
    }
}
