//! First velocities: each keyframe's moving points are registered to those of the keyframes before and
//! after, by a smooth displacement that brings similar colours together.

use crate::voxel::Centroids;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

/// How points are registered.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Registration {
    /// A difference of colour of this size counts as much as a displacement of one `reach`.
    pub colour_scale: f32,
    /// Length over which places compete with colours, world units.
    pub reach: f32,
    /// Points whose displacements are averaged.
    pub neighbours: usize,
    /// Rounds of match and average.
    pub rounds: usize,
}

/// Coordinates in which a match is the nearest point: place over reach, colour over its scale.
fn joint(p: [f32; 3], rgb: [f32; 3], by: &Registration) -> [f32; 6] {
    let (a, b) = (1.0 / by.reach, 1.0 / by.colour_scale);
    [p[0] * a, p[1] * a, p[2] * a, rgb[0] * b, rgb[1] * b, rgb[2] * b]
}

/// A smooth displacement of `from` onto `to`, world units, that starts from `guess`.
///
/// Each round matches every displaced point to the nearest of `to` in place and colour; the displacement
/// becomes the mean over the neighbours of what their matches ask for, matches of unlike colour or far
/// away weighing little. This is point-to-point registration with a local translation in place of one rigid motion.
fn displacement(from: &Centroids, to: &Centroids, guess: &[[f32; 3]], by: &Registration) -> Vec<[f32; 3]> {
    let mut u = guess.to_vec();
    let targets: Vec<[f32; 6]> = to.xyz.iter().zip(&to.rgb).map(|(p, c)| joint(*p, *c, by)).collect();
    let (Ok(tree), Ok(places)) = (
        ImmutableKdTree::<f32, 6>::new_from_slice(&targets),
        ImmutableKdTree::<f32, 3>::new_from_slice(&from.xyz),
    ) else {
        return u;
    };
    let Some(count) = NonZero::new(by.neighbours.min(from.xyz.len())) else {
        return u;
    };
    if targets.is_empty() {
        return u;
    }
    let near: Vec<Vec<u32>> = from
        .xyz
        .par_iter()
        .map(|p| {
            let found = places.query(p).nearest_n::<SquaredEuclidean<f32>>(count).execute();
            found.into_iter().map(|n| n.item).collect()
        })
        .collect();
    for _ in 0..by.rounds {
        let wanted: Vec<[f32; 4]> = from
            .xyz
            .par_iter()
            .zip(&u)
            .zip(&from.rgb)
            .map(|((p, u), rgb)| {
                let at = [0, 1, 2].map(|k| p[k] + u[k]);
                let n = tree
                    .query(&joint(at, *rgb, by))
                    .nearest_one::<SquaredEuclidean<f32>>()
                    .execute();
                let q = to.xyz[n.item as usize];
                let weight = 1.0 / (1.0 + n.distance);
                [q[0] - p[0], q[1] - p[1], q[2] - p[2], weight]
            })
            .collect();
        u = near
            .par_iter()
            .map(|near| {
                let mut sum = [0.0f32; 4];
                for &i in near {
                    let [x, y, z, w] = wanted[i as usize];
                    for (s, v) in sum.iter_mut().zip([w * x, w * y, w * z, w]) {
                        *s += v;
                    }
                }
                [0, 1, 2].map(|k| sum[k] / sum[3].max(1e-9))
            })
            .collect();
    }
    u
}

/// Velocities of the points of every keyframe, world units a frame: half the displacement from the
/// keyframe before to the one after; one side at the ends; 0 for a lone keyframe.
pub(crate) fn velocities(keyframes: &[(f64, Centroids)], by: &Registration) -> Vec<Vec<[f32; 3]>> {
    let mut sums: Vec<Vec<[f32; 4]>> = keyframes.iter().map(|(_, c)| vec![[0.0; 4]; c.xyz.len()]).collect();
    let mut forward: Vec<[f32; 3]> = Vec::new();
    for i in 1..keyframes.len() {
        let ((t0, a), (t1, b)) = (&keyframes[i - 1], &keyframes[i]);
        let gap = (t1 - t0) as f32;
        if gap.abs() < 1e-6 {
            continue;
        }
        // What moved on goes on moving: the last displacement is a good first guess.
        let guess = match i {
            1 => vec![[0.0; 3]; a.xyz.len()],
            _ => carried(&keyframes[i - 2].1, &forward, a),
        };
        forward = displacement(a, b, &guess, by);
        let turned: Vec<[f32; 3]> = forward.iter().map(|u| u.map(|v| -v)).collect();
        let moved = Centroids {
            xyz: a
                .xyz
                .iter()
                .zip(&forward)
                .map(|(p, u)| [0, 1, 2].map(|k| p[k] + u[k]))
                .collect(),
            ..Centroids::default()
        };
        let backward = displacement(b, a, &interpolated(&moved.xyz, &turned, &b.xyz), by);
        let add = |sums: &mut Vec<[f32; 4]>, u: &[[f32; 3]], sign: f32| {
            for (s, u) in sums.iter_mut().zip(u) {
                (0..3).for_each(|k| s[k] += sign * u[k] / gap);
                s[3] += 1.0;
            }
        };
        add(&mut sums[i - 1], &forward, 1.0);
        add(&mut sums[i], &backward, -1.0);
    }
    sums.into_iter()
        .map(|v| {
            v.into_iter()
                .map(|[x, y, z, n]| [x, y, z].map(|s| s / n.max(1.0)))
                .collect()
        })
        .collect()
}

