//! Depth without parallax. What a sensor measured is used as it is. What a network knows from one
//! image, up to a factor, or more, per frame, is aligned to what stereo over time measured, and
//! stands where nothing was measured, and where something moves.

#[cfg(test)]
mod tests;

use super::static_depth::Measured;
use super::working::nearest;
use m4_core::{Plane, median};

/// What the values of a map are.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum MonoKind {
    /// z-depth up to one factor per frame; 0, or not finite, where unknown.
    #[default]
    UpToScale,
    /// One over z-depth up to a factor above 0 and a shift per frame; not finite where unknown.
    AffineDisparity,
    /// Metric z-depth; the value is depth units per camera unit. 0, or not finite, where unknown.
    Metric(f32),
}

/// Depth of every frame from itself alone.
#[derive(Debug, Clone, Copy)]
pub struct MonoDepth<'a> {
    /// What the values are.
    pub kind: MonoKind,
    /// One map per frame, `[height][width]`, of any size of the same shape: it is read at the
    /// nearest pixel.
    pub maps: &'a [Plane<f32>],
}

impl MonoDepth<'_> {
    /// `[height][width]` of frame `i`: one over depth where the kind is depth, else as given; NaN
    /// where unknown.
    pub(super) fn at_size(&self, i: usize, (width, height): (usize, usize)) -> Vec<f32> {
        let at = nearest(self.maps[i].size(), width, height);
        let value = |p: usize| {
            let v = self.maps[i][at(p)];
            match self.kind {
                MonoKind::AffineDisparity if v.is_finite() => v,
                MonoKind::UpToScale if v > 0.0 && v.is_finite() => 1.0 / v,
                MonoKind::Metric(unit) if v > 0.0 && v.is_finite() => unit / v,
                _ => f32::NAN,
            }
        };
        (0..width * height).map(value).collect()
    }
}

/// Weight of an aligned disparity relative to one on which all partners agree, where nothing was
/// measured.
const PRIOR_WEIGHT: f32 = 0.3;
/// Confidence from which on a measured disparity takes part in an alignment.
const SURE: f32 = 0.5;

/// Depth of all frames from one image each, at the working size.
#[derive(Default)]
pub(super) struct Mono {
    pub kind: MonoKind,
    /// `[frames]` of [`MonoDepth::at_size`]; empty where nothing is known.
    pub frames: Vec<Vec<f32>>,
}

impl Mono {
    /// The disparity of a frame that is known without alignment, by pixel.
    fn metric(&self, i: usize) -> impl Iterator<Item = (usize, f32)> {
        let frame = self
            .frames
            .get(i)
            .filter(|_| matches!(self.kind, MonoKind::Metric(_)));
        frame
            .into_iter()
            .flatten()
            .copied()
            .enumerate()
            .filter(|(_, d)| d.is_finite())
    }

    /// The disparity of a frame that is known but for an alignment; NaN where unknown.
    fn relative(&self, i: usize) -> Option<&Vec<f32>> {
        self.frames
            .get(i)
            .filter(|_| !matches!(self.kind, MonoKind::Metric(_)))
    }

    /// Takes metric depth for measured, but where something moves (above 0).
    pub fn impose(&self, i: usize, measured: &mut Measured, dynamic: Option<&[u8]>) {
        for (p, d) in self
            .metric(i)
            .filter(|(p, _)| dynamic.is_none_or(|m| m[*p] == 0))
        {
            (measured.disparity[p], measured.confidence[p]) = (d, 1.0);
        }
    }

    /// Puts metric depth over all else.
    pub fn overrule(&self, i: usize, disparity: &mut [f32]) {
        for (p, d) in self.metric(i) {
            disparity[p] = d;
        }
    }

    /// Disparity of a frame, brought to `disparity` where that is sure and nothing moves; NaN where
    /// unknown. `None` where nothing is known or too little is sure.
    pub fn aligned(
        &self,
        i: usize,
        disparity: &[f32],
        confidence: &[f32],
        dynamic: Option<&[u8]>,
    ) -> Option<Vec<f32>> {
        let relative = self.relative(i)?;
        let sure = |p: &usize| {
            confidence[*p] >= SURE
                && dynamic.is_none_or(|m| m[*p] == 0)
                && relative[*p].is_finite()
                && disparity[*p] > 0.0
        };
        let pair = |p: usize| (f64::from(relative[p]), f64::from(disparity[p]));
        let pairs: Vec<(f64, f64)> = (0..relative.len()).filter(sure).map(pair).collect();
        let fit = Fit::of(&pairs, self.kind == MonoKind::AffineDisparity)?;
        Some(
            relative
                .iter()
                .map(|&v| fit.disparity(v).unwrap_or(f32::NAN))
                .collect(),
        )
    }

