//! The rigid motion of a few neighbours, some of which may be wrong.

use m4_core::nalgebra::{Matrix3, Rotation3, Vector3};

/// A neighbour: where it was, where it is, how much that counts.
#[derive(Debug, Clone, Copy)]
pub(super) struct Anchor {
    pub from: Vector3<f64>,
    pub to: Vector3<f64>,
    pub weight: f64,
}

/// `p -> to + rotation (p - from)`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    pub rotation: Rotation3<f64>,
    pub from: Vector3<f64>,
    pub to: Vector3<f64>,
    /// Median distance by which the anchors miss, world units.
    pub miss: f64,
}

impl Fit {
    /// Where the point goes.
    pub fn apply(&self, p: &Vector3<f64>) -> Vector3<f64> {
        self.to + self.rotation * (p - self.from)
    }
}

/// Rounds in which anchors that miss lose their weight.
const ROUNDS: usize = 5;
/// How much the `prior` weighs, in units of anchors that lie one `spacing` apart.
const PRIOR: f64 = 0.01;
/// Anchors that miss by this many times the median miss count a quarter.
const OUTLIER: f64 = 2.0;

/// The rigid motion that most of `anchors` follow: least squares (Kabsch 1976) with weights of
/// Geman and McClure, from a first guess that half of them may contradict. Where they say nothing
/// of the rotation, or little (one anchor, a line), it stays at `prior`. `None` without weight.
pub(super) fn fit(anchors: &[Anchor], prior: &Rotation3<f64>, spacing: f64) -> Option<Fit> {
    let mut weights: Vec<f64> = anchors.iter().map(|a| a.weight).collect();
    // The first guess: shifts near the middle one.
    let shifts: Vec<Vector3<f64>> = anchors.iter().map(|a| a.to - prior * a.from).collect();
    let off = |s: &Vector3<f64>| {
        shifts
            .iter()
            .zip(anchors)
            .map(|(b, a)| a.weight * (s - b).norm())
            .sum::<f64>()
    };
    let middle = shifts.iter().min_by(|a, b| off(a).total_cmp(&off(b)))?;
    let misses: Vec<f64> = shifts.iter().map(|s| (s - middle).norm()).collect();
    // A turn moves anchors apart as well, so the first guess is a mild one.
    reweigh(&mut weights, anchors, &misses, 2.0 * OUTLIER, 0.5 * spacing);
    let mut best = None;
    for _ in 0..ROUNDS {
        let now = least_squares(anchors, &weights, prior, spacing)?;
        let misses: Vec<f64> = anchors
            .iter()
            .map(|a| (now.apply(&a.from) - a.to).norm())
            .collect();
        let miss = reweigh(&mut weights, anchors, &misses, OUTLIER, 0.02 * spacing);
        best = Some(Fit { miss, ..now });
    }
    best
}

/// New weights; the median miss, by the anchors' own weights.
fn reweigh(
    weights: &mut [f64],
    anchors: &[Anchor],
    misses: &[f64],
    outlier: f64,
    least: f64,
) -> f64 {
    let mut order: Vec<usize> = (0..misses.len()).collect();
    order.sort_by(|&a, &b| misses[a].total_cmp(&misses[b]));
    let total: f64 = anchors.iter().map(|a| a.weight).sum();
    let mut sum = 0.0;
    let median = order.iter().find(|&&i| {
        sum += anchors[i].weight;
        sum >= 0.5 * total
    });
    let median = median.map_or(0.0, |&i| misses[i]);
    let scale = (outlier * median).max(least).max(1e-12);
    for ((w, a), miss) in weights.iter_mut().zip(anchors).zip(misses) {
        *w = a.weight / (1.0 + (miss / scale).powi(2)).powi(2);
    }
    median
}

