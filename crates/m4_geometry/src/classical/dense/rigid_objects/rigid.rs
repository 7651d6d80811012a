//! A part as a rigid body: dense bundle adjustment of the camera against it.

use super::{BLOCK_PX, ROUND_TRIP_PX, Tracklet, WorkingClip};
use crate::classical::dense::working::{nearest_pixel, pixel_at};
use crate::dba::{DbaOptions, Factor, Free, Geometry, Grid, Pinhole, Problem, adjust};
use crate::flow::FlowPair;
use m4_core::{Camera, Se3, quantile};
use nalgebra::Vector3;

/// Fewest adjusted pixels per frame.
const LEAST_POINTS: usize = 12;
/// Noise of the flow, pixels at the working size (scale of the Cauchy weight).
const NOISE_PX: f32 = 0.6;
/// Weight of the disparity that contact suggests.
const PRIOR: f32 = 0.001;
/// Share of the relief of a region that is kept, 0..1, its slope included: adjustment of small
/// regions over few frames exaggerates both.
const RELIEF: f32 = 0.5;
/// Iterations with the shape held.
const POSE_ITERATIONS: usize = 6;
/// Iterations of all variables.
const ITERATIONS: usize = 20;

/// What adjustment made of a part, up to one factor.
pub(super) struct Shape {
    grid: Grid,
    /// World to camera by frame of the tracklet, the world being fixed to the body.
    pub poses: Vec<Se3<f64>>,
    /// `[grid height][grid width]` by frame; 0 where nothing is known.
    pub disparity: Vec<Vec<f32>>,
}

impl Shape {
    /// The mean of all points, and their root mean square distance from it, in the frame of the
    /// body; the same weight for every frame.
    pub fn extent(&self, clip: &WorkingClip<'_>) -> Option<(Vector3<f64>, f64)> {
        let camera = clip.cameras.first()?;
        let (mut sum, mut squares, mut count) = (Vector3::zeros(), 0.0, 0.0);
        for (k, pose) in self.poses.iter().enumerate() {
            let to_body = pose.inverse();
            let (mut here, mut squares_here, mut n) = (Vector3::zeros(), 0.0, 0.0);
            for (p, d) in self.values(clip, k) {
                let (x, y) = (p as usize % clip.width, p as usize / clip.width);
                let point = to_body.transform(&(ray(camera, x, y) / f64::from(d)));
                here += point;
                squares_here += point.norm_squared();
                n += 1.0;
            }
            if n > 0.0 {
                sum += here / n;
                squares += squares_here / n;
                count += 1.0;
            }
        }
        let mean = sum / count;
        let variance = squares / count - mean.norm_squared();
        (count > 0.0 && variance > 0.0).then(|| (mean, variance.sqrt()))
    }

    /// The pixels of a frame with a value, and the value.
    pub fn values<'a>(
        &'a self,
        clip: &'a WorkingClip<'_>,
        k: usize,
    ) -> impl Iterator<Item = (u32, f32)> + 'a {
        self.disparity[k]
            .iter()
            .enumerate()
            .filter(|(_, d)| **d > 0.0)
            .map(move |(g, d)| {
                let (x, y) = (
                    g % self.grid.width * BLOCK_PX,
                    g / self.grid.width * BLOCK_PX,
                );
                ((y * clip.width + x) as u32, *d)
            })
    }
}

/// The direction of a pixel in the camera, of z 1.
fn ray(camera: &Camera, x: usize, y: usize) -> Vector3<f64> {
    let k = &camera.intrinsics;
    Vector3::new(
        (x as f64 + 0.5 - k.cx) / k.fx,
        (y as f64 + 0.5 - k.cy) / k.fy,
        1.0,
    )
}