    /// Fills unmeasured static pixels with the aligned prior, at low weight.
    pub fn with_prior(&self, i: usize, measured: &Measured, dynamic: Option<&[u8]>) -> Measured {
        let mut out = measured.clone();
        let aligned = self
            .aligned(i, &measured.disparity, &measured.confidence, dynamic)
            .unwrap_or_default();
        for (p, d) in aligned
            .into_iter()
            .enumerate()
            .filter(|(_, d)| d.is_finite())
        {
            if out.confidence[p] == 0.0 && dynamic.is_none_or(|m| m[p] == 0) {
                (out.disparity[p], out.confidence[p]) = (d, PRIOR_WEIGHT);
            }
        }
        out
    }

    /// Gives dynamic regions their own depth, in front of the background.
    pub fn place_dynamic(
        &self,
        i: usize,
        measured: &Measured,
        background: &[f32],
        dynamic: &[u8],
        disparity: &mut [f32],
    ) {
        let aligned = self
            .aligned(i, background, &measured.confidence, Some(dynamic))
            .unwrap_or_default();
        for (p, d) in aligned
            .into_iter()
            .enumerate()
            .filter(|(_, d)| d.is_finite())
        {
            if dynamic[p] > 0 {
                disparity[p] = d.max(background[p]);
            }
        }
    }

    /// Whether it knows nothing of any frame.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// The disparity of a frame of a clip in which nothing can be measured: `made_up`, or as a
    /// middle distance of 1 has it.
    pub fn without_parallax(&self, i: usize, made_up: Vec<f32>) -> Vec<f32> {
        let mut out = made_up;
        let Some(relative) = self.relative(i) else {
            return out;
        };
        let mut all: Vec<f64> = relative
            .iter()
            .filter(|v| v.is_finite())
            .map(|&v| f64::from(v))
            .collect();
        if let Some(middle) = median(&mut all).filter(|middle| *middle > 0.0) {
            let fit = Fit {
                scale: 1.0 / middle,
                shift: 0.0,
            };
            for (out, v) in out.iter_mut().zip(relative) {
                *out = fit.disparity(*v).unwrap_or(*out);
            }
        }
        out
    }
}

/// Fewest measured pixels that a fit rests on.
const NEEDED: usize = 100;
/// Steps of least squares after the medians, and the width of their weights in standard deviations.
const STEPS: usize = 20;
const WIDTH: f64 = 2.385;
/// Partners of a pixel when slopes are measured.
const PARTNERS: usize = 3;

/// `disparity = scale relative + shift`.
#[derive(Clone, Copy)]
struct Fit {
    scale: f64,
    shift: f64,
}

impl Fit {
    /// By medians and weighted least squares, so that a good third of the pixels may be wrong:
    /// pairs of a relative and a measured disparity. `None` for too few, for relative disparity
    /// without any relief, and where the fit would turn near and far round.
    fn of(pairs: &[(f64, f64)], with_shift: bool) -> Option<Self> {
        if pairs.len() < NEEDED {
            return None;
        }
        let (scale, shift) = if with_shift {
            let scale = slope(pairs)?;
            let mut rest: Vec<f64> = pairs.iter().map(|(r, m)| m - scale * r).collect();
            (scale, median(&mut rest)?)
        } else {
            let mut ratios: Vec<f64> = pairs
                .iter()
                .filter(|p| p.0 > 0.0)
                .map(|(r, m)| m / r)
                .collect();
            (median(&mut ratios)?, 0.0)
        };
        let mut fit = Self { scale, shift };
        for _ in 0..STEPS {
            fit = fit.refined(pairs, with_shift)?;
        }
        (fit.scale.is_finite() && fit.shift.is_finite() && fit.scale > 0.0).then_some(fit)
    }

    /// A step of least squares with the weights of Geman and McClure, whose scale follows the
    /// residuals: medians alone lean towards outliers that lie on one side.
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

    /// The disparity, `None` beyond infinity.
    fn disparity(&self, relative: f32) -> Option<f32> {
        let d = self.scale * f64::from(relative) + self.shift;
        (d > 0.0 && d.is_finite()).then_some(d as f32)
    }
}

/// Median of the slopes between pairs far apart in the list, weighted by how far apart they are in
/// relative disparity (Theil 1950, Sen 1968). Slopes from one middle value, as `megasam::prior` has
/// them, mean nothing where half of a image is one flat wall. `None` without any relief.
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
