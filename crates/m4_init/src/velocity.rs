//! First velocities from the keyframes before and after.

use crate::voxel::{Centroids, distance2};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

/// Candidates that are compared by colour.
const CANDIDATES: NonZero<usize> = NonZero::new(24).unwrap();

/// Displacement of each point of `from` to its most similar point of `to`; `None` where nothing lies
/// within `radius` (world units).
fn matches(from: &Centroids, to: &Centroids, radius: f32, colour_scale: f32) -> Vec<Option<[f32; 3]>> {
    let Ok(tree) = ImmutableKdTree::<f32, 3>::new_from_slice(&to.xyz) else {
        return vec![None; from.xyz.len()];
    };
    if to.xyz.is_empty() {
        return vec![None; from.xyz.len()];
    }
    let cost = |i: usize, j: usize| {
        distance2(from.xyz[i], to.xyz[j]) / (radius * radius)
            + distance2(from.rgb[i], to.rgb[j]) / (colour_scale * colour_scale)
    };
    from.xyz
        .par_iter()
        .enumerate()
        .map(|(i, p)| {
            let near = tree.query(p).nearest_n::<SquaredEuclidean<f32>>(CANDIDATES).execute();
            let best = near
                .iter()
                .filter(|n| n.distance <= radius * radius)
                .map(|n| (cost(i, n.item as usize), n.item))
                .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))?;
            let q = to.xyz[best.1 as usize];
            Some([q[0] - p[0], q[1] - p[1], q[2] - p[2]])
        })
        .collect()
}

/// Velocity of each point of keyframe `at`, world units a frame: half the displacement from the
/// keyframe before to the one after where both match, one side where only one does, else 0; then the
/// component-wise median over `neighbours` points of the same keyframe.
pub(crate) fn velocities(
    keyframes: &[(f64, Centroids)],
    at: usize,
    radius: f32,
    colour_scale: f32,
    neighbours: usize,
) -> Vec<[f32; 3]> {
    let (t, points) = &keyframes[at];
    let side = |other: Option<&(f64, Centroids)>| match other {
        Some((to, cloud)) if (to - t).abs() > 1e-6 => {
            let gap = (to - t) as f32;
            matches(points, cloud, radius, colour_scale)
                .into_iter()
                .map(|d| d.map(|d| d.map(|v| v / gap)))
                .collect()
        }
        _ => vec![None; points.xyz.len()],
    };
    let after = side(keyframes.get(at + 1));
    let before = side(at.checked_sub(1).and_then(|i| keyframes.get(i)));
    let raw: Vec<[f32; 3]> = after
        .iter()
        .zip(&before)
        .map(|(a, b)| match (a, b) {
            (Some(a), Some(b)) => [0, 1, 2].map(|k| 0.5 * (a[k] + b[k])),
            (Some(v), None) | (None, Some(v)) => *v,
            (None, None) => [0.0; 3],
        })
        .collect();
    smooth(&points.xyz, &raw, neighbours)
}

/// Component-wise median over the nearest points.
fn smooth(points: &[[f32; 3]], raw: &[[f32; 3]], neighbours: usize) -> Vec<[f32; 3]> {
    let Some(count) = NonZero::new(neighbours).filter(|n| n.get() > 1 && points.len() > 1) else {
        return raw.to_vec();
    };
    let Ok(tree) = ImmutableKdTree::<f32, 3>::new_from_slice(points) else {
        return raw.to_vec();
    };
    points
        .par_iter()
        .map(|p| {
            let near = tree.query(p).nearest_n::<SquaredEuclidean<f32>>(count).execute();
            [0, 1, 2].map(|k| {
                let mut values: Vec<f32> = near.iter().map(|n| raw[n.item as usize][k]).collect();
                values.sort_unstable_by(f32::total_cmp);
                values[values.len() / 2]
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::velocities;
    use crate::voxel::Centroids;
    use m4_math::CounterRng;

    #[test]
    fn a_coloured_cloud_that_drifts_is_followed() {
        let mut rng = CounterRng::new(5, 0, 0);
        let mut still = Centroids::default();
        for _ in 0..400 {
            still.xyz.push([0, 1, 2].map(|_| rng.uniform() as f32));
            still.rgb.push([0, 1, 2].map(|_| rng.uniform() as f32));
            still.edge.push(0.05);
        }
        let drift = [0.03f32, -0.02, 0.01];
        let at = |t: f64| {
            let mut moved = still.clone();
            for p in &mut moved.xyz {
                for k in 0..3 {
                    p[k] += drift[k] * t as f32;
                }
            }
            (t, moved)
        };
        let keyframes = [at(0.0), at(2.0), at(4.0)];
        for i in 0..3 {
            let got = velocities(&keyframes, i, 0.3, 0.1, 8);
            let good = got
                .iter()
                .filter(|v| (0..3).all(|k| (v[k] - drift[k]).abs() < 1e-3))
                .count();
            assert!(good > 390, "keyframe {i}: {good} of 400 follow the drift");
        }
    }
}
