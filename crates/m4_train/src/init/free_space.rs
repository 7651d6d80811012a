//! Removes static points that other frames see through.
//!
//! Depth that was estimated smears over edges, and each frame smears in a way of its own. A point
//! that hangs in front of what several other frames see behind it is no surface
//! (docs/spec/optimiser.md 2.6 has the check for tracked points).

use crate::init::{
    InitConfig, InitError,
    cloud::{Pixels, is_depth, moving_pixels},
    config::stopped,
};
use m4_core::{Camera, Capture, CompactMask, Progress, nalgebra::Vector3};
use rayon::prelude::*;

/// Other frames that are asked about the points of a frame.
const WITNESSES: usize = 16;
/// Fewest of them that must see through a point.
const LEAST: u8 = 2;
/// Points of a frame that tell which others see any of it.
const PROBES: usize = 128;
/// A point behind the depth map by this share of the depth is hidden.
const HIDDEN_BEHIND: f32 = 0.1;

/// Drops the points that at least [`LEAST`] other frames, and more than agree with them, see
/// through: that are nearer than the depth there and around by more than `config.free_space` of it.
/// Fails with [`InitError::Stopped`].
pub(crate) fn clear(
    capture: &Capture,
    static_points: &mut [Pixels],
    config: &InitConfig,
    progress: &dyn Progress,
) -> Result<(), InitError> {
    if config.free_space == 0.0 {
        return Ok(());
    }
    let frames: Vec<usize> = static_points.iter().map(|s| s.frame).collect();
    let all: Vec<Option<Witness>> = frames
        .par_iter()
        .map(|&frame| Witness::of(capture, frame, config))
        .collect();
    static_points
        .par_iter_mut()
        .enumerate()
        .try_for_each(|(at, pixels)| {
            stopped(progress)?;
            let points = points(capture, pixels);
            let others = all.iter().enumerate().filter(|(i, _)| *i != at);
            let others: Vec<&Witness> = others.filter_map(|(_, w)| w.as_ref()).collect();
            let votes = votes(&points, &witnesses(&others, &points), config.free_space);
            let mut votes = votes.into_iter();
            let (w, h) = pixels.mask.size();
            let mask = &pixels.mask;
            pixels.mask = CompactMask::from_fn(w, h, |x, y| {
                mask.at(x, y)
                    && votes
                        .next()
                        .is_none_or(|v| v.through < LEAST || v.through <= v.agree)
            });
            Ok(())
        })
}

/// The frames that are asked about these points: evenly spread over those that see any of them,
/// for the others of a long walk are in other rooms. A frame that sees few of them does so from
/// another direction, and tells most (docs/decisions/0028-first-splats-by-clip.md).
fn witnesses<'a>(others: &[&'a Witness], points: &[Vector3<f64>]) -> Vec<&'a Witness> {
    let probes = || points.iter().step_by(points.len().div_ceil(PROBES).max(1));
    let near: Vec<&Witness> = others
        .par_iter()
        .filter(|w| probes().any(|p| w.shows(p)))
        .copied()
        .collect();
    let count = near.len().min(WITNESSES);
    (0..count)
        .map(|k| near[(2 * k + 1) * near.len() / (2 * count)])
        .collect()
}

/// The kept pixels in the world, row by row.
fn points(capture: &Capture, pixels: &Pixels) -> Vec<Vector3<f64>> {
    let frame = &capture.frames[pixels.frame];
    let Some(depth) = &frame.depth else {
        return Vec::new();
    };
    let (w, h) = depth.size();
    let camera = frame.camera.resized(w, h);
    pixels
        .mask
        .set_pixels()
        .map(|(x, y)| camera.unproject(x as f64, y as f64, depth.at(x, y).into()))
        .collect()
}

/// What other frames say of a point.
#[derive(Clone, Copy, Default)]
struct Votes {
    through: u8,
    agree: u8,
}

/// What `witnesses` say of each point.
fn votes(points: &[Vector3<f64>], witnesses: &[&Witness], tolerance: f32) -> Vec<Votes> {
    let mut out = vec![Votes::default(); points.len()];
    for witness in witnesses {
        for (point, votes) in points.iter().zip(&mut out) {
            match witness.says(point, tolerance) {
                Some(true) => votes.through += 1,
                Some(false) => votes.agree += 1,
                None => {}
            }
        }
    }
    out
}

/// A frame that sees.
struct Witness {
    camera: Camera,
    width: usize,
    height: usize,
    /// z-depth, and the least of 3x3 pixels; 0 where nothing is static or nothing is known.
    depth: Vec<f32>,
    least: Vec<f32>,
}

impl Witness {
    fn of(capture: &Capture, frame: usize, config: &InitConfig) -> Option<Self> {
        let frame = &capture.frames[frame];
        let depth = frame.depth.as_ref()?.to_map();
        let (width, height) = depth.size();
        let moves = moving_pixels(frame, width, height);
        let moves = m4_core::dilated(&moves, width, height, config.mask_margin_px);
        let static_depth = |i: usize| {
            let z = depth.data()[i];
            if is_depth(z) && !moves[i] { z } else { 0.0 }
        };
        let depth: Vec<f32> = (0..width * height).map(static_depth).collect();
        let mut least = depth.clone();
        for y in 0..height {
            for x in 0..width {
                let mut low = f32::INFINITY;
                for row in y.saturating_sub(1)..(y + 2).min(height) {
                    let row = &depth[row * width..][x.saturating_sub(1)..(x + 2).min(width)];
                    low = row.iter().copied().fold(low, f32::min);
                }
                least[y * width + x] = low;
            }
        }
        Some(Self {
            camera: frame.camera.resized(width, height),
            width,
            height,
            depth,
            least,
        })
    }

