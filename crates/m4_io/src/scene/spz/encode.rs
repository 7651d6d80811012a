//! Encodes splats of one instant as the bytes inside the gzip stream.

use super::layout::{COLOUR_SCALE, FLAG_ANTIALIASED, Header, ROTATION_STEPS};
use crate::scene::row::{sigmoid, unit};
use m4_core::{Column, Splats};

/// Steps of a coordinate on either side of 0.
const POSITION_STEPS: f64 = ((1 << 23) - 1) as f64;
/// Most fractional bits that are used: steps of a four-millionth of a unit.
const MAX_FRACTIONAL_BITS: u8 = 22;
/// Bits that are kept of a harmonic of degree 1, and of degrees 2 and 3: those of the reference encoder.
pub const SH1_BITS: u8 = 5;
pub const SH_REST_BITS: u8 = 4;
/// Step of an ln scale: 1/16.
const SCALES_PER_STEP: f32 = 16.0;

/// The packed bytes and what did not fit.
pub struct Encoded {
    pub header: Header,
    pub bytes: Vec<u8>,
    /// Scales outside of e^-10 to e^5.94.
    pub clipped_scales: usize,
    /// Colours of degree 0 outside of -0.44 to 1.44.
    pub clipped_colours: usize,
    /// Harmonics of higher degree outside of -1 to 127/128.
    pub clipped_harmonics: usize,
}

/// Packs static splats with three scales and quaternions. Fails with the row of a position that is NaN or
/// beyond the range of the format.
pub fn encode(splats: &Splats, mip: bool) -> Result<Encoded, String> {
    let n = splats.n();
    let header = Header {
        splats: u32::try_from(n).map_err(|_| format!("it has {n} splats; the format counts up to 2^32 - 1"))?,
        sh_degree: splats.layout().sh_degree as u8,
        fractional_bits: fractional_bits(splats)?,
        flags: if mip { FLAG_ANTIALIASED } else { 0 },
    };
    let mut out = Encoded {
        header,
        bytes: Vec::with_capacity(super::layout::HEADER_BYTES + header.payload_bytes() as usize),
        clipped_scales: 0,
        clipped_colours: 0,
        clipped_harmonics: 0,
    };
    out.bytes.extend(header.to_bytes());
    let columns = |column, len: usize| -> Vec<&[f32]> { (0..len).map(|k| splats.column(column, k)).collect() };
    let steps_per_unit = f64::from(1u32 << header.fractional_bits);
    let (mean, opacity) = (columns(Column::Mean, 3), splats.column(Column::Opacity, 0));
    for i in 0..n {
        for column in &mean {
            let steps = (f64::from(column[i]) * steps_per_unit).round() as i32;
            out.bytes.extend_from_slice(&steps.to_le_bytes()[..3]);
        }
    }
    out.bytes
        .extend(opacity.iter().map(|&o| (255.0 * sigmoid(o)).round() as u8));
    let colour = columns(Column::Colour, 3);
    for i in 0..n {
        for column in &colour {
            let steps = ((COLOUR_SCALE * column[i] + 0.5) * 255.0).round();
            out.clipped_colours += usize::from(!(0.0..=255.0).contains(&steps));
            out.bytes.push(steps as u8);
        }
    }
    let scale = columns(Column::LogScale, 3);
    for i in 0..n {
        for column in &scale {
            let steps = ((column[i] + 10.0) * SCALES_PER_STEP).round();
            out.clipped_scales += usize::from(!(0.0..=255.0).contains(&steps));
            out.bytes.push(steps as u8);
        }
    }
    let quat = columns(Column::Quat, 4);
    for i in 0..n {
        let q: [f32; 4] = std::array::from_fn(|k| quat[k][i]);
        out.bytes.extend(smallest_three(q).to_le_bytes());
    }
    let harmonics = columns(Column::Colour, 3 * splats.layout().sh_terms());
    for i in 0..n {
        for (c, column) in harmonics.iter().enumerate().skip(3) {
            let bits = if c < 12 { SH1_BITS } else { SH_REST_BITS };
            let (byte, clipped) = harmonic(column[i], bits);
            out.clipped_harmonics += usize::from(clipped);
            out.bytes.push(byte);
        }
    }
    Ok(out)
}

