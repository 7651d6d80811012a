//! The seam between dense geometry and whatever knows depth from one image: a sensor, a network, nothing.
//!
//! ```text
//! MonoDepth --> a plane of disparities per frame, NaN where unknown
//!    metric: taken as it is, and as what was measured
//!    else:   aligned to what stereo over time measured --> where nothing was measured, and where something moves
//! ```

#[cfg(test)]
mod tests;

use super::static_depth::Measured;
use super::working::nearest;
use m4_core::{DepthMap, Plane, RgbImage, median};
use std::borrow::Cow;

/// What the values of a map are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MonoKind {
    /// z-depth in the unit of the cameras; 0, or not finite, where unknown.
    Metric,
    /// z-depth up to one factor per frame; 0, or not finite, where unknown.
    UpToScale,
    /// One over z-depth up to a factor above 0 and a shift per frame; not finite where unknown.
    AffineDisparity,
}

/// Depth of one frame, `[height][width]`, of any size of the same shape: it is read at the nearest pixel.
#[derive(Debug, Clone)]
pub struct MonoMap<'a> {
    /// What the values are.
    pub kind: MonoKind,
    /// The values.
    pub values: Cow<'a, Plane<f32>>,
}

/// Why there is no depth.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MonoError {
    /// The source failed.
    #[error("{source_name} found no depth: {reason}")]
    Source {
        /// Its name.
        source_name: String,
        /// What went wrong.
        reason: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A map without pixels.
    #[error("the depth map is empty; give one of the shape of the frame")]
    Empty,
}

/// Knows depth from one image: a sensor, a network, another program's result.
///
/// Called from several threads at once; the same image must give the same bits.
pub trait MonoDepth: Send + Sync {
    /// For records and messages.
    fn name(&self) -> &str;

    /// For how many frames it has depth; `None` for any number.
    fn frames(&self) -> Option<usize> {
        None
    }

    /// Depth of frame `frame`, which is `image`; `None` where it is unknown. All maps of a clip are of one kind.
    ///
    /// # Errors
    ///
    /// [`MonoError`] where the source fails.
    fn depth(&self, frame: usize, image: &RgbImage) -> Result<Option<MonoMap<'_>>, MonoError>;
}

/// Knows nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoDepth;

impl MonoDepth for NoDepth {
    fn name(&self) -> &'static str {
        "none"
    }

    fn depth(&self, _: usize, _: &RgbImage) -> Result<Option<MonoMap<'_>>, MonoError> {
        Ok(None)
    }
}

/// What a sensor measured: a plane per frame, z-depth in the unit of the cameras, 0 where unknown.
#[derive(Debug, Clone)]
pub struct SensorDepth {
    /// One per frame.
    pub maps: Vec<DepthMap>,
}

impl MonoDepth for SensorDepth {
    fn name(&self) -> &'static str {
        "sensor"
    }

    fn frames(&self) -> Option<usize> {
        Some(self.maps.len())
    }

    fn depth(&self, frame: usize, _: &RgbImage) -> Result<Option<MonoMap<'_>>, MonoError> {
        Ok(self.maps.get(frame).map(|map| MonoMap { kind: MonoKind::Metric, values: Cow::Borrowed(map) }))
    }
}

/// Weight of an aligned disparity relative to one on which all partners agree, where nothing was measured.
const PRIOR_WEIGHT: f32 = 0.3;
/// Confidence from which on a measured disparity takes part in an alignment.
const SURE: f32 = 0.5;

/// Monocular depth of one frame.
pub(super) struct FrameDepth {
    kind: MonoKind,
    /// `[height][width]`: one over depth for the kinds of depth, else as given; NaN where unknown.
    values: Vec<f32>,
}

/// Depth of all frames from one image each, at the working size.
pub(super) struct Mono {
    pub frames: Vec<Option<FrameDepth>>,
}

impl Mono {
    /// The map of one frame.
    pub fn read(
        source: &dyn MonoDepth,
        frame: usize,
        image: &RgbImage,
        (width, height): (usize, usize),
    ) -> Result<Option<FrameDepth>, MonoError> {
        let Some(map) = source.depth(frame, image)? else {
            return Ok(None);
        };
        let (w, h) = map.values.size();
        if w == 0 || h == 0 {
            return Err(MonoError::Empty);
        }
        let at = nearest((w, h), width, height);
        let value = |p: usize| {
            let v = map.values[at(p)];
            match map.kind {
                MonoKind::AffineDisparity if v.is_finite() => v,
                MonoKind::Metric | MonoKind::UpToScale if v > 0.0 && v.is_finite() => 1.0 / v,
                _ => f32::NAN,
            }
        };
        Ok(Some(FrameDepth { kind: map.kind, values: (0..width * height).map(value).collect() }))
    }

