//! Two frames related by a rigid motion: five-point samples, truncated Sampson errors.

use super::five_point::essential_matrices;
use m4_core::{
    CounterRng, Se3,
    nalgebra::{Matrix3, Vector3},
};

/// Matches of two frames, working pixels from the image centre.
pub(crate) type Match = ([f64; 2], [f64; 2]);

/// How two frames relate.
#[derive(Debug, Clone)]
pub(crate) struct TwoView {
    /// First camera to second camera; translation of length 1.
    pub motion: Se3<f64>,
    /// Which matches agree.
    pub inliers: Vec<usize>,
    /// Mean of `1 - min(error / inlier_px, 1)^2` over all matches: 1 for perfect agreement.
    pub score: f64,
}

/// The essential matrix that most matches agree with (MSAC), for a focal length in working pixels.
///
/// Returns `None` for fewer than 8 matches, or when no sample gives a motion with points in front of
/// both cameras.
pub(crate) fn relate(
    matches: &[Match],
    focal: f64,
    inlier_px: f64,
    samples: usize,
    seed: u64,
    purpose: u64,
) -> Option<TwoView> {
    if matches.len() < 8 {
        return None;
    }
    let ray = |p: [f64; 2]| Vector3::new(p[0] / focal, p[1] / focal, 1.0);
    let rays: Vec<(Vector3<f64>, Vector3<f64>)> = matches.iter().map(|m| (ray(m.0), ray(m.1))).collect();
    let limit = (inlier_px / focal).powi(2);
    let mut best: Option<(f64, Matrix3<f64>)> = None;
    for sample in 0..samples {
        let mut rng = CounterRng::new(seed, purpose, sample as u64);
        let picked = distinct_five(&mut rng, rays.len());
        let candidates = essential_matrices(&picked.map(|i| rays[i].0), &picked.map(|i| rays[i].1));
        for e in candidates {
            let score = score(&e, &rays, limit, best.map_or(0.0, |(s, _)| s));
            if best.is_none_or(|(s, _)| score > s) {
                best = Some((score, e));
            }
        }
    }
    let (score, e) = best?;
    let inliers: Vec<usize> = (0..rays.len()).filter(|&i| sampson(&e, &rays[i]) < limit).collect();
    let motion = decompose(&e, inliers.iter().map(|&i| &rays[i]))?;
    Some(TwoView { motion, inliers, score: score / rays.len() as f64 })
}

/// Five different numbers below `n`, `n >= 5`.
fn distinct_five(rng: &mut CounterRng, n: usize) -> [usize; 5] {
    let mut picked = [usize::MAX; 5];
    for k in 0..5 {
        loop {
            let i = rng.below(n);
            if !picked[..k].contains(&i) {
                picked[k] = i;
                break;
            }
        }
    }
    picked
}

/// Squared Sampson error of a pair of rays, in units of the normalised image.
fn sampson(e: &Matrix3<f64>, (a, b): &(Vector3<f64>, Vector3<f64>)) -> f64 {
    let (ea, eb) = (e * a, e.tr_mul(b));
    let r = b.dot(&ea);
    r * r / (ea.x * ea.x + ea.y * ea.y + eb.x * eb.x + eb.y * eb.y).max(1e-300)
}

/// Sum of `1 - min(error^2 / limit, 1)`; gives up once `to_beat` is out of reach.
fn score(e: &Matrix3<f64>, rays: &[(Vector3<f64>, Vector3<f64>)], limit: f64, to_beat: f64) -> f64 {
    let mut sum = 0.0;
    for (i, pair) in rays.iter().enumerate() {
        sum += (1.0 - sampson(e, pair) / limit).max(0.0);
        if i % 64 == 63 && sum + (rays.len() - i - 1) as f64 <= to_beat {
            break;
        }
    }
    sum
}

/// The motion among the four of `e` that puts most points in front of both cameras.
fn decompose<'a>(
    e: &Matrix3<f64>,
    rays: impl Iterator<Item = &'a (Vector3<f64>, Vector3<f64>)> + Clone,
) -> Option<Se3<f64>> {
    let svd = e.svd(true, true);
    let (mut u, mut v_t) = (svd.u?, svd.v_t?);
    if u.determinant() < 0.0 {
        u = -u;
    }
    if v_t.determinant() < 0.0 {
        v_t = -v_t;
    }
    let w = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let t: Vector3<f64> = u.column(2).into_owned();
    let mut best: Option<(usize, Se3<f64>)> = None;
    for rotation in [u * w * v_t, u * w.transpose() * v_t] {
        for translation in [t, -t] {
            let motion = Se3 { rotation, translation };
            let front = rays.clone().filter(|pair| in_front(&motion, pair)).count();
            if best.as_ref().is_none_or(|(n, _)| front > *n) {
                best = Some((front, motion));
            }
        }
    }
    best.filter(|(front, _)| *front > 0).map(|(_, motion)| motion)
}

/// True when the rays meet in front of both cameras.
fn in_front(motion: &Se3<f64>, (a, b): &(Vector3<f64>, Vector3<f64>)) -> bool {
    // depth_b * b = depth_a * R a + t, in the sense of least squares.
    let ra = motion.rotation * a;
    let (aa, bb, ab) = (ra.norm_squared(), b.norm_squared(), ra.dot(b));
    let (at, bt) = (ra.dot(&motion.translation), b.dot(&motion.translation));
    let determinant = aa * bb - ab * ab;
    let depth_a = (ab * bt - bb * at) / determinant;
    let depth_b = (aa * bt - ab * at) / determinant;
    depth_a > 0.0 && depth_b > 0.0
}

#[cfg(test)]
mod tests {
    use super::relate;
    use m4_core::{CounterRng, Se3, exp_so3, log_so3, nalgebra::Vector3};

    #[test]
    fn motion_is_found_among_moving_points() {
        let focal = 400.0;
        let truth =
            Se3 { rotation: exp_so3(&Vector3::new(0.03, -0.08, 0.02)), translation: Vector3::new(0.5, 0.1, -0.1) };
        let mut rng = CounterRng::new(1, 0, 0);
        let project = |p: Vector3<f64>| [focal * p.x / p.z, focal * p.y / p.z];
        let matches: Vec<_> = (0..300)
            .map(|i| {
                let p = Vector3::new(2.0 * rng.normal(), 1.5 * rng.normal(), 4.0 + 4.0 * rng.uniform());
                let mut q = truth.transform(&p);
                if i % 4 == 0 {
                    q += Vector3::new(0.3 * rng.normal(), 0.3 * rng.normal(), 0.3 * rng.normal());
                }
                let b = project(q);
                (project(p), [b[0] + 0.3 * rng.normal(), b[1] + 0.3 * rng.normal()])
            })
            .collect();
        let found = relate(&matches, focal, 2.0, 200, 0, 0).expect("a motion");
        let turn = log_so3(&(found.motion.rotation * truth.rotation.transpose())).norm();
        let angle = found.motion.translation.dot(&truth.translation.normalize()).acos();
        assert!(turn < 0.01 && angle < 0.05, "{turn} {angle}");
        assert!(found.inliers.len() > 220 && found.score > 0.6, "{} {}", found.inliers.len(), found.score);
        assert!(relate(&matches[..7], focal, 2.0, 10, 0, 0).is_none());
    }
}
