//! Maps of a clip at the working size, and what becomes of them.

use super::align::Fit;
use super::{MonoDepth, MonoError, MonoKind};
use crate::classical::dense::static_depth::Measured;
use crate::classical::dense::user_masks::nearest;
use m4_core::RgbImage;

/// What stands for an aligned disparity against one on which all partners agree, where nothing was measured.
const PRIOR_WEIGHT: f32 = 0.3;
/// Confidence from which on a measured disparity takes part in an alignment.
const SURE: f32 = 0.5;

/// Monocular depth of one frame.
struct FrameDepth {
    kind: MonoKind,
    /// `[height][width]`: one over depth for the kinds of depth, else as given; NaN where unknown.
    values: Vec<f32>,
}

/// Depth of all frames from one image each, at the working size.
pub(in crate::classical::dense) struct Mono {
    frames: Vec<Option<FrameDepth>>,
}

impl Mono {
    /// The map of one frame; see [`Self::of`].
    pub fn read(
        source: &dyn MonoDepth,
        frame: usize,
        image: &RgbImage,
        (width, height): (usize, usize),
    ) -> Result<Read, MonoError> {
        let Some(map) = source.depth(frame, image)? else {
            return Ok(Read(None));
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
        Ok(Read(Some(FrameDepth {
            kind: map.kind,
            values: (0..width * height).map(value).collect(),
        })))
    }

    /// All frames in order.
    pub fn of(frames: Vec<Read>) -> Self {
        Self {
            frames: frames.into_iter().map(|read| read.0).collect(),
        }
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
        let pairs: Vec<(f64, f64)> = (0..known.values.len())
            .filter(sure)
            .map(|p| (f64::from(known.values[p]), f64::from(disparity[p])))
            .collect();
        let fit = Fit::of(&pairs, known.kind == MonoKind::AffineDisparity)?;
        Some(
            known
                .values
                .iter()
                .map(|&v| fit.disparity(v).unwrap_or(f32::NAN))
                .collect(),
        )
    }

    /// What is measured, and weakly, where nothing is and nothing moves, what is aligned.
    pub fn with_prior(&self, i: usize, measured: &Measured, moving: Option<&[u8]>) -> Measured {
        let mut out = measured.clone();
        if let Some(aligned) = self.aligned(i, &measured.disparity, &measured.confidence, moving) {
            for (p, d) in aligned.into_iter().enumerate().filter(|(_, d)| d.is_finite()) {
                if out.confidence[p] == 0.0 && moving.is_none_or(|m| m[p] == 0) {
                    (out.disparity[p], out.confidence[p]) = (d, PRIOR_WEIGHT);
                }
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
        let Some(aligned) = self.aligned(i, background, &measured.confidence, Some(moving)) else {
            return;
        };
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
        let (mut all, values) = (Vec::new(), &known.values);
        all.extend(values.iter().filter(|v| v.is_finite()).map(|&v| f64::from(v)));
        if let Some(fit) = Fit::to_distance_one(&mut all) {
            for (out, v) in out.iter_mut().zip(values) {
                *out = fit.disparity(*v).unwrap_or(*out);
            }
        }
        out
    }
}

/// A frame's map, read.
pub(in crate::classical::dense) struct Read(Option<FrameDepth>);
