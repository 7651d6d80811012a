//! Whether maps of motion are high where something moves.
//!
//! MegaSaM's own file is high where things rest, others are high where they move, and nothing in a file says which. Three things
//! tell: little of most clips is dynamic; dynamic regions are seldom along the border of the image; and inside them flow differs from
//! what the camera alone makes.

use super::source::{FrameSource, VideoError, scaled};
use crate::classical::dense::{FlowPair, FlowSource, working_size};
use m4_core::{Flow, Plane, quantile};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Share of high pixels beyond which a map is doubted. docs/spec/front-end.md 1.9: 0.6.
const MOST_MOVING: f64 = 0.6;
/// Flow of high pixels differs from the camera's by less than this share of that of low ones: they rest.
const CALM: f64 = 0.8;
/// Longest side at which flow is compared, pixels.
const SIDE_PX: usize = 320;
/// Pairs of frames whose flow is compared.
const PAIRS: usize = 3;
/// Rounds of the robust fit.
const ROUNDS: usize = 12;

/// What a verdict rests on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PolarityEvidence {
    /// Share of all pixels above the threshold.
    pub high_share: f64,
    /// Share of the pixels along the borders above the threshold.
    pub border_high_share: f64,
    /// By how much flow differs from one affine motion per frame, medians over high and over low pixels, pixels at a longest side of 320;
    /// `None` where there is no flow, or nothing high or nothing low.
    pub residual_px: Option<[f64; 2]>,
}

/// Whether maps of motion are high where something moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Polarity {
    /// Nothing speaks against it.
    Moving,
    /// Something does.
    Doubtful,
    /// They are high where things rest: two witnesses say so.
    Still,
}

impl fmt::Display for PolarityEvidence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        write!(
            f,
            "{} of the pixels and {} of those along the border are high",
            percent(self.high_share),
            percent(self.border_high_share)
        )?;
        match self.residual_px {
            Some([high, low]) => write!(
                f,
                "; flow differs from the camera's by {high:.2} px where they are high and {low:.2} px elsewhere"
            ),
            None => Ok(()),
        }
    }
}

impl PolarityEvidence {
    /// The verdict.
    #[must_use]
    pub fn verdict(&self) -> Polarity {
        let calm = self.residual_px.is_some_and(|[high, low]| high < CALM * low);
        let witnesses = [self.high_share > MOST_MOVING, self.border_high_share > MOST_MOVING, calm];
        match witnesses.iter().filter(|&&w| w).count() {
            0 => Polarity::Moving,
            1 => Polarity::Doubtful,
            _ => Polarity::Still,
        }
    }

    /// What the maps (high above `tau`, 0..1) and, where there is a source of it, flow of a few pairs of frames say.
    ///
    /// # Errors
    ///
    /// [`VideoError`] if images or flow cannot be had.
    pub(super) fn of(
        maps: &[&Plane<u8>],
        clip: &dyn FrameSource,
        flow: Option<&dyn FlowSource>,
        tau: f32,
    ) -> Result<Self, VideoError> {
        let high = |m: u8| f32::from(m) / 255.0 > tau;
        let (mut all, mut above, mut border, mut border_above) = (0usize, 0usize, 0usize, 0usize);
        for map in maps {
            let (w, h) = map.size();
            all += w * h;
            above += map.data().iter().filter(|&&m| high(m)).count();
            let rim = (0..w * h).filter(|i| i % w == 0 || i % w == w - 1 || i / w == 0 || i / w == h - 1);
            for i in rim {
                border += 1;
                border_above += usize::from(high(map.data()[i]));
            }
        }
        let share = |a: usize, b: usize| a as f64 / b.max(1) as f64;
        let residual_px = match flow {
            Some(flow) => residuals(maps, clip, flow, tau)?,
            None => None,
        };
        Ok(Self { high_share: share(above, all), border_high_share: share(border_above, border), residual_px })
    }
}

/// Medians of what flow leaves of one affine motion, over high and over low pixels.
fn residuals(
    maps: &[&Plane<u8>],
    clip: &dyn FrameSource,
    source: &dyn FlowSource,
    tau: f32,
) -> Result<Option<[f64; 2]>, VideoError> {
    let n = maps.len();
    let full = clip.size();
    let (w, h) = working_size(full.0, full.1, SIDE_PX);
    let (mut high, mut low) = (Vec::new(), Vec::new());
    let mut firsts: Vec<usize> = (1..=PAIRS).map(|k| k * n / (PAIRS + 1)).filter(|&i| i + 1 < n).collect();
    firsts.dedup();
    for i in firsts {
        let (a, b) = (scaled(clip, i, (w, h))?, scaled(clip, i + 1, (w, h))?);
        let pair = FlowPair::between(&a.flow_image(), &b.flow_image(), source)
            .map_err(|source| VideoError::Flow { between: (i, i + 1), source })?;
        let map = crate::resample::resize_bilinear(&maps[i].map(|&m| f32::from(m) / 255.0), w, h);
        let left = off_camera(&pair.forward, &pair.forward_round_trip);
        for (r, m) in left.into_iter().zip(map.data()) {
            if r.is_finite() {
                if *m > tau { &mut high } else { &mut low }.push(r);
            }
        }
    }
    let median = |values: &mut Vec<f32>| quantile(values, 0.5).map(f64::from);
    Ok(median(&mut high).zip(median(&mut low)).map(|(high, low)| [high, low]))
}

/// How far flow is from the affine motion that most of the image follows, pixels; NaN where the way there and back does not close.
fn off_camera(flow: &Flow, round_trip_px: &[f32]) -> Vec<f32> {
    let width = flow.width;
    let known: Vec<usize> = (0..flow.u.len()).step_by(3).filter(|&i| round_trip_px[i] < 1.0).collect();
    let place = |i: usize| Vector3::new((i % width) as f64 / width as f64, (i / width) as f64 / width as f64, 1.0);
    let mut fit = [Vector3::zeros(), Vector3::zeros()];
    let left = |fit: &[Vector3<f64>; 2], i: usize| {
        let p = place(i);
        (f64::from(flow.u[i]) - fit[0].dot(&p)).hypot(f64::from(flow.v[i]) - fit[1].dot(&p))
    };
    let mut weight = vec![1.0; known.len()];
    for _ in 0..ROUNDS {
        let (mut normal, mut right) = (Matrix3::identity() * 1e-9, [Vector3::zeros(), Vector3::zeros()]);
        for (&i, &w) in known.iter().zip(&weight) {
            let p = place(i);
            normal += p * p.transpose() * w;
            right[0] += p * (w * f64::from(flow.u[i]));
            right[1] += p * (w * f64::from(flow.v[i]));
        }
        if let Some(solve) = normal.cholesky() {
            fit = right.map(|r| solve.solve(&r));
        }
        // Least absolute deviations, which a third of moving pixels does not turn.
        for (&i, w) in known.iter().zip(&mut weight) {
            *w = 1.0 / left(&fit, i).max(0.05);
        }
    }
    let of = |i: usize| {
        if round_trip_px[i] < 1.0 { left(&fit, i) as f32 } else { f32::NAN }
    };
    (0..flow.u.len()).map(of).collect()
}
