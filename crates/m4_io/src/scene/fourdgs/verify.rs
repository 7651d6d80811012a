//! Verifies that a file decodes to its input, within the bounds that it declares.
//!
//! The encoder's own check allows 1e-9 beside each bound, and the decoder rounds to f32, so it refuses
//! ordinary scenes. This one allows a unit in the last place. Chunks and the Morton order inside them
//! rearrange splats, so each original is first put on the grid of the file as a decoder would, and the
//! two sets of rows must then agree bit for bit; the grid itself is compared with the original.

use ::fourdgs::quantization::{
    Bounds, Steps, dequantize_rotation, life_class, motion_step, mu_step, quantize_rotation, rint, support_k,
};
use ::fourdgs::{GaussianSet, Quantization, Scene};

/// Fields of a row beside its harmonics.
const FIELDS: usize = 19;
/// Their names, for messages, and how many values each has.
const NAMES: [(&str, usize); 7] =
    [("position", 3), ("scale", 3), ("rotation", 4), ("colour", 4), ("motion", 3), ("mu_t", 1), ("sigma_t", 1)];

type Fields = [f32; FIELDS];

/// Compares a decoded file with the columns that it was made of.
///
/// # Errors
///
/// What differs, and by how much.
pub(super) fn check(set: &GaussianSet, bounds: &Bounds, file: &Scene) -> Result<(), String> {
    let (n, found) = (set.count(), file.gaussians.count());
    if n != found {
        return Err(format!("{found} splats came back of {n}"));
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
        Some(at) => Err(format!("row {at} in order of its bits is {:?} where {:?} was written", got[at], wanted[at])),
    }
}

/// Bits of the fields and bytes of the harmonics of every splat, sorted.
fn rows(set: &GaussianSet, fields: impl Fn(usize) -> Fields) -> Vec<([u32; FIELDS], &[u8])> {
    let width = if set.sh.is_some() { 3 * set.sh_coefficients } else { 0 };
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
        let (s, snap) = (&self.steps, |v: f64, step: f64| rint(v / step) as f64 * step);
        let fades = original[18].is_finite();
        let sigma_bin = if fades { rint(original[18].max(1e-30).ln() / s.sigma_log) } else { 0 };
        let motion = motion_step(life_class(sigma_bin, s.sigma_log, !fades, self.window_s, self.k), s.motion);
        let time = mu_step(sigma_bin, s.sigma_log, !fades, s.time);
        let mut out = [0.0; FIELDS];
        for k in 0..3 {
            out[k] = (rint((original[k] - self.origin[k]) / s.pos) as f64 * s.pos + self.origin[k]) as f32;
            out[3 + k] = snap(original[3 + k].max(1e-30).ln(), s.scale_log).exp() as f32;
            out[10 + k] = snap(original[10 + k], s.rgb).clamp(0.0, 1.0) as f32;
            out[14 + k] = snap(original[14 + k], motion) as f32;
        }
        let quat = [original[6], original[7], original[8], original[9]];
        let (largest, bins) = quantize_rotation(quat, s.rot);
        out[6..10].copy_from_slice(&dequantize_rotation(largest, &bins, s.rot));
        out[13] = snap(original[13], s.alpha).clamp(0.0, 1.0) as f32;
        out[17] = snap(original[17], time) as f32;
        out[18] = if fades { (sigma_bin as f64 * s.sigma_log).exp() as f32 } else { f32::INFINITY };
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
                // a promise on where the splat is, not on its velocity: at most four times the bound of
                // half a second for the shortest lives
                "motion" => bounds.motion * 16.0,
                "mu_t" => bounds.time,
                "sigma_t" if fades && a > 1e-30 => bounds.sigma_rel * a,
                // compared as a rotation below
                _ => continue,
            };
            // one in the last place, of the value or of the larger of the two numbers it was made of
            let slack = f64::from(f32::EPSILON) * a.abs().max(b.abs()).max(allowed);
            if (a - b).abs() > allowed + slack {
                return Err(format!("the {name} of splat {i} is {b} where {a} was given, and the bound is {allowed}"));
            }
        }
        at += width;
    }
    let dot: f64 = (6..10).map(|k| f64::from(original[k]) * f64::from(fields[k])).sum();
    // Three components within the bound move the fourth by at most three times as much.
    let allowed = 4.0 * bounds.rot + 1e-6;
    if 2.0 * (1.0 - dot.abs()) > allowed * allowed {
        return Err(format!("the rotation of splat {i} is off by more than {allowed}"));
    }
    Ok(())
}
