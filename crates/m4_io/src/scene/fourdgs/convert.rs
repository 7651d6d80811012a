//! Converts splats to the columns of the container, and back, and verifies that a file decodes to
//! its input, within the bounds that it declares.
//!
//! The encoder's own check allows 1e-9 beside each bound, and the decoder rounds to f32, so it
//! refuses ordinary scenes. This one allows a unit in the last place. Chunks and the Morton order
//! inside them rearrange splats, so each original is first put on the grid of the file as a decoder
//! would, and the two sets of rows must then agree bit for bit; the grid itself is compared with
//! the original.

use crate::scene::splats::{FOREVER_CLIPS, Life, Row, collect, logit, sigmoid, unit};
use crate::scene::{C0, Loss, plural};
use ::fourdgs::quantization::{
    Bounds, SH_QUANT_HI, SH_QUANT_LO, Steps, dequantize_rotation, life_class, motion_step, mu_step,
    quantize_rotation, rint, sh_coefficient, support_k,
};
use ::fourdgs::{GaussianSet, Quantization, Scene};
use m4_core::{Column, Splats};

/// Shortest standard deviation in time that is read, frames.
const LEAST_TIME_SD: f64 = 1e-6;
/// Smallest scale that is read, world units: what the container itself takes for 0.
const LEAST_SCALE: f32 = 1e-30;

/// A clip: how frames and seconds go together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ClipTime {
    /// Seconds per frame.
    pub step_s: f64,
    /// Frames.
    pub frames: usize,
}

impl ClipTime {
    /// Seconds from the first frame to the end of the last, as the container keeps it.
    pub fn duration_s(&self) -> f32 {
        (self.step_s * self.frames as f64) as f32
    }
}