    /// The pixel that a point is in, and its z-depth; `None` outside of the image.
    fn pixel(&self, point: &Vector3<f64>) -> Option<(usize, f32)> {
        let ([u, v], z) = self.camera.project(point);
        let inside = z > 0.0
            && u > -0.5
            && v > -0.5
            && u < self.width as f64 - 0.5
            && v < self.height as f64 - 0.5;
        let pixel = || (v + 0.5) as usize * self.width + (u + 0.5) as usize;
        inside.then(|| (pixel(), z as f32))
    }

    /// Whether the point is in its image and not clearly behind what it sees there.
    fn shows(&self, point: &Vector3<f64>) -> bool {
        self.pixel(point)
            .is_some_and(|(i, z)| z < (1.0 + HIDDEN_BEHIND) * self.depth[i])
    }

    /// Whether it sees through the point; `false` if it sees the point; `None` if it cannot tell.
    fn says(&self, point: &Vector3<f64>, tolerance: f32) -> Option<bool> {
        let (i, z) = self.pixel(point)?;
        let (depth, least) = (self.depth[i], self.least[i]);
        if least > 0.0 && z < (1.0 - tolerance) * least {
            Some(true)
        } else if depth > 0.0 && (z / depth - 1.0).abs() <= tolerance {
            Some(false)
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::clear;
    use crate::init::{InitConfig, cloud::clouds};
    use m4_core::{
        Camera, Capture, CaptureFrame, Intrinsics, Plane, Se3, Silent, nalgebra::Vector3,
    };

    const SIZE: (usize, usize) = (64, 48);
    const WALL: f64 = 4.0;
    const BOX: f64 = 2.5;

    /// A box in front of a wall from a camera that goes past; `smear` changes the depth of one
    /// frame.
    fn capture(smear: impl Fn(usize, usize, usize) -> Option<f32>) -> Capture {
        let (w, h) = SIZE;
        let frame = |i: usize| {
            let mut c2w = Se3::identity();
            c2w.translation = Vector3::new(0.1 * i as f64, 0.0, 0.0);
            let camera = Camera {
                intrinsics: Intrinsics::centred(w, h, 60.0),
                c2w,
            };
            let depth = |x: usize, y: usize| {
                let p = camera.unproject(x as f64, y as f64, BOX);
                let front = (p.x - 0.3).abs() < 0.4 && p.y.abs() < 0.4;
                smear(i, x, y).unwrap_or(if front { BOX } else { WALL } as f32)
            };
            CaptureFrame {
                name: format!("{i:03}"),
                camera,
                t: i as f64,
                rgb: Plane::filled(w, h, [128; 3]),
                depth: Some(Plane::from_fn(w, h, depth).into()),
                mask: None,
                motion: None,
                instances: None,
                camera_index: None,
                distance_sigma: None,
            }
        };
        Capture {
            frames: (0..6).map(frame).collect(),
            time_frames: 6,
            duration_s: None,
            metric: true,
            tracks: None,
        }
    }

    /// The pixels of frame 2 that are not points.
    fn missing(capture: &Capture, free_space: f32) -> Vec<(usize, usize)> {
        let config = InitConfig {
            free_space: 0.0,
            ..InitConfig::fast()
        };
        let mut clouds = clouds(capture, &config, &Silent).unwrap();
        let config = InitConfig {
            free_space,
            ..config
        };
        clear(capture, &mut clouds.static_points, &config, &Silent).unwrap();
        let mask = &clouds.static_points[2].mask;
        let all = (0..SIZE.0 * SIZE.1).map(|i| (i % SIZE.0, i / SIZE.0));
        all.filter(|&(x, y)| !mask.at(x, y)).collect()
    }

    #[test]
    fn frames_of_other_places_are_not_asked() {
        let inside = |x: usize, y: usize| (30..36).contains(&x) && (4..9).contains(&y);
        let mut walk = capture(|i, x, y| (i == 2 && inside(x, y)).then_some(3.0));
        let removed = missing(&walk, 0.03);
        assert_eq!(removed.len(), 30);
        for i in 6..46 {
            let mut frame = walk.frames[5].clone();
            frame.camera.c2w.translation.x = 100.0 + 0.1 * i as f64;
            frame.t = i as f64;
            walk.frames.push(frame);
        }
        walk.time_frames = walk.frames.len();
        assert_eq!(missing(&walk, 0.03), removed);
    }

    #[test]
    fn true_depth_stays_whole() {
        assert_eq!(missing(&capture(|_, _, _| None), 0.015), []);
    }

    #[test]
    fn only_points_in_the_free_space_of_other_frames_are_removed() {
        let inside = |x: usize, y: usize| (30..36).contains(&x) && (4..9).contains(&y);
        let smeared = capture(|i, x, y| (i == 2 && inside(x, y)).then_some(3.0));
        let want: Vec<_> = (4..9).flat_map(|y| (30..36).map(move |x| (x, y))).collect();
        assert_eq!(missing(&smeared, 0.03), want);
        assert_eq!(missing(&smeared, 0.0), []);
        // a surface that all see is one
        let solid = capture(|_, x, y| inside(x, y).then_some(3.0));
        assert!(missing(&solid, 0.03).len() < want.len() / 2);
    }
}
