//! A factor and a shift that bring relative disparity to what was measured.

use m4_core::median;
/// Fewest measured pixels that a fit rests on.
const NEEDED: usize = 100;
/// Steps of least squares after the medians, and the width of their weights in standard deviations.
const STEPS: usize = 20;
const WIDTH: f64 = 2.385;
/// Partners of a pixel when slopes are measured.
const PARTNERS: usize = 3;

/// `disparity = scale relative + shift`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fit {
    pub scale: f64,
    pub shift: f64,
}

impl Fit {
    /// By medians and weighted least squares, so that a good third of the pixels may be wrong: pairs of a relative and a measured disparity. `None` for too
    /// few, for relative disparity without any relief, and where the fit would turn near and far round.
    pub fn of(pairs: &[(f64, f64)], with_shift: bool) -> Option<Self> {
        if pairs.len() < NEEDED {
            return None;
        }
        let (scale, shift) = if with_shift {
            let scale = slope(pairs)?;
            let mut rest: Vec<f64> = pairs.iter().map(|(r, m)| m - scale * r).collect();
            (scale, median(&mut rest)?)
        } else {
            let mut ratios: Vec<f64> = pairs.iter().filter(|p| p.0 > 0.0).map(|(r, m)| m / r).collect();
            (median(&mut ratios)?, 0.0)
        };
        let mut fit = Self { scale, shift };
        for _ in 0..STEPS {
            fit = fit.refined(pairs, with_shift)?;
        }
        (fit.scale.is_finite() && fit.shift.is_finite() && fit.scale > 0.0).then_some(fit)
    }

    /// A step of least squares with the weights of Geman and McClure, whose scale follows the residuals: medians alone lean
    /// towards outliers that lie on one side.
    fn refined(&self, pairs: &[(f64, f64)], with_shift: bool) -> Option<Self> {
        let residual = |(r, m): &(f64, f64)| self.scale * r + self.shift - m;
        let mut sizes: Vec<f64> = pairs.iter().map(|p| residual(p).abs()).collect();
        let width = (WIDTH * 1.4826 * median(&mut sizes)?).max(1e-9 * self.scale.abs());
        let (mut n, mut r1, mut r2, mut m1, mut rm) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for pair in pairs {
            let weight = (1.0 + (residual(pair) / width).powi(2)).powi(-2);
            let (r, m) = *pair;
            n += weight;
            r1 += weight * r;
            r2 += weight * r * r;
            m1 += weight * m;
            rm += weight * r * m;
        }
        let (scale, shift) = if with_shift {
            let determinant = n * r2 - r1 * r1;
            let scale = (n * rm - r1 * m1) / determinant;
            (scale, (m1 - scale * r1) / n)
        } else {
            (rm / r2, 0.0)
        };
        (scale.is_finite() && shift.is_finite()).then_some(Self { scale, shift })
    }

    /// Nothing was measured: a middle disparity of 1, as a scene is placed whose depth nothing says.
    pub fn to_distance_one(relative: &mut [f64]) -> Option<Self> {
        let middle = median(relative)?;
        (middle > 0.0).then_some(Self {
            scale: 1.0 / middle,
            shift: 0.0,
        })
    }

    /// The disparity, `None` beyond infinity.
    pub fn disparity(&self, relative: f32) -> Option<f32> {
        let d = self.scale * f64::from(relative) + self.shift;
        (d > 0.0 && d.is_finite()).then_some(d as f32)
    }
}

/// Median of the slopes between pairs far apart in the list, weighted by how far apart they are in relative disparity
/// (Theil 1950, Sen 1968). Slopes from one middle value, as `tracker::mono` has them, mean nothing where half of a
/// image is one flat wall. `None` without any relief.
fn slope(pairs: &[(f64, f64)]) -> Option<f64> {
    let n = pairs.len();
    let mut slopes: Vec<(f64, f64)> = Vec::new();
    for part in 1..=PARTNERS {
        let shift = part * n / (2 * PARTNERS + 1) + part;
        slopes.extend((0..n).filter_map(|k| {
            let ((r, m), (other_r, other_m)) = (pairs[k], pairs[(k + shift) % n]);
            let apart = other_r - r;
            (apart != 0.0).then(|| ((other_m - m) / apart, apart.abs()))
        }));
    }
    slopes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * slopes.iter().map(|s| s.1).sum::<f64>();
    let mut sum = 0.0;
    let mut reached = |s: &&(f64, f64)| {
        sum += s.1;
        sum >= half
    };
    slopes.iter().find(|s| reached(s)).map(|s| s.0)
}