/// Displacements of the points `from`, moved along, at the points of the next keyframe.
fn carried(from: &Centroids, u: &[[f32; 3]], to: &Centroids) -> Vec<[f32; 3]> {
    let moved: Vec<[f32; 3]> = from
        .xyz
        .iter()
        .zip(u)
        .map(|(p, u)| [0, 1, 2].map(|k| p[k] + u[k]))
        .collect();
    interpolated(&moved, u, &to.xyz)
}

/// Values known at `points`, at other places: weighted by the inverse distance to the three nearest.
pub(crate) fn interpolated(points: &[[f32; 3]], values: &[[f32; 3]], at: &[[f32; 3]]) -> Vec<[f32; 3]> {
    const THREE: NonZero<usize> = NonZero::new(3).unwrap();
    let tree = match ImmutableKdTree::<f32, 3>::new_from_slice(points) {
        Ok(tree) if !points.is_empty() && points.len() == values.len() => tree,
        _ => return vec![[0.0; 3]; at.len()],
    };
    at.par_iter()
        .map(|p| {
            let (mut sum, mut total) = ([0.0f32; 3], 0.0f32);
            for n in tree.query(p).nearest_n::<SquaredEuclidean<f32>>(THREE).execute() {
                let weight = 1.0 / n.distance.sqrt().max(1e-6);
                let v = values[n.item as usize];
                (0..3).for_each(|k| sum[k] += weight * v[k]);
                total += weight;
            }
            sum.map(|s| s / total.max(1e-9))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::{Registration, interpolated, velocities};
    use crate::voxel::Centroids;
    use m4_math::CounterRng;

    const BY: Registration = Registration {
        colour_scale: 0.1,
        reach: 0.1,
        neighbours: 16,
        rounds: 15,
    };

    fn cloud() -> Centroids {
        let mut rng = CounterRng::new(5, 0, 0);
        let mut still = Centroids::default();
        for _ in 0..600 {
            let p = [0, 1, 2].map(|_| rng.uniform() as f32);
            still.xyz.push(p);
            // colours that change smoothly over the body
            still
                .rgb
                .push([0, 1, 2].map(|k| 0.5 + 0.4 * (5.0 * p[k] + k as f32).sin()));
            still.edge.push(0.05);
        }
        still
    }

    fn share_within(got: &[Vec<[f32; 3]>], want: impl Fn(usize, usize) -> [f32; 3], off: f32) -> f64 {
        let (mut good, mut all) = (0usize, 0usize);
        for (i, frame) in got.iter().enumerate() {
            for (j, v) in frame.iter().enumerate() {
                let w = want(i, j);
                good += usize::from((0..3).map(|k| (v[k] - w[k]).powi(2)).sum::<f32>().sqrt() < off);
                all += 1;
            }
        }
        good as f64 / all as f64
    }

    #[test]
    fn a_cloud_that_drifts_is_followed() {
        let (still, drift) = (cloud(), [0.03f32, -0.02, 0.01]);
        let at = |t: f64| {
            let mut moved = still.clone();
            for p in &mut moved.xyz {
                (0..3).for_each(|k| p[k] += drift[k] * t as f32);
            }
            (t, moved)
        };
        let got = velocities(&[at(0.0), at(2.0), at(4.0)], &BY);
        let good = share_within(&got, |_, _| drift, 0.004);
        assert!(good > 0.95, "{good} of the points follow the drift");
    }

    #[test]
    fn a_cloud_that_turns_is_followed() {
        let still = cloud();
        let turned = |p: &[f32; 3], t: f64| {
            let (s, c) = (0.1 * t).sin_cos();
            let (x, y) = (f64::from(p[0]) - 0.5, f64::from(p[1]) - 0.5);
            [(c * x - s * y + 0.5) as f32, (s * x + c * y + 0.5) as f32, p[2]]
        };
        let frames: Vec<(f64, Centroids)> = (0..5)
            .map(|t| {
                let mut moved = still.clone();
                moved.xyz.iter_mut().for_each(|p| *p = turned(p, f64::from(t)));
                (f64::from(t), moved)
            })
            .collect();
        let got = velocities(&frames, &BY);
        let want = |i: usize, j: usize| {
            let p = frames[i].1.xyz[j];
            [-0.1 * (p[1] - 0.5), 0.1 * (p[0] - 0.5), 0.0]
        };
        let good = share_within(&got[1..4], |i, j| want(i + 1, j), 0.012);
        assert!(good > 0.8, "{good} of the points follow the turn");
    }

    #[test]
    fn nothing_to_follow_is_no_motion() {
        assert_eq!(velocities(&[(0.0, cloud())], &BY)[0][7], [0.0; 3]);
        let got = velocities(&[(0.0, cloud()), (1.0, Centroids::default())], &BY);
        assert!(got[0].iter().all(|v| *v == [0.0; 3]) && got[1].is_empty());
        assert_eq!(interpolated(&[], &[], &[[1.0; 3]]), [[0.0; 3]]);
    }
}