/// Adjusts one part; `before` is the disparity that it was believed to have.
pub(super) fn reconstruct(
    clip: &WorkingClip<'_>,
    tracklet: &Tracklet,
    before: &[Vec<f32>],
) -> Option<Shape> {
    let (w, h) = (clip.width, clip.height);
    let grid = Grid {
        width: w.div_ceil(BLOCK_PX),
        height: h.div_ceil(BLOCK_PX),
    };
    let inside = Inside::of(clip, tracklet);
    let edges = factors(clip, tracklet, &inside, grid);
    let frames = tracklet.parts.len();
    let sensor: Vec<Vec<f32>> = (0..frames)
        .map(|k| {
            (0..grid.len())
                .map(|g| {
                    let (x, y) = (g % grid.width * BLOCK_PX, g / grid.width * BLOCK_PX);
                    if inside.at(k, x as f32, y as f32, w, h) {
                        before[tracklet.first + k][y * w + x]
                    } else {
                        0.0
                    }
                })
                .collect()
        })
        .collect();
    // Disparities count in units of the part's own, so that one prior fits near and far parts.
    let values: Vec<f32> = sensor
        .iter()
        .flatten()
        .copied()
        .filter(|d| *d > 0.0)
        .collect();
    let unit = values.iter().sum::<f32>() / values.len().max(1) as f32;
    if unit <= 0.0 || values.len() < LEAST_POINTS * frames {
        return None;
    }
    let scaled = |camera: &Camera| {
        let mut pose = camera.w2c();
        pose.translation *= f64::from(unit);
        pose
    };
    let sensor: Vec<Vec<f32>> = sensor
        .into_iter()
        .map(|s| s.into_iter().map(|d| d / unit).collect())
        .collect();
    let k = clip.cameras[tracklet.first].intrinsics;
    let mut geometry = Geometry {
        grid,
        lens: Pinhole::of_image(k.fx, k.fy, k.cx, k.cy, BLOCK_PX as f64),
        poses: clip.cameras[tracklet.first..tracklet.first + frames]
            .iter()
            .map(scaled)
            .collect(),
        disparity: sensor
            .iter()
            .map(|s| s.iter().map(|d| if *d > 0.0 { *d } else { 1.0 }).collect())
            .collect(),
        sensor,
    };
    let eta = vec![vec![1.0f32; grid.len()]; frames];
    let refs: Vec<&_> = edges.iter().collect();
    let problem = Problem {
        edges: &refs,
        eta: &eta,
    };
    let options = DbaOptions {
        free: Free::Poses,
        iterations: POSE_ITERATIONS,
        lm: 1e-4,
        ep: 1e-4,
        prior_alpha: Some(f64::from(PRIOR)),
        cauchy_px: Some(f64::from(NOISE_PX) / BLOCK_PX as f64),
        min_depth: 0.1,
        #[cfg(test)]
        python_twin: false,
    };
    adjust(&mut geometry, &problem, 1..frames, &options).ok()?;
    let options = DbaOptions {
        free: Free::PosesAndDepth,
        iterations: ITERATIONS,
        ..options
    };
    let report = adjust(&mut geometry, &problem, 1..frames, &options).ok()?;
    if report.failed == report.iterations {
        return None;
    }
    let mut disparity: Vec<Vec<f32>> = geometry
        .disparity
        .iter()
        .zip(&geometry.sensor)
        .map(|(d, s)| {
            d.iter()
                .zip(s)
                .map(|(d, s)| if *s > 0.0 { d * unit } else { 0.0 })
                .collect()
        })
        .collect();
    disparity.iter_mut().for_each(|d| flatten(d));
    let mut poses = geometry.poses;
    for pose in &mut poses {
        pose.translation /= f64::from(unit);
    }
    Some(Shape {
        grid,
        poses,
        disparity,
    })
}

/// Draws disparities towards their median; [`RELIEF`] of what they differ by stays.
fn flatten(disparity: &mut [f32]) {
    let values = disparity.iter_mut().filter(|d| **d > 0.0);
    let Some(median) = quantile(&mut values.map(|d| *d).collect::<Vec<_>>(), 0.5) else {
        return;
    };
    disparity
        .iter_mut()
        .filter(|d| **d > 0.0)
        .for_each(|d| *d = median + RELIEF * (*d - median));
}