fn least_squares(
    anchors: &[Anchor],
    weights: &[f64],
    prior: &Rotation3<f64>,
    spacing: f64,
) -> Option<Fit> {
    let (mut from, mut to, mut total) = (Vector3::zeros(), Vector3::zeros(), 0.0);
    for (a, &w) in anchors.iter().zip(weights) {
        from += w * a.from;
        to += w * a.to;
        total += w;
    }
    if !(total > 0.0 && f64::is_finite(total)) {
        return None;
    }
    from /= total;
    to /= total;
    let mut spread = PRIOR * spacing * spacing * prior.matrix();
    for (a, &w) in anchors.iter().zip(weights) {
        spread += (w / total) * (a.to - to) * (a.from - from).transpose();
    }
    let size = spread.norm();
    let rotation = if size > 0.0 {
        let svd = (spread / size).try_svd(true, true, 1e-15, 200)?;
        let (u, v_t) = (svd.u?, svd.v_t?);
        let mut flip = Matrix3::identity();
        // singular values are in falling order: the last direction is the one that is known least
        flip[(2, 2)] = (u.determinant() * v_t.determinant()).signum();
        Rotation3::from_matrix_unchecked(u * flip * v_t)
    } else {
        *prior
    };
    Some(Fit {
        rotation,
        from,
        to,
        miss: 0.0,
    })
}

#[cfg(test)]
mod tests {
    use super::{Anchor, fit};
    use m4_core::{
        CounterRng,
        nalgebra::{Rotation3, Vector3},
    };

    fn cloud(n: usize) -> Vec<Vector3<f64>> {
        let mut rng = CounterRng::new(3, 1, 4);
        (0..n)
            .map(|_| Vector3::from([0, 1, 2].map(|_| rng.uniform() - 0.5)))
            .collect()
    }

    #[test]
    fn a_third_of_wrong_neighbours_does_not_matter() {
        let turn = Rotation3::from_scaled_axis(Vector3::new(0.1, -0.5, 0.2));
        let shift = Vector3::new(0.4, 0.0, -0.2);
        let anchors: Vec<Anchor> = cloud(24)
            .into_iter()
            .enumerate()
            .map(|(i, p)| Anchor {
                from: p,
                to: if i % 3 == 0 {
                    p - shift
                } else {
                    turn * p + shift
                },
                weight: 1.0,
            })
            .collect();
        let actual = fit(&anchors, &Rotation3::identity(), 0.2).unwrap();
        let p = Vector3::new(0.8, -0.3, 0.5);
        let miss = (actual.apply(&p) - (turn * p + shift)).norm();
        assert!(miss < 0.01, "{miss}");
    }

    #[test]
    fn unconstrained_directions_stay_unchanged() {
        let prior = Rotation3::from_scaled_axis(Vector3::new(0.3, 0.0, 0.0));
        let shift = Vector3::new(0.0, 1.0, 0.0);
        let one = Anchor {
            from: Vector3::new(1.0, 2.0, 3.0),
            to: prior * Vector3::new(1.0, 2.0, 3.0) + shift,
            weight: 0.5,
        };
        let actual = fit(&[one], &prior, 0.1).unwrap();
        assert!((actual.rotation.matrix() - prior.matrix()).norm() < 1e-9);
        // a line along x, turned about z: the turn about the line itself stays at the prior
        let turn = Rotation3::from_scaled_axis(Vector3::new(0.0, 0.0, 0.4)) * prior;
        let line: Vec<Anchor> = (0..9)
            .map(|i| {
                let from = Vector3::new(0.1 * f64::from(i), 0.0, 0.0);
                Anchor {
                    from,
                    to: turn * from,
                    weight: 1.0,
                }
            })
            .collect();
        let actual = fit(&line, &prior, 0.1).unwrap();
        let off = (actual.rotation.matrix() - turn.matrix()).norm();
        assert!(off < 0.02, "{off}");
        assert!(fit(&[], &prior, 0.1).is_none());
        let nothing = Anchor { weight: 0.0, ..one };
        assert!(fit(&[nothing], &prior, 0.1).is_none());
    }
}
