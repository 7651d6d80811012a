//! Converts splats to the columns of the container, and back.

use crate::scene::Loss;
use crate::scene::splats::{FOREVER_CLIPS, Life, Row, collect, logit, sigmoid, unit};
use crate::scene::{C0, plural};
use ::fourdgs::GaussianSet;
use ::fourdgs::quantization::{SH_QUANT_HI, SH_QUANT_LO, sh_coefficient, support_k};
use m4_core::{Column, Splats};

/// Shortest standard deviation in time that is read, frames.
const LEAST_TIME_SD: f64 = 1e-6;
/// Smallest scale that is read, world units: what the container itself takes for 0.
const LEAST_SCALE: f32 = 1e-30;

/// A clip: how frames and seconds go together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Clip {
    /// Seconds per frame.
    pub step_s: f64,
    /// Frames.
    pub frames: usize,
}

impl Clip {
    /// Seconds from the first frame to the end of the last, as the container keeps it.
    pub fn duration_s(&self) -> f32 {
        (self.step_s * self.frames as f64) as f32
    }
}

/// The columns of the container. `splats` have no harmonics of time.
pub(super) fn to_set(splats: &Splats, clip: &Clip) -> (GaussianSet, Vec<Loss>) {
    let layout = splats.layout();
    let n = splats.n();
    let coefficients = layout.sh_terms() - 1;
    let mut set = GaussianSet {
        sh: (coefficients > 0).then(|| Vec::with_capacity(n * 3 * coefficients)),
        sh_coefficients: coefficients,
        sh_degree: layout.sh_degree as u8,
        win_lo: vec![0.0; n],
        win_hi: vec![clip.duration_s(); n],
        ..GaussianSet::default()
    };
    let (mut bright, mut wild) = (0usize, 0usize);
    for i in 0..n {
        let row = Row::of(splats, i);
        set.positions.extend(row.mean);
        set.scales.extend(row.log_scale.map(f32::exp));
        let [w, x, y, z] = row.quat;
        set.rotations.extend([x, y, z, w]);
        let rgb: [f64; 3] = std::array::from_fn(|c| 0.5 + C0 * f64::from(splats.column(Column::Colour, c)[i]));
        // without harmonics a negative sum is black for us too
        let dark = layout.sh_degree > 0 && rgb.iter().any(|&v| v < -0.5 / 255.0);
        bright += usize::from(dark || rgb.iter().any(|&v| v > 1.0 + 0.5 / 255.0));
        set.colors.extend(rgb.map(|v| v.clamp(0.0, 1.0) as f32));
        set.colors.push(sigmoid(row.opacity) as f32);
        if let Some(bytes) = &mut set.sh {
            let mut outside = false;
            for c in 0..3 {
                for k in 1..=coefficients {
                    let value = f64::from(splats.column(Column::Colour, 3 * k + c)[i]);
                    outside |= !(SH_QUANT_LO..=SH_QUANT_HI).contains(&value);
                    let code = (value - SH_QUANT_LO) / (SH_QUANT_HI - SH_QUANT_LO) * 255.0;
                    bytes.push(code.round().clamp(0.0, 255.0) as u8);
                }
            }
            wild += usize::from(outside);
        }
        let life = Life::of(splats, i);
        let step = clip.step_s;
        set.motions.extend(life.map_or([0.0; 3], |l| l.velocity.map(|v| (f64::from(v) / step) as f32)));
        set.mu_t.push(life.map_or(0.0, |l| (f64::from(l.time_mean) * step) as f32));
        set.sigma_t.push(life.map_or(f32::INFINITY, |l| (f64::from(l.log_time_sd).exp() * step) as f32));
    }
    let mut losses = Vec::new();
    if bright > 0 {
        losses.push(Loss::Quantised(format!(
            "the base colour of {} lies outside 0..1 and is cut there",
            plural(bright, "splat")
        )));
    }
    if wild > 0 {
        losses.push(Loss::Quantised(format!(
            "harmonics of {} lie outside -4..4 and are cut there",
            plural(wild, "splat")
        )));
    }
    (set, losses)
}

/// A parameter that is not a finite number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BadField {
    pub splat: usize,
    pub field: &'static str,
    pub value: f32,
}