/// Bits behind the point of a coordinate: as many as the farthest splat leaves.
fn fractional_bits(splats: &Splats) -> Result<u8, String> {
    let mut bits = MAX_FRACTIONAL_BITS;
    for k in 0..3 {
        for (row, v) in splats.column(Column::Mean, k).iter().enumerate() {
            let v = f64::from(*v).abs();
            let fits = |b: &u8| v * f64::from(1u32 << b) <= POSITION_STEPS;
            let fit = (0..=bits).rev().find(fits);
            bits = fit.ok_or_else(|| format!("splat {row} lies at {v} along axis {k}; up to {POSITION_STEPS} fits"))?;
        }
    }
    Ok(bits)
}

/// A quaternion `(w, x, y, z)` of any length in 32 bits; 0 or NaN is no rotation.
fn smallest_three(q: [f32; 4]) -> u32 {
    let [w, x, y, z] = unit(q);
    let q = [x, y, z, w];
    let largest = (1..4).fold(0, |best, i| if q[i].abs() > q[best].abs() { i } else { best });
    let turn = q[largest] < 0.0;
    let mut packed = largest as u32;
    for (i, v) in q.into_iter().enumerate() {
        if i != largest {
            let magnitude = (v.abs() * std::f32::consts::SQRT_2 * ROTATION_STEPS).round();
            let sign = u32::from((v < 0.0) != turn);
            packed = packed << 10 | sign << 9 | (magnitude.min(ROTATION_STEPS) as u32);
        }
    }
    packed
}

/// A harmonic in steps of 1/128 of which the upper `bits` count, and whether it was out of reach.
fn harmonic(value: f32, bits: u8) -> (u8, bool) {
    let step = f32::from(1u16 << (8 - bits));
    let steps = ((value * 128.0 + 128.0) / step).round() * step;
    (steps as u8, !(0.0..=255.0).contains(&steps))
}

#[cfg(test)]
mod tests {
    use super::{harmonic, smallest_three};

    #[test]
    fn packed_quaternion_matches_hand_computation() {
        // half a turn about x: x is the largest (index 0), the rest is 0
        let packed = smallest_three([0.0, 2.0, 0.0, 0.0]);
        assert_eq!(packed, 0);
        // a quarter of a turn about z, negated: z = w = -1/sqrt(2); z comes first and is the largest
        // (index 2), and the sign turns, so x = 0 (negative zero turned), y the same, w = +511
        let h = -std::f32::consts::FRAC_1_SQRT_2;
        let packed = smallest_three([h, 0.0, 0.0, h]);
        assert_eq!(packed >> 30, 2);
        assert_eq!(packed & 0x3ff, 511);
        assert_eq!(packed >> 10 & 0x1ff, 0);
        // w = 0.5, x = -0.5, y = 0.1, z = 0.7: the largest is z; x is negative
        let packed = smallest_three([0.5, -0.5, 0.1, 0.7]);
        let steps = |v: f32| (v * std::f32::consts::SQRT_2 * 511.0).round() as u32;
        assert_eq!(packed >> 30, 2);
        assert_eq!(packed >> 20 & 0x3ff, 1 << 9 | steps(0.5));
        assert_eq!(packed >> 10 & 0x3ff, steps(0.1));
        assert_eq!(packed & 0x3ff, steps(0.5));
        assert_eq!(smallest_three([f32::NAN; 4]) >> 30, 3);
    }

    #[test]
    fn harmonics_keep_their_upper_bits() {
        assert_eq!(harmonic(0.0, 5), (128, false));
        assert_eq!(harmonic(0.5, 8), (192, false));
        // 0.1 * 128 + 128 = 140.8, in steps of 16: 144
        assert_eq!(harmonic(0.1, 4), (144, false));
        assert_eq!(harmonic(-2.0, 8), (0, true));
        assert_eq!(harmonic(2.0, 8), (255, true));
    }
}