    /// The known disparity of a frame, NaN where it is unknown.
    fn metric(&self, i: usize) -> Option<&[f32]> {
        let known = self.frames[i].as_ref()?;
        (known.kind == MonoKind::Metric).then_some(&known.values)
    }

    /// Takes metric depth for measured, but where something moves (above 0).
    pub fn impose(&self, i: usize, measured: &mut Measured, moving: Option<&[u8]>) {
        let Some(metric) = self.metric(i) else { return };
        for (p, d) in metric.iter().enumerate().filter(|(_, d)| d.is_finite()) {
            if moving.is_none_or(|m| m[p] == 0) {
                (measured.disparity[p], measured.confidence[p]) = (*d, 1.0);
            }
        }
    }

    /// Puts metric depth over all else.
    pub fn overrule(&self, i: usize, disparity: &mut [f32]) {
        let Some(metric) = self.metric(i) else { return };
        for (out, known) in disparity.iter_mut().zip(metric).filter(|(_, d)| d.is_finite()) {
            *out = *known;
        }
    }

    /// Relative disparity of a frame, brought to `disparity` where that is sure and nothing moves; NaN where unknown. `None`
    /// without relative disparity, and where too little is sure.
    pub fn aligned(&self, i: usize, disparity: &[f32], confidence: &[f32], moving: Option<&[u8]>) -> Option<Vec<f32>> {
        let known = self.frames[i].as_ref().filter(|k| k.kind != MonoKind::Metric)?;
        let sure = |p: &usize| {
            confidence[*p] >= SURE
                && moving.is_none_or(|m| m[*p] == 0)
                && known.values[*p].is_finite()
                && disparity[*p] > 0.0
        };
        let pair = |p: usize| (f64::from(known.values[p]), f64::from(disparity[p]));
        let pairs: Vec<(f64, f64)> = (0..known.values.len()).filter(sure).map(pair).collect();
        let fit = Fit::of(&pairs, known.kind == MonoKind::AffineDisparity)?;
        Some(known.values.iter().map(|&v| fit.disparity(v).unwrap_or(f32::NAN)).collect())
    }

    /// What is measured, and weakly, where nothing is and nothing moves, what is aligned.
    pub fn with_prior(&self, i: usize, measured: &Measured, moving: Option<&[u8]>) -> Measured {
        let mut out = measured.clone();
        let aligned = self.aligned(i, &measured.disparity, &measured.confidence, moving).unwrap_or_default();
        for (p, d) in aligned.into_iter().enumerate().filter(|(_, d)| d.is_finite()) {
            if out.confidence[p] == 0.0 && moving.is_none_or(|m| m[p] == 0) {
                (out.disparity[p], out.confidence[p]) = (d, PRIOR_WEIGHT);
            }
        }
        out
    }

    /// Gives dynamic regions their own depth, in front of the background.
    pub fn place_moving(
        &self,
        i: usize,
        measured: &Measured,
        background: &[f32],
        moving: &[u8],
        disparity: &mut [f32],
    ) {
        let aligned = self.aligned(i, background, &measured.confidence, Some(moving)).unwrap_or_default();
        for (p, d) in aligned.into_iter().enumerate().filter(|(_, d)| d.is_finite()) {
            if moving[p] > 0 {
                disparity[p] = d.max(background[p]);
            }
        }
    }

    /// Whether it knows nothing of any frame.
    pub fn is_empty(&self) -> bool {
        self.frames.iter().all(Option::is_none)
    }

    /// The disparity of a frame of a clip in which nothing can be measured: `made_up`, or as a middle distance of 1 has it.
    pub fn without_parallax(&self, i: usize, made_up: Vec<f32>) -> Vec<f32> {
        let mut out = made_up;
        let Some(known) = self.frames[i].as_ref().filter(|k| k.kind != MonoKind::Metric) else {
            return out;
        };
        let mut all: Vec<f64> = known.values.iter().filter(|v| v.is_finite()).map(|&v| f64::from(v)).collect();
        if let Some(middle) = median(&mut all).filter(|middle| *middle > 0.0) {
            let fit = Fit { scale: 1.0 / middle, shift: 0.0 };
            for (out, v) in out.iter_mut().zip(&known.values) {
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
    /// By medians and weighted least squares, so that a good third of the pixels may be wrong: pairs of a relative and a measured disparity. `None` for too
    /// few, for relative disparity without any relief, and where the fit would turn near and far round.
    fn of(pairs: &[(f64, f64)], with_shift: bool) -> Option<Self> {
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

    /// The disparity, `None` beyond infinity.
    fn disparity(&self, relative: f32) -> Option<f32> {
        let d = self.scale * f64::from(relative) + self.shift;
        (d > 0.0 && d.is_finite()).then_some(d as f32)
    }
}

/// Median of the slopes between pairs far apart in the list, weighted by how far apart they are in relative disparity
/// (Theil 1950, Sen 1968). Slopes from one middle value, as `megasam::prior` has them, mean nothing where half of a
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