/// The columns of the container. `splats` have no harmonics of time.
pub(super) fn to_set(splats: &Splats, clip: &ClipTime) -> (GaussianSet, Vec<Loss>) {
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
        let rgb: [f64; 3] =
            std::array::from_fn(|c| 0.5 + C0 * f64::from(splats.column(Column::Colour, c)[i]));
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
        set.motions.extend(life.map_or([0.0; 3], |l| {
            l.velocity.map(|v| (f64::from(v) / step) as f32)
        }));
        set.mu_t
            .push(life.map_or(0.0, |l| (f64::from(l.time_mean) * step) as f32));
        set.sigma_t.push(life.map_or(f32::INFINITY, |l| {
            (f64::from(l.log_time_sd).exp() * step) as f32
        }));
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

/// The splats of the columns: those that never fade nor move are static. Fails with the parameter
/// that is not a finite number.
pub(super) fn from_set(
    set: &GaussianSet,
    clip: &ClipTime,
    cutoff: f64,
) -> Result<(Splats, Vec<Loss>), String> {
    let n = set.count();
    let last_s = clip.step_s * clip.frames.saturating_sub(1) as f64;
    let k = support_k(cutoff);
    let mut rows = Vec::with_capacity(n);
    let (mut sudden, mut cut) = (0usize, 0usize);
    for i in 0..n {
        let triple = |values: &[f32]| -> [f32; 3] { std::array::from_fn(|k| values[3 * i + k]) };
        let finite = |field: &str, values: &[f32]| match values.iter().find(|v| !v.is_finite()) {
            Some(value) => Err(format!("{field} of splat {i} is {value}")),
            None => Ok(()),
        };
        let (mean, scale, motion) = (
            triple(&set.positions),
            triple(&set.scales),
            triple(&set.motions),
        );
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
            let half_width = (k - 0.1) * sigma;
            cut += usize::from(
                from > (mu - half_width).max(0.0) || to <= (mu + half_width).min(last_s),
            );
            Some((mu, sigma))
        } else if !whole {
            // There for a while and gone: a Gaussian that the renderer cuts off at the same two
            // moments.
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
                let moved = std::array::from_fn(|k| {
                    (f64::from(mean[k]) + f64::from(motion[k]) * shift) as f32
                });
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
    let coefficients = if set.sh.is_some() {
        set.sh_coefficients
    } else {
        0
    };
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
        losses.push(Loss::Dropped(format!(
            "the window of {}, which cuts off their fading",
            plural(cut, "splat")
        )));
    }
    losses
}

/// Fields of a row beside its harmonics.
const FIELDS: usize = 19;
/// Their names, for messages, and how many values each has.
const NAMES: [(&str, usize); 7] = [
    ("position", 3),
    ("scale", 3),
    ("rotation", 4),
    ("colour", 4),
    ("motion", 3),
    ("mu_t", 1),
    ("sigma_t", 1),
];

type Fields = [f32; FIELDS];

/// Compares a decoded file with the columns that it was made of. Returns what differs, and by how
/// much.
pub(super) fn verify(set: &GaussianSet, bounds: &Bounds, file: &Scene) -> Result<(), String> {
    let (n, n_read) = (set.count(), file.gaussians.count());
    if n != n_read {
        return Err(format!("{n_read} splats came back of {n}"));
    }
    let grid = Grid::new(&file.quantization, set, file.header.cutoff);
    let mut expected = Vec::with_capacity(n);
    for i in 0..n {
        let fields = grid.fields(set, i);
        within(&fields, set, i, bounds)?;
        expected.push(fields);
    }
    let wanted = rows(set, |i| expected[i]);
    let got = rows(&file.gaussians, |i| fields_of(&file.gaussians, i));
    match wanted.iter().zip(&got).position(|(a, b)| a != b) {
        None => Ok(()),
        Some(at) => Err(format!(
            "row {at} in order of its bits is {:?} where {:?} was written",
            got[at], wanted[at]
        )),
    }
}

/// Bits of the fields and bytes of the harmonics of every splat, sorted.
fn rows(set: &GaussianSet, fields: impl Fn(usize) -> Fields) -> Vec<([u32; FIELDS], &[u8])> {
    let width = if set.sh.is_some() {
        3 * set.sh_coefficients
    } else {
        0
    };
    let sh = set.sh.as_deref().unwrap_or_default();
    let mut rows: Vec<_> = (0..set.count())
        .map(|i| {
            // -0 and 0 are the same number
            let bits = fields(i).map(|v| (v + 0.0).to_bits());
            (bits, &sh[i * width..(i + 1) * width])
        })
        .collect();
    rows.sort_unstable();
    rows
}

fn fields_of(set: &GaussianSet, i: usize) -> Fields {
    let mut out = [0.0; FIELDS];
    let columns: [(&[f32], usize); 7] = [
        (&set.positions, 3),
        (&set.scales, 3),
        (&set.rotations, 4),
        (&set.colors, 4),
        (&set.motions, 3),
        (&set.mu_t, 1),
        (&set.sigma_t, 1),
    ];
    let mut at = 0;
    for (values, width) in columns {
        out[at..at + width].copy_from_slice(&values[i * width..(i + 1) * width]);
        at += width;
    }
    out
}

/// The grid of a file (section 6 of the format).
struct Grid {
    steps: Steps,
    origin: [f64; 3],
    window_s: f64,
    k: f64,
}

impl Grid {
    fn new(quantization: &Quantization, set: &GaussianSet, cutoff: f64) -> Self {
        let window = |values: &[f32]| values.first().map_or(0.0, |&v| f64::from(v));
        Self {
            steps: quantization.steps(),
            origin: std::array::from_fn(|k| quantization.pos_origin.get(k).copied().unwrap_or(0.0)),
            window_s: window(&set.win_hi) - window(&set.win_lo),
            k: support_k(cutoff),
        }
    }

    /// What a decoder makes of a splat once it is on the grid.
    fn fields(&self, set: &GaussianSet, i: usize) -> Fields {
        let original = fields_of(set, i).map(f64::from);
        let (s, snap) = (&self.steps, |v: f64, step: f64| {
            rint(v / step) as f64 * step
        });
        let fades = original[18].is_finite();
        let sigma_bin = if fades {
            rint(original[18].max(1e-30).ln() / s.sigma_log)
        } else {
            0
        };
        let motion = motion_step(
            life_class(sigma_bin, s.sigma_log, !fades, self.window_s, self.k),
            s.motion,
        );
        let time = mu_step(sigma_bin, s.sigma_log, !fades, s.time);
        let mut out = [0.0; FIELDS];
        for k in 0..3 {
            out[k] = (rint((original[k] - self.origin[k]) / s.pos) as f64 * s.pos + self.origin[k])
                as f32;
            out[3 + k] = snap(original[3 + k].max(1e-30).ln(), s.scale_log).exp() as f32;
            out[10 + k] = snap(original[10 + k], s.rgb).clamp(0.0, 1.0) as f32;
            out[14 + k] = snap(original[14 + k], motion) as f32;
        }
        let quat = [original[6], original[7], original[8], original[9]];
        let (largest, bins) = quantize_rotation(quat, s.rot);
        out[6..10].copy_from_slice(&dequantize_rotation(largest, &bins, s.rot));
        out[13] = snap(original[13], s.alpha).clamp(0.0, 1.0) as f32;
        out[17] = snap(original[17], time) as f32;
        out[18] = if fades {
            (sigma_bin as f64 * s.sigma_log).exp() as f32
        } else {
            f32::INFINITY
        };
        out
    }
}

/// Compares a splat on the grid with the original, a unit in the last place aside.
fn within(fields: &Fields, set: &GaussianSet, i: usize, bounds: &Bounds) -> Result<(), String> {
    let original = fields_of(set, i);
    let fades = original[18].is_finite();
    let mut at = 0;
    for (name, width) in NAMES {
        for k in at..at + width {
            let (a, b) = (f64::from(original[k]), f64::from(fields[k]));
            let allowed = match name {
                "position" => bounds.pos,
                "scale" if a > 1e-30 => bounds.scale_rel * a,
                "colour" => bounds.rgb.max(bounds.alpha),
                // a promise on where the splat is, not on its velocity: at most four times the
                // bound of half a second for the shortest lives
                "motion" => bounds.motion * 16.0,
                "mu_t" => bounds.time,
                "sigma_t" if fades && a > 1e-30 => bounds.sigma_rel * a,
                // compared as a rotation below
                _ => continue,
            };
            // one in the last place, of the value or of the larger of the two numbers it was made
            // of
            let slack = f64::from(f32::EPSILON) * a.abs().max(b.abs()).max(allowed);
            if (a - b).abs() > allowed + slack {
                return Err(format!(
                    "the {name} of splat {i} is {b} where {a} was given, and the bound is {allowed}"
                ));
            }
        }
        at += width;
    }
    let dot: f64 = (6..10)
        .map(|k| f64::from(original[k]) * f64::from(fields[k]))
        .sum();
    // Three components within the bound move the fourth by at most three times as much.
    let allowed = 4.0 * bounds.rot + 1e-6;
    if 2.0 * (1.0 - dot.abs()) > allowed * allowed {
        return Err(format!(
            "the rotation of splat {i} is off by more than {allowed}"
        ));
    }
    Ok(())
}