/// The splats of the columns: those that never fade nor move are static.
pub(super) fn from_set(set: &GaussianSet, clip: &Clip, cutoff: f64) -> Result<(Splats, Vec<Loss>), BadField> {
    let n = set.count();
    let last_s = clip.step_s * clip.frames.saturating_sub(1) as f64;
    let k = support_k(cutoff);
    let mut rows = Vec::with_capacity(n);
    let (mut sudden, mut cut) = (0usize, 0usize);
    for i in 0..n {
        let triple = |values: &[f32]| -> [f32; 3] { std::array::from_fn(|k| values[3 * i + k]) };
        let finite = |field, values: &[f32]| match values.iter().find(|v| !v.is_finite()) {
            Some(&value) => Err(BadField { splat: i, field, value }),
            None => Ok(()),
        };
        let (mean, scale, motion) = (triple(&set.positions), triple(&set.scales), triple(&set.motions));
        finite("the position", &mean)?;
        finite("the scale", &scale)?;
        finite("the motion", &motion)?;
        let [x, y, z, w]: [f32; 4] = std::array::from_fn(|k| set.rotations[4 * i + k]);
        finite("the rotation", &[x, y, z, w])?;
        let row = Row {
            mean,
            log_scale: scale.map(|s| s.max(LEAST_SCALE).ln()),
            quat: unit([w, x, y, z]),
            opacity: logit(f64::from(set.colors[4 * i + 3])),
        };
        let (mu, sigma) = (f64::from(set.mu_t[i]), f64::from(set.sigma_t[i]));
        finite("the time", &[set.mu_t[i]])?;
        let (from, to) = (f64::from(set.win_lo[i]), f64::from(set.win_hi[i]));
        let whole = from <= 0.0 && to > last_s;
        let velocity = motion.map(|v| (f64::from(v) * clip.step_s) as f32);
        let life = if sigma.is_finite() {
            // a grid may have moved the ends a little
            let seen = (k - 0.1) * sigma;
            cut += usize::from(from > (mu - seen).max(0.0) || to <= (mu + seen).min(last_s));
            Some((mu, sigma))
        } else if !whole {
            // There for a while and gone: a Gaussian that the renderer cuts off at the same two moments.
            sudden += 1;
            let (from, to) = (from.max(-last_s - 1.0), to.min(2.0 * last_s + 1.0));
            Some((0.5 * (from + to), 0.5 * (to - from) / k))
        } else if motion != [0.0; 3] {
            Some((mu, FOREVER_CLIPS * (last_s + clip.step_s)))
        } else {
            None
        };
        let row_and_life = match life {
            None => (row, None),
            Some((centre, sd)) => {
                let shift = centre - mu;
                let moved = std::array::from_fn(|k| (f64::from(mean[k]) + f64::from(motion[k]) * shift) as f32);
                finite("the position in the middle of its life", &moved)?;
                let life = Life {
                    time_mean: (centre / clip.step_s) as f32,
                    log_time_sd: (sd / clip.step_s).max(LEAST_TIME_SD).ln() as f32,
                    velocity,
                };
                finite("the time in frames", &[life.time_mean, life.log_time_sd])?;
                finite("the motion a frame", &velocity)?;
                (Row { mean: moved, ..row }, Some(life))
            }
        };
        rows.push(row_and_life);
    }
    let coefficients = if set.sh.is_some() { set.sh_coefficients } else { 0 };
    let degree = match coefficients {
        15 => 3,
        8 => 2,
        3 => 1,
        _ => 0,
    };
    let splats = collect(degree, &rows, |i, out| {
        for c in 0..3 {
            out[c] = ((f64::from(set.colors[4 * i + c]) - 0.5) / C0) as f32;
            let bytes = set.sh.as_deref().unwrap_or_default();
            for k in 0..out.len() / 3 - 1 {
                out[3 * (k + 1) + c] = sh_coefficient(bytes[(3 * i + c) * coefficients + k]) as f32;
            }
        }
    });
    Ok((splats, window_losses(sudden, cut)))
}

fn window_losses(sudden: usize, cut: usize) -> Vec<Loss> {
    let mut losses = Vec::new();
    if sudden > 0 {
        losses.push(Loss::Baked(format!(
            "{} that appear and vanish at once now fade in and out between the same two moments",
            plural(sudden, "splat")
        )));
    }
    if cut > 0 {
        losses.push(Loss::Dropped(format!("the window of {}, which cuts off their fading", plural(cut, "splat"))));
    }
    losses
}
