//! One scale and shift for a clip: relative disparity of one network, metric depth of another (stage B0,
//! docs/spec/front-end.md 1.2).

use serde::{Deserialize, Serialize};

/// Metric depths below this with hardly any relative disparity are taken for sky that was misjudged.
const SKY_DEPTH_M: f64 = 2.0;

/// Relative disparity below which they are.
const SKY_DISPARITY: f64 = 0.02;

/// The metric disparity that such pixels get instead, 1/m.
const SKY_METRIC: f64 = 0.01;

/// Depth of scene units below which a pixel counts as unknown.
const LEAST_DEPTH: f64 = 0.01;

/// Why two sets of depth could not be aligned: lists or planes of different lengths, or nothing to hold on to.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct MonoError(String);

impl MonoError {
    /// Depth whose 98th percentile is no scale.
    pub(crate) fn no_scale(norm: f64) -> Self {
        Self(format!(
            "the depth of the clip has no scale (its disparity is {norm} at the 98th percentile); check the depth maps"
        ))
    }
}

/// The alignment of a clip. Scene units are metres times [`norm`](Self::norm).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MonoAlignment {
    /// Scale of each frame, 1/m per unit of relative disparity.
    pub scales: Vec<f64>,
    /// Shift of each frame, 1/m.
    pub shifts: Vec<f64>,
    /// The frame whose scale and shift all frames get.
    pub index: usize,
    /// Disparity of near content, 1/m, over two: divides disparities, and multiplies metres into scene units.
    pub norm: f64,
}

impl MonoAlignment {
    /// Aligns relative disparity to metric depth in metres, both `[frames][pixels]`.
    ///
    /// # Errors
    ///
    /// [`MonoError`] where lists do not fit together or hold nothing.
    pub fn new(metric_m: &[Vec<f32>], relative: &[Vec<f32>]) -> Result<Self, MonoError> {
        if metric_m.is_empty() || metric_m.len() != relative.len() {
            return Err(MonoError(format!(
                "{} metric and {} relative depth maps were given; give one of each for every frame, at least one",
                metric_m.len(),
                relative.len()
            )));
        }
        let (mut scales, mut shifts) = (Vec::new(), Vec::new());
        for (frame, (metric, relative)) in metric_m.iter().zip(relative).enumerate() {
            if metric.is_empty() || metric.len() != relative.len() {
                return Err(MonoError(format!(
                    "frame {frame} has {} metric and {} relative values; give planes of the same size that are not empty",
                    metric.len(),
                    relative.len()
                )));
            }
            let (scale, shift) = frame_alignment(metric, relative);
            scales.push(scale);
            shifts.push(shift);
        }
        let product: Vec<f64> = scales.iter().zip(&shifts).map(|(s, b)| s * b).collect();
        let middle = median(&mut product.clone());
        let mut index = 0;
        for (k, p) in product.iter().enumerate() {
            if (p - middle).abs() < (product[index] - middle).abs() {
                index = k;
            }
        }
        let (scale, shift) = (scales[index], shifts[index]);
        let mut all: Vec<f64> = relative.iter().flatten().map(|&a| scale * f64::from(a) + shift).collect();
        let norm = percentile(&mut all, 0.98) / 2.0;
        if !(norm > 0.0 && norm.is_finite()) {
            return Err(MonoError::no_scale(norm));
        }
        Ok(Self { scales, shifts, index, norm })
    }

    /// Depth in scene units of relative disparities, 0 where it is unknown.
    #[must_use]
    pub fn sensor_depth(&self, relative: &[f32]) -> Vec<f32> {
        let (scale, shift) = (self.scales[self.index], self.shifts[self.index]);
        let depth = |a: f32| (self.norm / (scale * f64::from(a) + shift)).clamp(1e-4, 1e4);
        let known = |d: f64| if d < LEAST_DEPTH { 0.0 } else { d as f32 };
        relative.iter().map(|&a| known(depth(a))).collect()
    }
}

/// Scale and shift of one frame, by medians.
fn frame_alignment(metric_m: &[f32], relative: &[f32]) -> (f64, f64) {
    let a: Vec<f64> = relative.iter().map(|&x| f64::from(x)).collect();
    let g: Vec<f64> = metric_m
        .iter()
        .zip(&a)
        .map(|(&m, &a)| {
            let m = f64::from(m);
            if m < SKY_DEPTH_M && a < SKY_DISPARITY { SKY_METRIC } else { 1.0 / (m + 1e-8) }
        })
        .collect();
    let (ga, gg) = (median(&mut a.clone()), median(&mut g.clone()));
    let mut ratios: Vec<f64> = g.iter().zip(&a).map(|(g, a)| (g - gg + 1e-8) / (a - ga + 1e-8)).collect();
    let scale = median(&mut ratios);
    let mut rest: Vec<f64> = g.iter().zip(&a).map(|(g, a)| g - scale * a).collect();
    (scale, median(&mut rest))
}

/// The middle value, of an even count the mean of the two.
fn median(values: &mut [f64]) -> f64 {
    percentile(values, 0.5)
}

/// The value below which a share of `values` lies, with linear interpolation.
pub(crate) fn percentile(values: &mut [f64], share: f64) -> f64 {
    let at = share * (values.len() - 1) as f64;
    let (low, part) = (at.floor() as usize, at - at.floor());
    let (_, &mut first, rest) = values.select_nth_unstable_by(low, f64::total_cmp);
    if part == 0.0 || rest.is_empty() {
        return first;
    }
    let next = rest.iter().copied().fold(f64::INFINITY, f64::min);
    first + part * (next - first)
}
