//! The ground: the plane that most of what lies below the camera is on.

use super::WorkingClip;
use m4_core::CounterRng;
use nalgebra::{Matrix3, Vector3};

/// Time between samples, seconds, and pixels between them.
const EVERY_S: f64 = 0.25;
const PIXELS: usize = 12;
/// Planes tried.
const TRIES: usize = 400;
/// A sample lies on the plane if it misses it by less than this share of its distance.
const MISS: f64 = 0.015;
/// Least share of the samples on the ground.
const LEAST: f64 = 0.12;
/// Down is at most this far off the mean downward axis of the cameras, cosine.
const UPRIGHT: f64 = 0.7;

/// Points with `down . x = offset` are on it, those with less above it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ground {
    /// Of length 1.
    pub down: Vector3<f64>,
    pub offset: f64,
}

impl Ground {
    /// How far a point is above the ground, in the unit of the cameras.
    pub fn height(&self, point: &Vector3<f64>) -> f64 {
        self.offset - self.down.dot(point)
    }
}

/// The ground, if there is one below the cameras.
pub(super) fn find(clip: &WorkingClip<'_>) -> Option<Ground> {
    let samples = samples(clip);
    let axis: Vector3<f64> = clip
        .cameras
        .iter()
        .map(|c| c.c2w.rotation * Vector3::y())
        .sum();
    let axis = axis.try_normalize(1e-9)?;
    let on = |g: Ground| {
        samples
            .iter()
            .filter(move |(p, z)| g.height(p).abs() < MISS * z)
            .map(|(p, _)| p)
    };
    let mut rng = CounterRng::new(4, 1, 7);
    let mut best: Option<(usize, Ground)> = None;
    if samples.len() < 100 {
        return None;
    }
    for _ in 0..TRIES {
        let [a, b, c] = [0; 3].map(|_| samples[rng.below(samples.len())].0);
        let Some(ground) = (b - a)
            .cross(&(c - a))
            .try_normalize(1e-12)
            .and_then(|n| oriented(n, &a, &axis))
        else {
            continue;
        };
        let count = on(ground).count();
        if best.is_none_or(|(most, _)| count > most) {
            best = Some((count, ground));
        }
    }
    let (_, mut ground) = best?;
    for _ in 0..3 {
        let near: Vec<_> = on(ground).copied().collect();
        let mean = near.iter().sum::<Vector3<f64>>() / near.len().max(1) as f64;
        let spread: Matrix3<f64> = near
            .iter()
            .map(|p| (p - mean) * (p - mean).transpose())
            .sum();
        let eigen = spread.symmetric_eigen();
        let least = eigen.eigenvalues.imin();
        ground = oriented(eigen.eigenvectors.column(least).into_owned(), &mean, &axis)?;
    }
    let share = on(ground).count() as f64 / samples.len() as f64;
    let above = clip
        .cameras
        .iter()
        .all(|c| ground.height(&c.c2w.translation) > 0.0);
    (share > LEAST && above).then_some(ground)
}

fn oriented(normal: Vector3<f64>, through: &Vector3<f64>, axis: &Vector3<f64>) -> Option<Ground> {
    let down = if normal.dot(axis) < 0.0 {
        -normal
    } else {
        normal
    };
    (down.dot(axis) > UPRIGHT).then(|| Ground {
        down,
        offset: down.dot(through),
    })
}

/// Static points and their z-depths.
fn samples(clip: &WorkingClip<'_>) -> Vec<(Vector3<f64>, f64)> {
    let mut out = Vec::new();
    for t in (0..clip.cameras.len()).step_by(clip.rate.frames(EVERY_S)) {
        for y in (PIXELS / 2..clip.height).step_by(PIXELS) {
            for x in (PIXELS / 2..clip.width).step_by(PIXELS) {
                let p = y * clip.width + x;
                let z = 1.0 / f64::from(clip.disparity[t][p]);
                if clip.dynamic[t][p] == 0 && z.is_finite() {
                    out.push((clip.cameras[t].unproject(x as f64, y as f64, z), z));
                }
            }
        }
    }
    out
}