/// Over how many frames a region is compared with itself, each both ways; rising. Not in seconds:
/// errors add up with every step of the flow, and at 60 frames per second spans of the same seconds
/// as at 24 gave 3 to 12 % worse depth on three scenes.
const SPANS: [usize; 3] = [1, 3, 8];

/// One bit a pixel of every frame of a tracklet.
struct Inside(Vec<Vec<bool>>);

impl Inside {
    fn of(clip: &WorkingClip<'_>, tracklet: &Tracklet) -> Self {
        let one = |pixels: &Vec<u32>| {
            let mut inside = vec![false; clip.width * clip.height];
            for &p in pixels {
                inside[p as usize] = true;
            }
            inside
        };
        Self(tracklet.parts.iter().map(one).collect())
    }

    fn at(&self, k: usize, x: f32, y: f32, w: usize, h: usize) -> bool {
        pixel_at(w, h, x, y).is_some_and(|p| x > -0.5 && y > -0.5 && self.0[k][p])
    }
}

/// The edges of every frame to those [`SPANS`] before and after; frames are counted from the
/// tracklet's first.
fn factors(
    clip: &WorkingClip<'_>,
    tracklet: &Tracklet,
    inside: &Inside,
    grid: Grid,
) -> Vec<Factor<f32>> {
    let ways = (0..tracklet.parts.len()).flat_map(|k| [(k, true), (k, false)]);
    ways.flat_map(|(k, later)| chain(clip, tracklet, inside, grid, k, later))
        .collect()
}

fn chain(
    clip: &WorkingClip<'_>,
    tracklet: &Tracklet,
    inside: &Inside,
    grid: Grid,
    k: usize,
    later: bool,
) -> Vec<Factor<f32>> {
    let (w, h, block) = (clip.width, clip.height, BLOCK_PX as f32);
    let n = grid.len();
    let (mut px, mut py, mut miss) = (vec![0.0f32; n], vec![0.0f32; n], vec![f32::INFINITY; n]);
    for g in 0..n {
        let (x, y) = (
            (g % grid.width) as f32 * block,
            (g / grid.width) as f32 * block,
        );
        if inside.at(k, x, y, w, h) {
            (px[g], py[g], miss[g]) = (x, y, 0.0);
        }
    }
    let mut out = Vec::new();
    let mut at = k;
    for span in 1..=SPANS[SPANS.len() - 1] {
        let next = if later { at + 1 } else { at.wrapping_sub(1) };
        let step = FlowPair::step(clip.flows, tracklet.first + at, later);
        let Some((flow, trip)) = step.filter(|_| next < tracklet.parts.len()) else {
            break;
        };
        for g in 0..n {
            if !miss[g].is_finite() {
                continue;
            }
            let (u, v) = flow.at(px[g], py[g]);
            let trip = trip[nearest_pixel(w, h, px[g], py[g])];
            (px[g], py[g]) = (px[g] + u, py[g] + v);
            miss[g] = if trip < ROUND_TRIP_PX && inside.at(next, px[g], py[g], w, h) {
                miss[g].hypot(trip)
            } else {
                f32::INFINITY
            };
        }
        at = next;
        if SPANS.contains(&span) {
            let weight: Vec<f32> = miss
                .iter()
                .map(|m| {
                    if m.is_finite() {
                        1.0 / (1.0 + m * m)
                    } else {
                        0.0
                    }
                })
                .collect();
            out.push(Factor {
                source: k,
                target: at,
                target_px: [
                    px.iter().map(|x| x / block).collect(),
                    py.iter().map(|y| y / block).collect(),
                ],
                weight: [weight.clone(), weight],
            });
        }
    }
    out
}
